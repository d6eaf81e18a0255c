#include "sensor-hal/channel/pair_statistics.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "sensor-hal/channel/pair_monitor.h"
#include "sensor-hal/channel/pair_values.h"

namespace rigor {
namespace {

struct IntegerSums {
  std::uint64_t count = 0;
  std::int64_t sum = 0, squares = 0;
  void add(std::int64_t d) noexcept {
    sum += d;
    squares += d * d;
  }
};

void add_bytes(IntegerSums& s, const std::byte* a, const std::byte* b, std::size_t n) noexcept {
  // 32-bit sums of short runs let the compiler vectorise: 8192 · 255² < 2³¹.
  for (std::size_t at = 0; at < n;) {
    const std::size_t end = std::min(n, at + 8192);
    std::int32_t sum = 0, squares = 0;
    for (; at < end; ++at) {
      const std::int32_t d = static_cast<std::int32_t>(a[at]) - static_cast<std::int32_t>(b[at]);
      sum += d;
      squares += d * d;
    }
    s.sum += sum;
    s.squares += squares;
  }
  s.count += n;
}

void add_words(IntegerSums& s, const std::byte* a, const std::byte* b, std::size_t n) noexcept {
  for (std::size_t i = 0; i < n; ++i) {
    std::uint16_t x, y;
    std::memcpy(&x, a + 2 * i, 2);
    std::memcpy(&y, b + 2 * i, 2);
    s.add(std::int64_t{x} - std::int64_t{y});
  }
  s.count += n;
}

/// Pixel `i` of a Mono12p picture: two pixels in three bytes, the first in the low twelve bits.
std::int64_t mono12p(const std::byte* data, std::size_t i) noexcept {
  const std::byte* at = data + i * 12 / 8;
  const unsigned low = static_cast<unsigned>(at[0]), high = static_cast<unsigned>(at[1]);
  return i % 2 == 0 ? (low | (high & 0x0f) << 8) : (low >> 4 | high << 4);
}

}  // namespace

std::optional<Difference> difference_of_images(const Sample& real, const Sample& simulated) noexcept {
  const auto* a = real.as<ImageInfo>();
  const auto* b = simulated.as<ImageInfo>();
  if (!a || !b || a->format != b->format || a->width_px != b->width_px || a->height_px != b->height_px)
    return {};
  if ((real.stamp.validity | simulated.stamp.validity) & (kIncomplete | kCorrupt)) return {};
  const std::size_t bytes = image_bytes(a->format, a->width_px, a->height_px);
  if (bytes == 0 || real.size_bytes != bytes || simulated.size_bytes != bytes) return {};

  const std::size_t row_elements = is_yuv(a->format)
                                       ? bytes / a->height_px
                                       : std::size_t{a->width_px} * (a->format == PixelFormat::rgb8 ? 3 : 1);
  const std::size_t step =
      (row_elements * a->height_px + PairStatistics::kMaxElements - 1) / PairStatistics::kMaxElements;
  const std::byte* x = real.bytes().data();
  const std::byte* y = simulated.bytes().data();
  IntegerSums s;
  for (std::size_t row = 0; row < a->height_px; row += step) {
    const std::size_t first = row * row_elements;
    switch (a->format) {
      case PixelFormat::mono8:
      case PixelFormat::bayer_rg8:
      case PixelFormat::rgb8:
      case PixelFormat::yuv422_8:
      case PixelFormat::yuv420_sp:
        add_bytes(s, x + first, y + first, row_elements);
        break;
      case PixelFormat::mono10:
      case PixelFormat::mono12:
      case PixelFormat::mono16:
      case PixelFormat::bayer_rg10:
      case PixelFormat::bayer_rg12:
      case PixelFormat::bayer_rg16:
      case PixelFormat::coord3d_c16:
        add_words(s, x + 2 * first, y + 2 * first, row_elements);
        break;
      case PixelFormat::mono12p:
        for (std::size_t i = first; i < first + row_elements; ++i) s.add(mono12p(x, i) - mono12p(y, i));
        s.count += row_elements;
        break;
    }
  }
  const auto n = static_cast<double>(s.count);
  Difference d;
  d.count = s.count;
  d.bias = static_cast<double>(s.sum) / n;
  d.sigma =
      std::sqrt(std::max(0.0, (static_cast<double>(s.squares) - d.bias * static_cast<double>(s.sum)) / n));
  return d;
}

namespace {

struct RangeSums {
  std::uint64_t count = 0;
  double mean = 0, m2 = 0;
  void add(double d) noexcept {
    ++count;
    const double delta = d - mean;
    mean += delta / static_cast<double>(count);
    m2 += delta * (d - mean);
  }
  [[nodiscard]] std::optional<Difference> result() const noexcept {
    if (count == 0) return {};
    return Difference{count, mean, std::sqrt(m2 / static_cast<double>(count))};
  }
};

template <class T>
T item(std::span<const std::byte> bytes, std::size_t i) noexcept {
  T t;
  std::memcpy(&t, bytes.data() + i * sizeof t, sizeof t);
  return t;
}

double range_of(const LidarPoint& p) noexcept { return std::hypot(p.x_m, p.y_m, p.z_m); }

std::optional<Difference> difference_of_clouds(const Sample& real, const Sample& simulated,
                                               std::uint32_t real_count, std::uint32_t count) noexcept {
  if (real.size_bytes != real_count * sizeof(LidarPoint) ||
      simulated.size_bytes != count * sizeof(LidarPoint))
    return {};
  RangeSums sums;
  std::size_t first = 0;
  for (std::size_t i = 0; i < real_count; ++i) {
    const auto a = item<LidarPoint>(real.bytes(), i);
    while (first < count && item<LidarPoint>(simulated.bytes(), first).t_offset_ns < a.t_offset_ns) ++first;
    for (std::size_t k = first; k < count; ++k) {
      const auto b = item<LidarPoint>(simulated.bytes(), k);
      if (b.t_offset_ns != a.t_offset_ns) break;
      if (b.ring != a.ring || b.return_index != a.return_index) continue;
      sums.add(range_of(a) - range_of(b));
      break;
    }
  }
  return sums.result();
}

}  // namespace

std::optional<Difference> difference_of_ranges(const Sample& real, const Sample& simulated) noexcept {
  if (((real.stamp.validity | simulated.stamp.validity) & kIncomplete) != 0) return {};
  const auto *cloud_a = real.as<PointCloudInfo>(), *cloud_b = simulated.as<PointCloudInfo>();
  if (cloud_a && cloud_b) return difference_of_clouds(real, simulated, cloud_a->count, cloud_b->count);
  const auto *a = real.as<RangeImageInfo>(), *b = simulated.as<RangeImageInfo>();
  if (!a || !b || a->width_px != b->width_px || a->height_px != b->height_px) return {};
  const std::size_t pixels = std::size_t{a->width_px} * a->height_px;
  if (real.size_bytes < pixels * sizeof(float) || simulated.size_bytes < pixels * sizeof(float)) return {};
  RangeSums sums;
  for (std::size_t i = 0; i < pixels; ++i) {
    const double d = double{item<float>(real.bytes(), i)} - double{item<float>(simulated.bytes(), i)};
    if (std::isfinite(d)) sums.add(d);
  }
  return sums.result();
}

void PairStatistics::Sums::merge(const Difference& d) noexcept {
  if (d.count == 0) return;
  const auto n_a = static_cast<double>(count), n_b = static_cast<double>(d.count), n = n_a + n_b;
  const double delta = d.bias - mean;
  mean += delta * n_b / n;
  m2 += d.sigma * d.sigma * n_b + delta * delta * n_a * n_b / n;
  count += d.count;
}

Difference PairStatistics::Sums::result() const noexcept {
  return {count, mean, count ? std::sqrt(m2 / static_cast<double>(count)) : 0.0};
}

bool PairStatistics::start(bool virtual_time) {
  stop();
  virtual_time_ = virtual_time;
  work_ = PairSnapshot{};
  sums_ = {};
  published_.store(work_);
  skipped_ = 0;
  for (std::size_t i = 0; i < 2; ++i) came_[i] = missing_[i] = behind_[i] = 0;
  jobs_.emplace(8);
  strand_ = workers_.make_strand([this] { run(); });
  return strand_ != nullptr;
}

void PairStatistics::stop() {
  if (strand_) strand_->wait_idle();
  strand_.reset();
  jobs_.reset();
}

void PairStatistics::compare(const SampleLease& real, const SampleLease& simulated) noexcept {
  if (!strand_) return;
  if (strand_->backlog() > 2) {
    if (!virtual_time_) {
      skipped_.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    strand_->wait_idle();
  }
  if (jobs_->try_push(Job{real, simulated})) strand_->submit();
}

void PairStatistics::came(PairSide side, std::uint64_t missing) noexcept {
  came_[static_cast<std::size_t>(side)].fetch_add(1, std::memory_order_relaxed);
  missing_[static_cast<std::size_t>(side)].fetch_add(missing, std::memory_order_relaxed);
}

void PairStatistics::behind(PairSide side, std::uint64_t instants) noexcept {
  behind_[static_cast<std::size_t>(side)].store(instants, std::memory_order_relaxed);
}

void PairStatistics::drain() {
  if (strand_) strand_->wait_idle();
}

void PairStatistics::run() {
  Job job;
  if (!jobs_->try_pop(job)) return;
  std::optional<Difference> of_pair;
  std::array<double, RegisterBlock::kMax> difference;
  if (const std::uint32_t n = value_differences(*job.real, *job.simulated, difference); n > 0) {
    ++work_.compared;
    work_.values = n;
    for (std::uint32_t i = 0; i < n; ++i) {
      // A value that its bus has not told yet is not a number.
      if (std::isfinite(difference[i])) sums_[i].merge({1, difference[i], 0});
      work_.value[i] = sums_[i].result();
    }
    work_.all = work_.value[0];
    if (std::isfinite(difference[0])) of_pair = work_.last = {1, difference[0], 0};
  } else if (const auto d = job.real->kind() == SampleKind::image
                                ? difference_of_images(*job.real, *job.simulated)
                                : difference_of_ranges(*job.real, *job.simulated)) {
    ++work_.compared;
    sums_[0].merge(*d);
    work_.all = sums_[0].result();
    work_.last = *d;
    of_pair = d;
  } else {
    ++work_.unlike;
  }
  published_.store(work_);
  if (monitor_) monitor_->add(*job.real, *job.simulated, of_pair);
}

PairSnapshot PairStatistics::snapshot() const noexcept {
  PairSnapshot s = published_.load();
  s.skipped = skipped_.load(std::memory_order_relaxed);
  for (std::size_t i = 0; i < 2; ++i) {
    s.came[i] = came_[i].load(std::memory_order_relaxed);
    s.missing[i] = missing_[i].load(std::memory_order_relaxed) + behind_[i].load(std::memory_order_relaxed);
  }
  return s;
}

}  // namespace rigor
