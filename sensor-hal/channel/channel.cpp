// The state machine that all channels share. Backends see only calls that their state allows.
#include "sensor-hal/channel/channel.h"

#include <utility>

namespace rigor {
namespace {

std::string_view name_of(ChannelState state) {
  switch (state) {
    case ChannelState::created:
      return "created";
    case ChannelState::configured:
      return "configured";
    case ChannelState::armed:
      return "armed";
    case ChannelState::running:
      return "running";
  }
  return "?";
}

tl::unexpected<Error> refused(const std::string& channel, std::string_view call, ChannelState state,
                              std::string_view expected) {
  return fail(ErrorCode::wrong_state, channel,
              std::string(call) + ": expected a channel that is " + std::string(expected) +
                  ", got one that is " + std::string(name_of(state)));
}

}  // namespace

HealthSnapshot HealthCounters::snapshot() const noexcept {
  HealthSnapshot s;
  s.connected = connected.load(std::memory_order_acquire);
  s.received = received.load(std::memory_order_acquire);
  s.incomplete = incomplete.load(std::memory_order_acquire);
  s.lost = lost.load(std::memory_order_acquire);
  s.no_slot = no_slot.load(std::memory_order_acquire);
  s.ring_full = ring_full.load(std::memory_order_acquire);
  s.protocol_errors = protocol_errors.load(std::memory_order_acquire);
  s.retries = retries.load(std::memory_order_acquire);
  s.reconnects = reconnects.load(std::memory_order_acquire);
  return s;
}

SinkSnapshot SinkCounters::snapshot() const noexcept {
  SinkSnapshot s;
  s.accepted = accepted.load(std::memory_order_acquire);
  s.applied = applied.load(std::memory_order_acquire);
  s.late = late.load(std::memory_order_acquire);
  s.failed = failed.load(std::memory_order_acquire);
  s.dropped = dropped.load(std::memory_order_acquire);
  s.made_safe = made_safe.load(std::memory_order_acquire);
  return s;
}

Status Channel::configure(const ChannelConfig& config) {
  if (state_ != ChannelState::created && state_ != ChannelState::configured)
    return refused(config_.name, "configure", state_, "created or configured");
  auto previous = std::exchange(description_, {});
  Status status;
  try {
    status = do_configure(config);
    if (status) config.params.finish();
  } catch (const ConfigError& e) {
    status = tl::unexpected<Error>(e.error());
  }
  if (!status) {
    description_ = std::move(previous);
    return status;
  }
  config_ = config;
  state_ = ChannelState::configured;
  return {};
}

Status Channel::arm(const ArmContext& context) {
  if (state_ != ChannelState::configured) return refused(config_.name, "arm", state_, "configured");
  if (context.virtual_time && requires_wall_clock())
    return fail(
        ErrorCode::bad_input, config_.name,
        "expected a wall-clock run (--clock wall): sockets and ports have no virtual time; in virtual "
        "time a channel's device is replaced by the emulator that `emulated_by` names");
  origin_.forget();
  if (auto status = do_arm(context); !status) return status;
  state_ = ChannelState::armed;
  return {};
}

Status Channel::start(BenchTime t0) {
  if (state_ != ChannelState::armed) return refused(config_.name, "start", state_, "armed");
  if (auto status = do_start(t0); !status) return status;
  origin_.publish(t0);
  state_ = ChannelState::running;
  return {};
}

Status Channel::stop() {
  if (state_ != ChannelState::armed && state_ != ChannelState::running)
    return refused(config_.name, "stop", state_, "armed or running");
  if (auto status = do_stop(); !status) return status;
  state_ = ChannelState::configured;
  return {};
}

}  // namespace rigor
