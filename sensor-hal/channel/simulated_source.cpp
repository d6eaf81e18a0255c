#include "sensor-hal/channel/simulated_source.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "sensor-hal/channel/measurer.h"
#include "sensor-hal/config/sample_size.h"

namespace rigor {
namespace {
constexpr int kWarmCaptures = 5;
constexpr Duration kWarmTimeout = seconds(2);

/// The greatest of 1, 2 and 5 times a power of ten that leaves a fifth of each period free.
double keepable_rate_hz(Duration capture) {
  const double rate_hz = 0.8 / capture.seconds(), decade = std::pow(10, std::floor(std::log10(rate_hz)));
  const double digits = rate_hz / decade;
  return (digits >= 5 ? 5 : digits >= 2 ? 2 : 1) * decade;
}
}  // namespace

SimulatedSource::SimulatedSource(std::shared_ptr<ImageProvider> provider, const MotionSource* motion,
                                 WorkerPool& workers)
    : measurer_(make_measurer(std::move(provider))), motion_(motion), workers_(workers) {}
SimulatedSource::SimulatedSource(std::shared_ptr<SampleProvider> provider, const MotionSource* motion,
                                 WorkerPool& workers)
    : measurer_(make_measurer(std::move(provider))), motion_(motion), workers_(workers) {}

SimulatedSource::SimulatedSource(ProviderMaker make, const MotionSource* motion, WorkerPool& workers)
    : make_(std::move(make)), motion_(motion), workers_(workers) {}

SimulatedSource::~SimulatedSource() { (void)do_stop(); }

Status SimulatedSource::do_configure(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  if (make_) {
    auto made = make_(config);
    if (!made) return tl::unexpected<Error>(made.error());
    measurer_ = std::visit([](auto& provider) { return make_measurer(std::move(provider)); }, *made);
  }
  if (!measurer_)
    return fail(ErrorCode::internal, config.name,
                "a simulated channel was made without something that measures");
  if (config.period.ns() < 0 || config.latency.ns() < 0)
    return fail(ErrorCode::bad_input, n.place(),
                config.name + ": expected a rate and a latency that are not negative");
  if (auto s = measurer_->configure(config, description_); !s) return s;
  const double max_phase_us = config.period.ns() > 0 ? static_cast<double>(config.period.ns()) * 1e-3 : 1e9;
  const auto phase = seconds_from(n.number_or("phase_us", 0, {.min = 0, .max = max_phase_us}) * 1e-6);
  // Those that are between capture and release, and then: visible, application, recorder.
  const std::int64_t in_flight = config.period.ns() > 0 ? config.latency / config.period + 1 : 1;
  slots_ = static_cast<std::size_t>(
      n.integer_or("slots", std::min<std::int64_t>(12 + in_flight, 64), {.min = 1, .max = 4096}));
  check_buffer_memory(n, "slots", slots_, description_.max_bytes);
  max_backlog_ = static_cast<std::uint64_t>(n.integer_or("max_backlog", 2, {.min = 1, .max = 1024}));
  period_ = config.period;
  latency_ = config.latency;
  phase_ = phase;
  return {};
}

Status SimulatedSource::do_arm(const ArmContext& context) {
  virtual_time_ = context.virtual_time;
  immediate_ = measurer_->immediate();
  if (!pool_ || pool_->size() != slots_ || pool_bytes_ != description_.max_bytes) {
    pool_ = make_sample_pool(slots_, description_.max_bytes);
    pool_bytes_ = description_.max_bytes;
  }
  requests_.emplace(slots_ + 1);
  results_.emplace(slots_ + 1);
  releases_ = FixedRing<BenchTime>(slots_ + 1);
  most_waiting_ = description_.max_bytes > 0 ? most_waiting(slots_, virtual_time_) : slots_;
  warm_ = warm_mean_ = {};
  if (!virtual_time_)
    if (auto s = warm_up(); !s) return s;
  strand_ = workers_.make_strand([this] { measure_next(); });
  if (!strand_)
    return fail(ErrorCode::unavailable, config().name, "more simulated channels than the worker pool takes");
  return {};
}

/// The first capture compiles shaders and builds what the world needs; those after it are the ones that
/// count.
Status SimulatedSource::warm_up() {
  SampleSlot slot = pool_->try_acquire();
  if (!slot) return {};  // all of them are still held since the last run: it is warm
  SampleProvider::Request request;
  const auto begin = monotonic_now();
  Duration sum;
  for (int k = 0; k <= kWarmCaptures; ++k) {
    const auto before = monotonic_now();
    request.t_capture = request.t_start = BenchTime(before.ns());
    if (motion_) request.motion = motion_->motion_at(request.t_capture);
    if (auto s = measurer_->measure(request, *slot); !s) return s;
    const auto after = monotonic_now();
    if (k > 0 || after - begin > kWarmTimeout) warm_ = std::max(warm_, after - before);
    if (k > 0) warm_mean_ = (sum = sum + (after - before)) / k;
    if (after - begin > kWarmTimeout) break;
  }
  return {};
}

std::vector<std::string> SimulatedSource::warnings() const {
  if (warm_ <= latency_) return {};
  char text[200];
  std::snprintf(text, sizeof text,
                ": one sample took up to %.3g ms to compute, which is longer than its latency_ms of %.3g: "
                "samples will be late",
                warm_.seconds() * 1e3, latency_.seconds() * 1e3);
  return {config().name + text};
}

std::vector<std::string> SimulatedSource::forecasts() const {
  char text[250];
  if (period_.ns() <= 0 || warm_mean_.ns() <= period_.ns()) return {};
  std::string channel = config().name;
  if (const std::string side = ".simulated"; channel.ends_with(side))
    channel.resize(channel.size() - side.size());
  const char* const what = description_.kind == SampleKind::image         ? "picture"
                           : description_.kind == SampleKind::point_cloud ? "scan"
                                                                          : "sample";
  std::snprintf(text, sizeof text,
                ": a %s takes %.3g ms of its %.3g ms period on this machine; samples will be lost; a rate "
                "that it can keep is ",
                what, warm_mean_.seconds() * 1e3, period_.seconds() * 1e3);
  std::string warning = channel + text;
  std::snprintf(text, sizeof text, ".rate_hz=%g", keepable_rate_hz(warm_mean_));
  return {warning + "channels." + channel + text};
}

Status SimulatedSource::do_start(BenchTime t0) {
  t_start_ = t0;
  next_capture_ = t0 + phase_;
  next_index_ = 0;
  on_grid_ = false;
  lost_before_ = 0;
  slot_wait_.begin(virtual_time_);
  failed_before_.store(0, std::memory_order_relaxed);
  releases_.clear();
  completed_ = 0;
  running_ = true;
  health_.connected.store(true, std::memory_order_relaxed);
  return {};
}

Status SimulatedSource::do_stop() {
  running_ = false;
  health_.connected.store(false, std::memory_order_relaxed);
  strand_.reset();  // waits for the sample that is being measured
  requests_.reset();
  results_.reset();
  return {};
}

void SimulatedSource::begin_cycle(BenchTime now) noexcept {
  if (!running_ || period_.ns() <= 0) return;
  on_grid_ = true;
  while (next_capture_ <= now) request_next();
}

void SimulatedSource::request_next() noexcept {
  (void)request_at(next_index_, next_capture_);
  ++next_index_;
  next_capture_ = t_start_ + phase_ + period_ * static_cast<std::int64_t>(next_index_);
}

bool SimulatedSource::request_at(std::uint64_t index, BenchTime t_capture) noexcept {
  if (!running_) return false;
  if (!virtual_time_ && !immediate_ && strand_->backlog() > max_backlog_) {
    health_.lost.fetch_add(1, std::memory_order_relaxed);
    ++lost_before_;
    return false;
  }
  Request request;
  if (results_->size_approx() < most_waiting_) request.slot = slot_wait_.acquire(*pool_);
  if (!request.slot) {
    health_.no_slot.fetch_add(1, std::memory_order_relaxed);
    ++lost_before_;
    return false;
  }
  request.what.index = index;
  request.what.t_capture = t_capture;
  request.what.t_start = t_start_;
  if (motion_) request.what.motion = motion_->motion_at(t_capture);
  request.lost_before = std::exchange(lost_before_, 0);
  if (immediate_) {
    measure(request);
    return true;
  }
  // There is a place for each slot, so this cannot fail.
  if (!requests_->try_push(std::move(request))) {
    health_.ring_full.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  if (virtual_time_) {
    // More than there are slots only where captures failed, and then the oldest is done.
    if (releases_.full()) ++completed_;
    releases_.push_newest(t_capture + latency_);
  }
  strand_->submit();
  return true;
}

void SimulatedSource::measure_next() {
  Request request;
  if (requests_->try_pop(request)) measure(request);
}

void SimulatedSource::measure(Request& request) {
  Sample& sample = *request.slot;
  const SampleProvider::Request& r = request.what;
  const Status captured = measurer_->measure(r, sample);
  const auto end = monotonic_now();
  if (!captured) {
    health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
    health_.lost.fetch_add(1, std::memory_order_relaxed);
    failed_before_.fetch_add(1 + request.lost_before, std::memory_order_relaxed);
    return;
  }
  Stamp& s = sample.stamp;
  s = Stamp{};
  s.sequence = r.index;
  s.t_capture = r.t_capture;
  s.t_release = r.t_capture + latency_;
  s.t_arrival = virtual_time_ ? s.t_release : BenchTime(end.ns());
  s.lost_before = request.lost_before + failed_before_.exchange(0, std::memory_order_relaxed);
  health_.received.fetch_add(1, std::memory_order_relaxed);
  if (!results_->try_push(std::move(request.slot))) health_.ring_full.fetch_add(1, std::memory_order_relaxed);
}

SampleLease SimulatedSource::poll(BenchTime) noexcept {
  SampleLease sample;
  if (running_) (void)results_->try_pop(sample);
  return sample;
}

void SimulatedSource::complete_until(BenchTime now) {
  if (!running_) return;
  // Captured since the last cycle, and due in this one: the next begin_cycle would come too late for them.
  while (on_grid_ && next_capture_ < now && next_capture_ + latency_ <= now) request_next();
  for (; !releases_.empty() && releases_.front() <= now; ++completed_) releases_.pop_front();
  strand_->wait_for(completed_);
}

}  // namespace rigor
