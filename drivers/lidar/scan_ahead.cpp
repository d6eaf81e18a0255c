#include "drivers/lidar/scan_ahead.h"

#include <pthread.h>

#include <algorithm>
#include <cmath>

#include "rt-core/time_slice.h"

namespace rigor::packet_lidar {

Status measure_scan(SampleProvider& samples, std::uint64_t index, BenchTime t_begin,
                    const WorldMotion& motion, double turn_rad, Sample& sample, Scan& out) {
  out.index = index;
  out.seen = false;
  SampleProvider::Request request;
  request.index = index;
  request.t_capture = t_begin;
  request.t_start = t_begin;
  request.motion = motion;
  request.turn_rad = turn_rad;
  if (auto s = samples.capture(request, sample); !s) return s;
  const auto* cloud = sample.as<PointCloudInfo>();
  if (!cloud || sample.size_bytes != cloud->count * sizeof(LidarPoint))
    return fail(ErrorCode::internal, "sensor", "expected a point cloud");
  static_assert(alignof(LidarPoint) <= alignof(std::max_align_t));
  out.grid.fill({reinterpret_cast<const LidarPoint*>(sample.bytes().data()), cloud->count}, turn_rad);
  out.seen = true;
  return {};
}

ScanAhead::ScanAhead(Options options) : options_(std::move(options)) {}

Status ScanAhead::prepare() {
  Scan scratch = options_.empty;
  for (int i = 0; i < 2; ++i) {
    const BenchTime began(monotonic_now().ns());
    const WorldMotion motion = options_.motion ? options_.motion->motion_at(began) : WorldMotion{};
    if (auto s = options_.measure(0, began, motion, scratch); !s) return s;
    measuring_time_ = bench_now() - began;
  }
  return {};
}

void ScanAhead::start(BenchTime t_start) {
  t_start_ = t_start;
  scans_.assign(kKept, options_.empty);
  measured_ = sending_ = 0;
  stop_ = false;
  thread_ = std::thread([this] { run(); });
}

void ScanAhead::stop() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

std::uint64_t ScanAhead::next_scan() const {
  // Where measuring takes longer than a scan, those that would come too late are left out.
  const double ready = (bench_now() + measuring_time_ - t_start_).seconds();
  const double in_time = std::max(0.0, std::floor(ready / options_.scan_time.seconds()) + 1);
  return std::max(measured_, std::min(static_cast<std::uint64_t>(in_time), sending_ + kKept - 2));
}

void ScanAhead::run() {
  ask_for_time_slice(kLongTimeSlice);
  pthread_setname_np(pthread_self(), options_.thread);
  Scan scratch = options_.empty;
  while (true) {
    std::uint64_t k = 0;
    {
      std::unique_lock lock(mutex_);
      // A slot is free once its scan is two behind the one that is being sent.
      changed_.wait(lock, [&] { return stop_ || measured_ <= sending_ + kAhead; });
      if (stop_) return;
      k = next_scan();
    }
    const BenchTime begin = t_start_ + options_.begin(k);
    const BenchTime now(monotonic_now().ns());
    WorldMotion motion;
    if (options_.motion) motion = options_.motion->motion_at(std::min(begin, now));
    if (!options_.measure(k, begin, motion, scratch) && options_.failures)
      options_.failures->fetch_add(1, std::memory_order_relaxed);
    const std::lock_guard lock(mutex_);
    // A machine that is busy now is busy a little longer.
    measuring_time_ = std::max(bench_now() - now, measuring_time_ * 3 / 4);
    std::swap(scratch, scans_[k % kKept]);
    measured_ = k + 1;
  }
}

void ScanAhead::use(std::uint64_t last, const std::function<void(const Of&)>& f) {
  const std::lock_guard lock(mutex_);
  if (last > sending_) {
    sending_ = last;
    changed_.notify_all();
  }
  f([this](std::uint64_t k) -> const Scan* {
    const Scan& s = scans_[k % kKept];
    return s.seen && s.index == k ? &s : nullptr;
  });
}

}  // namespace rigor::packet_lidar
