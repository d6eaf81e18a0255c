#include "drivers/usb/scan_keeper.h"

#include <algorithm>
#include <cmath>

namespace rigor::usb {
namespace {

// A clock that shows whole milliseconds is, in the mean, half of one ahead of what it shows.
DeviceTime middle(std::int64_t ms) { return DeviceTime(ms * 1'000'000 + 500'000); }
constexpr double kQuantizationNs = 1e6 * 0.2886751345948129;

}  // namespace

void ScanKeeper::begin(Duration latency, const ScanRequest& request, const ScannerParameters& parameters) {
  latency_ = latency;
  parameters_ = parameters;
  period_ = seconds_from(parameters.turn_s() * (request.interval + 1));
  to_first_step_ = seconds_from(parameters.step_s() * parameters.first_step);
  any_ = false;
}

void ScanKeeper::forget_clock() noexcept {
  map_.reset();
  scip_clock_.reset();
}

void ScanKeeper::reading(const ScipClient::Reading& r) noexcept {
  (void)map_.add_latch(middle(scip_clock_.unwrap(r.ms)), BenchTime(r.before_ns), BenchTime(r.after_ns));
}

ScanKeeper::Kept ScanKeeper::place(const ScipScan& scan, BenchTime arrival,
                                   const RunOrigin& origin) noexcept {
  Stamp stamp;
  const Mapped m = map_.map(middle(scip_clock_.unwrap(scan.stamp_ms)));
  if (m.known) {
    stamp.t_capture = m.t + to_first_step_;
    const double map_ns = static_cast<double>(m.sigma.ns());
    stamp.sigma_capture =
        Duration(std::llround(std::sqrt(map_ns * map_ns + kQuantizationNs * kQuantizationNs)));
  } else {
    stamp.t_capture = arrival - latency_;
    stamp.sigma_capture = period_;
    stamp.validity |= kClockUnsure;
  }
  stamp.t_release = stamp.t_capture + latency_;
  stamp.t_arrival = arrival;
  Kept kept;
  if (!any_ && !origin.covers(stamp.t_capture, period_)) {
    kept.in_run = false;
    return kept;
  }
  const auto steps = [&](Duration d) {
    return static_cast<std::int64_t>(
        std::llround(static_cast<double>(d.ns()) / static_cast<double>(period_.ns())));
  };
  if (any_) {
    if (stamp.t_capture <= stamp_.t_capture) {
      kept.in_order = false;
      return kept;
    }
    const std::int64_t step = std::max<std::int64_t>(1, steps(stamp.t_capture - stamp_.t_capture));
    stamp.sequence = stamp_.sequence + static_cast<std::uint64_t>(step);
    kept.lost = static_cast<std::uint64_t>(step - 1);
  } else {
    stamp.sequence =
        static_cast<std::uint64_t>(std::max<std::int64_t>(0, steps(stamp.t_capture - *origin.get())));
  }
  any_ = true;
  stamp_ = stamp;
  return kept;
}

void ScanKeeper::fill(const ScipScan& scan, Sample& sample) const noexcept {
  sample.stamp = stamp_;
  const auto memory = sample.memory();
  const std::span<LidarPoint> points(reinterpret_cast<LidarPoint*>(memory.data()),
                                     memory.size() / sizeof(LidarPoint));
  const std::size_t count = scan_points(scan, parameters_, points);
  sample.info = PointCloudInfo{static_cast<std::uint32_t>(count)};
  sample.size_bytes = count * sizeof(LidarPoint);
}

std::uint64_t ScanKeeper::missing_by(BenchTime now) noexcept {
  if (!any_) return 0;
  const Duration since = now - stamp_.t_capture - latency_;
  if (since <= period_) return 0;
  const auto missing = static_cast<std::uint64_t>(since / period_);
  any_ = false;
  return missing;
}

}  // namespace rigor::usb
