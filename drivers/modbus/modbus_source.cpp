#include "drivers/modbus/modbus_source.h"

#include <algorithm>
#include <cstring>

#include "rt-core/time_slice.h"

namespace rigor::modbus {
namespace {

constexpr std::size_t kEvents = 32;

/// Seen from setup: the device is there, but these are not its registers.
Status refused(const std::string& channel, const Endpoint& endpoint, const Link& link, LinkStatus s) {
  const auto code = s == LinkStatus::exception ? ErrorCode::bad_input : ErrorCode::protocol;
  const char* silent = endpoint.serial ? "; check that the device is on, and its `unit`, `baud` and `parity`"
                                       : "; check that it is a Modbus TCP device, and its `unit`";
  return fail(
      s == LinkStatus::timeout ? ErrorCode::timeout : code, channel,
      "expected the device to answer for its registers, got " + link.failure() +
          (s == LinkStatus::exception ? "; check `table` and `address` against its manual (addresses count "
                                        "from 0)"
                                      : silent));
}

}  // namespace

ModbusSource::~ModbusSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status ModbusSource::do_configure(const ChannelConfig& config) {
  settings_ = SourceSettings::parse(config, description_);
  return {};
}

Status ModbusSource::do_arm(const ArmContext&) {
  if (auto s = deadline_.open(); !s) return s;
  if (auto s = link_.open(settings_.endpoint); !s)
    return fail(s.error().code, config().name, s.error().text());
  raw_.assign(settings_.map.raw_size(), 0);
  poller_ = Poller(settings_.map);
  if (const auto s = poller_.poll(link_, 0, raw_); s != LinkStatus::good) {
    auto error = refused(config().name, settings_.endpoint, link_, s);
    link_.close();
    return error;
  }
  poller_.forget();  // that was to see whether they are there; the run asks for its own
  open_stream(pool_slots(config()), 0, false);
  events_ = std::make_unique<SpscRing<SampleLease>>(kEvents);
  if (!event_pool_) event_pool_ = make_sample_pool(2 * kEvents, 0);
  last_event_ = kEventBack;
  backoff_.reset();
  health_.connected.store(true, std::memory_order_release);
  thread_ = std::thread([this] { run(); });
  return {};
}

Status ModbusSource::do_stop() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  close_stream();
  SampleLease left;
  while (events_->try_pop(left)) {
  }
  link_.close();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

SampleLease ModbusSource::poll_event() noexcept {
  SampleLease lease;
  if (events_) (void)events_->try_pop(lease);
  return lease;
}

std::vector<std::string> ModbusSource::warnings() const {
  const auto trouble = link_.counters().trouble();
  if (trouble.empty()) return {};
  return {config().name + ": the device at " + settings_.endpoint.text() + " answered " +
          std::to_string(link_.counters().requests.load(std::memory_order_relaxed)) + " requests with " +
          trouble};
}

void ModbusSource::run() {
  ask_for_time_slice(kShortTimeSlice);
  const auto origin_known = origin().wait(deadline_);
  if (!origin_known) return;
  const BenchTime t0 = *origin_known;
  const Period period = config().period;
  std::int64_t k = period.first_index_from(bench_now() - t0);
  while (deadline_.wait_until(MonotonicTime((t0 + period * k).ns()))) {
    if (!link_.is_open()) try_again();
    if (link_.is_open()) {
      read_once(static_cast<std::uint64_t>(k));
    } else {
      count_lost(1);
    }
    // An answer that took longer than the period has cost the instants it ran over; the grid stays where it
    // is.
    const auto next = std::max(k + 1, period.first_index_from(bench_now() - t0 - period / 2));
    count_lost(static_cast<std::uint64_t>(next - (k + 1)));
    k = next;
  }
}

void ModbusSource::try_again() {
  if (!backoff_.due(monotonic_now())) return;
  if (link_.open(settings_.endpoint)) {
    ++reconnects_;
    count_link();
    backoff_.reset();
    poller_.forget();
    return;
  }
  backoff_.failed(monotonic_now());
}

/// What the link tried by itself belongs to the channel's health.
void ModbusSource::count_link() {
  const auto& n = link_.counters();
  health_.retries.store(n.retries.load(std::memory_order_relaxed), std::memory_order_relaxed);
  health_.reconnects.store(reconnects_ + n.reconnects.load(std::memory_order_relaxed),
                           std::memory_order_relaxed);
}

void ModbusSource::read_once(std::uint64_t index) {
  const auto before = monotonic_now();
  const auto status = poller_.poll(link_, index, raw_);
  const auto after = monotonic_now();
  count_link();
  if (status != LinkStatus::good) return failed(status);
  if (last_event_ != kEventBack) tell(kEventBack, 0, "the device answers again");
  health_.connected.store(true, std::memory_order_release);
  auto slot = take_slot();
  if (slot) {
    auto& sample = *slot;
    fill_sample(sample, settings_.map, raw_);
    const auto round_trip = after - before;
    sample.stamp.sequence = index;
    sample.stamp.t_capture = BenchTime(before.ns() + round_trip.ns() / 2);
    sample.stamp.t_release = sample.stamp.t_capture + config().latency;
    sample.stamp.t_arrival = BenchTime(after.ns());
    sample.stamp.sigma_capture =
        Duration(static_cast<std::int64_t>(static_cast<double>(round_trip.ns()) * 0.2886751));
  }
  hand_over(std::move(slot));
}

void ModbusSource::failed(LinkStatus status) {
  count_lost(1);
  if (status == LinkStatus::exception || status == LinkStatus::protocol)
    health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
  const auto& n = link_.counters();
  const auto count = [](const std::atomic<std::uint64_t>& c) {
    return static_cast<double>(c.load(std::memory_order_relaxed));
  };
  switch (status) {
    case LinkStatus::exception:
      tell(link_.exception_code(), count(n.exceptions[link_.exception_code() % kExceptionCodes]),
           "the device refuses: " + link_.failure());
      return;  // it is there
    case LinkStatus::timeout:
      tell(kEventSilent, count(n.timeouts), "no answer: " + link_.failure());
      break;
    case LinkStatus::protocol:
      tell(kEventBroken, count(n.broken), "an answer that makes no sense: " + link_.failure());
      break;
    default:
      tell(kEventGone, 0, "the device is gone: " + link_.failure());
  }
  // The first attempt follows at once: a device that lost one connection mostly takes the next.
  if (!link_.is_open()) backoff_.reset();
  if (status != LinkStatus::protocol || !link_.is_open())
    health_.connected.store(false, std::memory_order_release);
}

void ModbusSource::tell(std::uint32_t code, double value, const std::string& text) {
  if (code == last_event_) return;
  last_event_ = code;
  auto slot = event_pool_->try_acquire();
  if (!slot) return;
  auto& sample = *slot;
  EventInfo info{.code = code, .value = value};
  std::strncpy(info.text.data(), text.c_str(), info.text.size() - 1);
  sample.info = info;
  sample.size_bytes = 0;
  sample.stamp = {};
  sample.stamp.t_capture = sample.stamp.t_release = sample.stamp.t_arrival = bench_now();
  (void)events_->try_push(std::move(slot));  // told to nobody: the counters have it all the same
}

}  // namespace rigor::modbus
