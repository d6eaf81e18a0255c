#include "drivers/modbus/modbus_source.h"

#include <algorithm>

namespace rigor::modbus {
namespace {

constexpr Duration kFirstPause = milliseconds(50), kLongestPause = seconds(2);

/// Seen from setup: the device is there, but these are not its registers.
Status refused(const std::string& channel, const Link& link, LinkStatus s) {
  const auto code = s == LinkStatus::exception ? ErrorCode::bad_input : ErrorCode::protocol;
  return fail(
      s == LinkStatus::timeout ? ErrorCode::timeout : code, channel,
      "expected the device to answer for its registers, got " + link.failure() +
          (s == LinkStatus::exception ? "; check `table` and `address` against its manual (addresses count "
                                        "from 0)"
                                      : "; check that it is a Modbus TCP device, and its `unit`"));
}

}  // namespace

ModbusSource::~ModbusSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status ModbusSource::do_configure(const ChannelConfig& config) {
  settings_ = SourceSettings::parse(config, description_);
  return {};
}

Status ModbusSource::do_arm(const ArmContext& context) {
  if (context.virtual_time)
    return fail(ErrorCode::wrong_state, config().name,
                "expected a wall-clock run, got virtual time: name the device's emulator with `emulated_by`");
  if (auto s = deadline_.open(); !s) return s;
  if (auto s = link_.open(settings_.endpoint); !s)
    return fail(s.error().code, config().name, s.error().text());
  raw_.assign(settings_.map.raw_size(), 0);
  if (const auto s = link_.read(settings_.map, raw_); s != LinkStatus::good) {
    auto error = refused(config().name, link_, s);
    link_.close();
    return error;
  }
  // Leases of an earlier run may still be held, so a pool that fits is kept. The ring goes first: it holds
  // some.
  const auto slots = pool_slots(config());
  ring_.reset();
  if (!pool_ || pool_->size() < slots) pool_ = make_sample_pool(slots, 0);
  ring_ = std::make_unique<SpscRing<SampleLease>>(slots);
  pause_ = kFirstPause;
  next_attempt_ = {};
  health_.connected.store(true, std::memory_order_release);
  return {};
}

Status ModbusSource::do_start(BenchTime t0) {
  deadline_.reset();
  thread_ = std::thread([this, t0] { run(t0); });
  return {};
}

Status ModbusSource::do_stop() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  // What nobody polled is given back; a stopped channel has no samples.
  SampleLease left;
  while (ring_->try_pop(left)) {
  }
  link_.close();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

SampleLease ModbusSource::poll(BenchTime) noexcept {
  SampleLease lease;
  if (ring_) (void)ring_->try_pop(lease);
  return lease;
}

void ModbusSource::run(BenchTime t0) {
  const auto period = config().period.ns();
  std::uint32_t lost = 0;
  std::int64_t k = std::max<std::int64_t>(0, (monotonic_now().ns() - t0.ns() + period - 1) / period);
  while (deadline_.wait_until(MonotonicTime(t0.ns() + k * period))) {
    if (!link_.is_open()) try_again();
    if (link_.is_open()) {
      read_once(static_cast<std::uint64_t>(k), lost);
    } else {
      health_.lost.fetch_add(1, std::memory_order_relaxed);
      ++lost;
    }
    // An answer that took longer than the period has cost the instants it ran over; the grid stays where it
    // is.
    const auto now = monotonic_now().ns();
    const auto next = std::max(k + 1, (now - t0.ns() - period / 2 + period - 1) / period);
    const auto skipped = next - (k + 1);
    health_.lost.fetch_add(static_cast<std::uint64_t>(skipped), std::memory_order_relaxed);
    lost += static_cast<std::uint32_t>(skipped);
    k = next;
  }
}

void ModbusSource::try_again() {
  const auto now = monotonic_now();
  if (now < next_attempt_) return;
  if (link_.open(settings_.endpoint)) {
    health_.reconnects.fetch_add(1, std::memory_order_relaxed);
    pause_ = kFirstPause;
    return;
  }
  next_attempt_ = monotonic_now() + pause_;
  pause_ = std::min(pause_ * 2, kLongestPause);
}

void ModbusSource::read_once(std::uint64_t index, std::uint32_t& lost) {
  const auto before = monotonic_now();
  const auto status = link_.read(settings_.map, raw_);
  const auto after = monotonic_now();
  if (status != LinkStatus::good) {
    health_.lost.fetch_add(1, std::memory_order_relaxed);
    ++lost;
    if (status == LinkStatus::exception || status == LinkStatus::protocol)
      health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
    if (link_.is_open()) return;
    // The first attempt follows at once: a device that lost one connection mostly takes the next.
    next_attempt_ = after;
    if (status == LinkStatus::timeout) health_.retries.fetch_add(1, std::memory_order_relaxed);
    health_.connected.store(false, std::memory_order_release);
    return;
  }
  health_.connected.store(true, std::memory_order_release);
  health_.received.fetch_add(1, std::memory_order_relaxed);
  auto lease = pool_->try_acquire();
  if (!lease) {
    health_.no_slot.fetch_add(1, std::memory_order_relaxed);
    ++lost;
    return;
  }
  auto& sample = lease.edit();
  fill_sample(sample, settings_.map, raw_);
  const auto round_trip = after - before;
  sample.stamp.sequence = index;
  sample.stamp.t_capture = BenchTime(before.ns() + round_trip.ns() / 2);
  sample.stamp.t_release = sample.stamp.t_capture + config().latency;
  sample.stamp.t_arrival = BenchTime(after.ns());
  sample.stamp.sigma_capture =
      Duration(static_cast<std::int64_t>(static_cast<double>(round_trip.ns()) * 0.2886751));
  sample.stamp.lost_before = lost;
  if (ring_->try_push(std::move(lease))) {
    lost = 0;
  } else {
    health_.ring_full.fetch_add(1, std::memory_order_relaxed);
    ++lost;
  }
}

}  // namespace rigor::modbus
