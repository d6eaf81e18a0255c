#include "sensor-hal/channel/simulated_source.h"

#include <algorithm>

namespace rigor {
namespace {
constexpr int kMaxNaps = 2000;  // of 0.1 ms
}

SimulatedSource::SimulatedSource(std::shared_ptr<ImageProvider> provider, const MotionSource* motion,
                                 WorkerPool& workers)
    : provider_(std::move(provider)), motion_(motion), workers_(workers) {}

SimulatedSource::~SimulatedSource() { (void)do_stop(); }

Status SimulatedSource::do_configure(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  if (!provider_)
    return fail(ErrorCode::internal, config.name,
                "a simulated channel was made without something that measures");
  if (config.kind != SampleKind::image)
    return fail(
        ErrorCode::bad_input, n.place(),
        config.name + ": expected `kind: image`, which is what this simulator makes; got another kind");
  if (config.period.ns() < 0 || config.latency.ns() < 0)
    return fail(ErrorCode::bad_input, n.place(),
                config.name + ": expected a rate and a latency that are not negative");

  const auto sensor = provider_->geometry();
  ImageRequest r;
  const double default_us = static_cast<double>(sensor.exposure.ns()) * 1e-3;
  r.exposure = seconds_from(
      n.number_or("exposure_us", default_us, {.min = 0, .max = 60e6, .exclusive_min = true}) * 1e-6);
  r.gain_db = n.number_or("gain_db", 0, {.min = -40, .max = 80});
  std::vector<std::string> formats;
  for (PixelFormat f : {PixelFormat::mono8, PixelFormat::mono12p, PixelFormat::mono16, PixelFormat::bayer_rg8,
                        PixelFormat::rgb8})
    formats.emplace_back(pfnc_name(f));
  r.format = *pixel_format_from(n.choice_or("pixel_format", formats, std::string(pfnc_name(sensor.format))));
  r.width_px = sensor.width_px;
  r.height_px = sensor.height_px;
  if (const ConfigNode region = n.map_or_absent("region"); region.present()) {
    const auto pixels = [&](const char* key, std::int64_t min, std::int64_t max) {
      return static_cast<std::uint32_t>(
          region.integer(key, {.min = static_cast<double>(min), .max = static_cast<double>(max)}));
    };
    r.offset_x_px = pixels("x_px", 0, std::int64_t{sensor.width_px} - 1);
    r.offset_y_px = pixels("y_px", 0, std::int64_t{sensor.height_px} - 1);
    r.width_px = pixels("width_px", 1, std::int64_t{sensor.width_px} - r.offset_x_px);
    r.height_px = pixels("height_px", 1, std::int64_t{sensor.height_px} - r.offset_y_px);
    region.finish();
  }
  const double max_phase_us = config.period.ns() > 0 ? static_cast<double>(config.period.ns()) * 1e-3 : 1e9;
  const auto phase = seconds_from(n.number_or("phase_us", 0, {.min = 0, .max = max_phase_us}) * 1e-6);
  // Those that are between capture and release, and then: visible, application, recorder.
  const std::int64_t in_flight = config.period.ns() > 0 ? config.latency / config.period + 1 : 1;
  slots_ = static_cast<std::size_t>(
      n.integer_or("slots", std::min<std::int64_t>(12 + in_flight, 64), {.min = 1, .max = 4096}));
  max_backlog_ = static_cast<std::uint64_t>(n.integer_or("max_backlog", 2, {.min = 1, .max = 1024}));

  prototype_ = r;
  period_ = config.period;
  latency_ = config.latency;
  phase_ = phase;
  description_.kind = SampleKind::image;
  description_.frame_id = sensor.frame_id.empty() ? config.name + "_optical" : sensor.frame_id;
  description_.width_px = r.width_px;
  description_.height_px = r.height_px;
  description_.format = r.format;
  description_.max_bytes = image_bytes(r.format, r.width_px, r.height_px);
  return {};
}

Status SimulatedSource::do_arm(const ArmContext& context) {
  virtual_time_ = context.virtual_time;
  if (!pool_ || pool_->size() != slots_ || pool_bytes_ != description_.max_bytes) {
    // Somebody may still hold pictures of the last run: their memory stays as long as the source does.
    if (pool_ && pool_->in_use() != 0) retired_.push_back(std::move(pool_));
    pool_ = make_sample_pool(slots_, description_.max_bytes);
    pool_bytes_ = description_.max_bytes;
  }
  requests_.emplace(slots_ + 1);
  results_.emplace(slots_ + 1);
  releases_.assign(slots_ + 1, BenchTime());
  strand_ = workers_.make_strand([this] { render_next(); });
  if (!strand_)
    return fail(ErrorCode::unavailable, config().name, "more simulated channels than the worker pool takes");
  return {};
}

Status SimulatedSource::do_start(BenchTime t0) {
  next_capture_ = t0 + phase_;
  next_index_ = 0;
  lost_before_ = 0;
  failed_before_.store(0, std::memory_order_relaxed);
  dispatched_ = completed_ = 0;
  running_ = true;
  health_.connected.store(true, std::memory_order_relaxed);
  return {};
}

Status SimulatedSource::do_stop() {
  running_ = false;
  health_.connected.store(false, std::memory_order_relaxed);
  strand_.reset();  // waits for the picture that is being rendered
  requests_.reset();
  results_.reset();
  return {};
}

void SimulatedSource::begin_cycle(BenchTime now) noexcept {
  if (!running_ || period_.ns() <= 0) return;
  while (next_capture_ <= now) {
    (void)request_at(next_index_, next_capture_);
    ++next_index_;
    next_capture_ = next_capture_ + period_;
  }
}

bool SimulatedSource::request_at(std::uint64_t index, BenchTime t_capture) noexcept {
  if (!running_) return false;
  if (!virtual_time_ && strand_->backlog() > max_backlog_) {
    health_.lost.fetch_add(1, std::memory_order_relaxed);
    ++lost_before_;
    return false;
  }
  Request request;
  request.slot = pool_->try_acquire();
  // In virtual time a slot that another thread (the recorder, a digest) is about to let go of is waited for,
  // so that the run does not depend on when it does. What the loop itself holds it will not let go of
  // meanwhile.
  for (int naps = 0; virtual_time_ && !request.slot && naps < kMaxNaps; ++naps) {
    const timespec nap{0, 100'000};
    nanosleep(&nap, nullptr);
    request.slot = pool_->try_acquire();
  }
  if (!request.slot) {
    health_.no_slot.fetch_add(1, std::memory_order_relaxed);
    ++lost_before_;
    return false;
  }
  request.image = prototype_;
  request.image.index = index;
  request.image.t_capture = t_capture;
  if (motion_) request.image.motion = motion_->motion_at(t_capture);
  request.lost_before = std::exchange(lost_before_, 0);
  releases_[dispatched_ % releases_.size()] = t_capture + latency_;
  // There is a place for each slot, so this cannot fail.
  if (!requests_->try_push(std::move(request))) {
    health_.ring_full.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  ++dispatched_;
  strand_->submit();
  return true;
}

void SimulatedSource::render_next() {
  Request request;
  if (!requests_->try_pop(request)) return;
  Sample& sample = request.slot.edit();
  const ImageRequest& r = request.image;
  sample.size_bytes = image_bytes(r.format, r.width_px, r.height_px);
  const auto begin = monotonic_now();
  const Status captured = provider_->capture(r, sample.memory().first(sample.size_bytes));
  const auto end = monotonic_now();
  if (const auto ns = (end - begin).ns(); ns > longest_ns_.load(std::memory_order_relaxed))
    longest_ns_.store(ns, std::memory_order_relaxed);
  if (!captured) {
    health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
    health_.lost.fetch_add(1, std::memory_order_relaxed);
    failed_before_.fetch_add(1 + request.lost_before, std::memory_order_relaxed);
    return;
  }
  ImageInfo info;
  info.format = r.format;
  info.width_px = r.width_px;
  info.height_px = r.height_px;
  info.offset_x_px = r.offset_x_px;
  info.offset_y_px = r.offset_y_px;
  info.exposure = r.exposure;
  info.gain_db = r.gain_db;
  sample.info = info;
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
  while (completed_ < dispatched_ && releases_[completed_ % releases_.size()] <= now) ++completed_;
  strand_->wait_for(completed_);
}

}  // namespace rigor
