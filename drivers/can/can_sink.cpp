#include "drivers/can/can_sink.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "drivers/can/can_interfaces.h"

namespace rigor::can {
namespace {

constexpr std::size_t kRingPlaces = 256;
/// How long a command may wait in the ring before the thread looks: the loop does not wake it, a system call
/// on the loop's side would cost more than this costs here.
constexpr Duration kTick = microseconds(500);
constexpr Duration kLookAtBus = milliseconds(20);

}  // namespace

CanSink::~CanSink() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status CanSink::do_configure(const ChannelConfig& config) {
  settings_ = SinkSettings::parse(config, description_);
  return {};
}

void CanSink::watch(const Heartbeat* heartbeat, Duration deadline) {
  heartbeat_ = heartbeat;
  heartbeat_deadline_ = deadline;
}

Status CanSink::do_arm(const ArmContext& context) {
  if (context.virtual_time)
    return fail(ErrorCode::wrong_state, config().name,
                "expected a wall-clock run, got virtual time: name the node's emulator with `emulated_by`");
  if (auto s = deadline_.open(); !s) return s;
  if (auto s = bcm_.open(settings_.interface); !s)
    return fail(s.error().code, config().name, s.error().text());
  const RawOptions none{.filters = {}, .receive = false};
  if (auto s = watcher_.open(settings_.interface, none); !s)
    return fail(s.error().code, config().name, s.error().text());
  ring_ = std::make_unique<SpscRing<Command>>(kRingPlaces);
  frames_ = CommandFrames(settings_);
  frames_.make_safe();
  loop_period_ = context.loop_period;
  backoff_.reset();
  next_look_ = {};
  want_safe_ = false;
  const auto info = find_interface(settings_.interface);
  const int error = info && !info->up ? -ENETDOWN : start_all();
  if (error != 0) {
    bcm_.close();
    watcher_.close();
    return fail(
        ErrorCode::unavailable, config().name,
        settings_.interface + ": expected the bus to take the safe values, got: " + std::strerror(-error) +
            (error == -ENETDOWN ? "; sudo ip link set " + settings_.interface +
                                      (info && info->kind != "can" ? " up" : " up type can bitrate 500000")
                                : std::string()));
  }
  safe_ = true;
  link_is_up_ = true;
  health_.connected.store(true, std::memory_order_release);
  thread_ = std::thread([this] { run(); });
  return {};
}

Status CanSink::do_stop() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  drop_all();
  // One try: a bus that is gone now cannot be told anything from here.
  if (!safe_ && bcm_.is_open()) make_safe();
  bcm_.close();
  watcher_.close();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

bool CanSink::command(const Command& c) noexcept {
  if (!ring_ || !ring_->try_push(c)) {
    counters_.dropped.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  counters_.accepted.fetch_add(1, std::memory_order_relaxed);
  return true;
}

void CanSink::run() {
  while (true) {
    auto wake = monotonic_now() + kTick;
    if (const auto* next = ring_->peek(); next && !want_safe_)
      wake = std::min(wake, MonotonicTime(next->t_effect.ns()));  // wall runs: bench time is CLOCK_MONOTONIC
    if (!deadline_.wait_until(wake)) return;
    work();
  }
}

void CanSink::work() {
  const bool unsafe_loop =
      origin().get() && heartbeat_ && heartbeat_->expired(monotonic_now(), heartbeat_deadline_);
  if (unsafe_loop && !want_safe_) counters_.made_safe.fetch_add(1, std::memory_order_relaxed);
  want_safe_ = unsafe_loop;
  if (monotonic_now() >= next_look_) look_at_link();
  if (want_safe_) {
    drop_all();
    if (!safe_) make_safe();
    return;
  }
  for (auto* c = ring_->peek(); c && c->t_effect.ns() <= monotonic_now().ns(); c = ring_->peek()) {
    // A loop that hangs is not to get its old commands through because there are many of them.
    if (heartbeat_ && heartbeat_->expired(monotonic_now(), heartbeat_deadline_)) return;
    apply(*c);
    ring_->drop_front();
  }
}

void CanSink::apply(const Command& c) {
  if (monotonic_now().ns() - c.t_effect.ns() > std::max(loop_period_, kTick * 2).ns())
    counters_.late.fetch_add(1, std::memory_order_relaxed);
  if (!frames_.apply(c)) {
    counters_.failed.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  safe_ = false;
  const int error = link_is_up_ ? send_all() : -ENETDOWN;
  (error == 0 ? counters_.applied : counters_.failed).fetch_add(1, std::memory_order_relaxed);
  if (error != 0) failed(error);
}

int CanSink::start_all() noexcept {
  int worst = 0;
  for (std::size_t i = 0; i < settings_.messages.size(); ++i) {
    const auto& m = settings_.messages[i];
    const int error =
        m.period.ns() > 0 ? bcm_.start(frames_.frames()[i], m.period) : bcm_.send_once(frames_.frames()[i]);
    if (error != 0) worst = error;
  }
  if (worst == 0) health_.received.fetch_add(1, std::memory_order_relaxed);
  return worst;
}

int CanSink::send_all() noexcept {
  int worst = 0;
  for (std::size_t i = 0; i < settings_.messages.size(); ++i) {
    const auto& m = settings_.messages[i];
    const int error = m.period.ns() > 0 ? bcm_.update(frames_.frames()[i], settings_.announce)
                                        : bcm_.send_once(frames_.frames()[i]);
    if (error != 0) worst = error;
  }
  if (worst == 0) health_.received.fetch_add(1, std::memory_order_relaxed);
  return worst;
}

void CanSink::failed(int error) noexcept {
  if (error == -ENOBUFS || error == -EAGAIN) {
    health_.protocol_errors.fetch_add(
        1, std::memory_order_relaxed);  // the interface's queue is full; it stays up
    return;
  }
  if (!link_is_up_) return;
  link_is_up_ = false;
  health_.connected.store(false, std::memory_order_release);
}

void CanSink::make_safe() {
  frames_.make_safe();
  safe_ = true;  // the frames are; what is sent after an interruption is they
  const int error = link_is_up_ ? send_all() : -ENETDOWN;
  if (error == 0) return;
  counters_.failed.fetch_add(1, std::memory_order_relaxed);
  failed(error);
}

void CanSink::drop_all() {
  Command c;
  while (ring_->try_pop(c)) counters_.dropped.fetch_add(1, std::memory_order_relaxed);
}

void CanSink::look_at_link() {
  next_look_ = monotonic_now() + kLookAtBus;
  if (link_is_up_) {
    // The kernel sends without us; that it cannot is told to the sockets alone.
    if (const int error = bcm_.pending_error(); error != 0) failed(error);
    if (const int error = watcher_.pending_error(); error != 0) failed(error);
    return;
  }
  if (!backoff_.due(monotonic_now())) return;
  const auto info = find_interface(settings_.interface);
  if (!info || !info->up) return backoff_.failed(monotonic_now());
  bcm_.close();
  watcher_.close();
  const RawOptions none{.filters = {}, .receive = false};
  if (!bcm_.open(settings_.interface) || !watcher_.open(settings_.interface, none) || start_all() != 0)
    return backoff_.failed(monotonic_now());
  backoff_.reset();
  link_is_up_ = true;
  health_.reconnects.fetch_add(1, std::memory_order_relaxed);
  health_.connected.store(true, std::memory_order_release);
}

}  // namespace rigor::can
