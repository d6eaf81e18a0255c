#include "drivers/modbus/modbus_sink.h"

#include <algorithm>

namespace rigor::modbus {
namespace {

/// A device that refuses its safe values is asked again after this, not flooded.
constexpr Duration kSafePause = milliseconds(20);
}  // namespace

ModbusSink::~ModbusSink() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status ModbusSink::do_configure(const ChannelConfig& config) {
  settings_ = SinkSettings::parse(config, description_);
  return {};
}

Status ModbusSink::do_arm(const ArmContext& context) {
  if (auto s = open_ring(context.loop_period); !s) return s;
  if (auto s = link_.open(settings_.endpoint); !s)
    return fail(s.error().code, config().name, s.error().text());
  raw_.assign(settings_.map.raw_size(), 0);
  next_raw_ = raw_;
  check_.assign(
      std::max({settings_.map.raw_size(), settings_.safe_map.raw_size(), settings_.watchdog_raw.size()}), 0);
  backoff_.reset();
  next_safe_ = {};
  has_command_ = false;
  if (const auto s = write(settings_.safe_map, settings_.safe_raw); s != LinkStatus::good) {
    const auto why = link_.failure();
    link_.close();
    return fail(s == LinkStatus::exception ? ErrorCode::bad_input : ErrorCode::protocol, config().name,
                "expected the device to take its safe values, got " + why +
                    "; check `table` and `address` against its manual (addresses count from 0)");
  }
  safe_ = true;
  if (!set_watchdog()) {
    const auto why = link_.failure();
    link_.close();
    return fail(ErrorCode::bad_input, config().name,
                "expected the device to take the timeout of its watchdog, got " + why +
                    "; check `watchdog` against its manual");
  }
  health_.connected.store(true, std::memory_order_release);
  start_thread();
  return {};
}

Status ModbusSink::do_stop() {
  stop_thread();
  // One try: a device that is gone now cannot be made safe from here.
  if (!safe_) {
    if (!link_.is_open()) (void)link_.open(settings_.endpoint);
    make_safe();
  }
  link_.close();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

void ModbusSink::tick() {
  if (!link_.is_open()) try_again();
}

void ModbusSink::keep_safe() {
  if (safe_ || !link_.is_open() || monotonic_now() < next_safe_) return;
  make_safe();
  if (!safe_) next_safe_ = monotonic_now() + kSafePause;
}

bool ModbusSink::set_watchdog() {
  return settings_.watchdog_raw.empty() ||
         write(settings_.watchdog_map, settings_.watchdog_raw) == LinkStatus::good;
}

/// So that the device's watchdog knows that its master lives. What was made safe stays so until a new
/// command.
void ModbusSink::after() {
  if (settings_.refresh.ns() == 0 || safe_ || !has_command_ || !link_.is_open() ||
      monotonic_now() < next_refresh_)
    return;
  next_refresh_ = monotonic_now() + settings_.refresh;
  (void)write(settings_.map, raw_);
}

void ModbusSink::apply(const Command& c) {
  if (is_late(bench_now() - c.t_effect)) counters_.late.fetch_add(1, std::memory_order_relaxed);
  const auto count = settings_.map.values().size();
  std::size_t bad = 0;
  if (c.count != count || settings_.map.encode(std::span<const double>(c.value.data(), count), next_raw_,
                                               bad) != EncodeStatus::good) {
    counters_.failed.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  raw_ = next_raw_;
  has_command_ = true;
  safe_ = false;
  next_refresh_ = monotonic_now() + settings_.refresh;
  if (write(settings_.map, raw_) == LinkStatus::good)
    counters_.applied.fetch_add(1, std::memory_order_relaxed);
  else
    counters_.failed.fetch_add(1, std::memory_order_relaxed);
}

LinkStatus ModbusSink::write(const RegisterMap& map, const std::vector<std::uint16_t>& raw) {
  const bool was_open = link_.is_open();
  auto s = link_.write(map, raw);
  if (s == LinkStatus::good && settings_.verify) {
    s = link_.read(map, check_);
    if (s == LinkStatus::good && !map.same(raw, check_)) s = LinkStatus::protocol;
  }
  count_link();
  if (s == LinkStatus::exception || s == LinkStatus::protocol)
    health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
  // A serial port stays open while its device is silent.
  if (s == LinkStatus::good)
    health_.connected.store(true, std::memory_order_release);
  else if (!link_.is_open() || s == LinkStatus::timeout)
    health_.connected.store(false, std::memory_order_release);
  if (was_open && !link_.is_open()) backoff_.reset();  // only just gone: tried again at once
  return s;
}

/// What the link tried by itself belongs to the channel's health.
void ModbusSink::count_link() {
  const auto& n = link_.counters();
  health_.retries.store(repeated_ + n.retries.load(std::memory_order_relaxed), std::memory_order_relaxed);
  health_.reconnects.store(reconnects_ + n.reconnects.load(std::memory_order_relaxed),
                           std::memory_order_relaxed);
}

std::vector<std::string> ModbusSink::warnings() const {
  const auto trouble = link_.counters().trouble();
  if (trouble.empty()) return {};
  return {config().name + ": the device at " + settings_.endpoint.text() + " answered " +
          std::to_string(link_.counters().requests.load(std::memory_order_relaxed)) + " requests with " +
          trouble};
}

void ModbusSink::make_safe() {
  safe_ = write(settings_.safe_map, settings_.safe_raw) == LinkStatus::good;
  if (!safe_) counters_.failed.fetch_add(1, std::memory_order_relaxed);
}

void ModbusSink::try_again() {
  if (!backoff_.due(monotonic_now())) return;
  if (!link_.open(settings_.endpoint)) return backoff_.failed(monotonic_now());
  ++reconnects_;
  backoff_.reset();
  // Nobody knows what the device did meanwhile; it may have been switched off and on.
  (void)set_watchdog();
  if (want_safe_ || !has_command_)
    make_safe();
  else if (write(settings_.map, raw_) == LinkStatus::good)
    ++repeated_;
  count_link();
}

}  // namespace rigor::modbus
