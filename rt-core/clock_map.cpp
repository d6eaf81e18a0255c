#include "rt-core/clock_map.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace rigor {
namespace {

constexpr double kOneOverSqrt12 = 0.28867513459481287;  // standard deviation of a uniform error of width 1
constexpr double kUnknownDelay_ns = 1e6;                // scatter of arrivals before any was compared
constexpr double kQuickSide =
    1.55;  // standard deviation over root mean square below the mean, exponential tail
constexpr std::uint32_t kLateForReset = 8;  // arrivals in a row, over at least kLateSpan
constexpr Duration kLateSpan = seconds(1);
constexpr Duration kCertainRollback = seconds(1);  // no network delays a sample so long behind its successor

// Differences of counters anywhere in the range of int64, without overflow.
constexpr std::int64_t minus(std::int64_t a, std::int64_t b) {
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(a) - static_cast<std::uint64_t>(b));
}
constexpr std::int64_t plus(std::int64_t a, std::int64_t b) {
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(a) + static_cast<std::uint64_t>(b));
}
double square(double v) { return v * v; }

std::int64_t to_ns(double v) {  // rounds, and saturates where int64 ends
  constexpr double kLimit = 9.2e18;
  return static_cast<std::int64_t>(std::llround(std::clamp(v, -kLimit, kLimit)));
}

}  // namespace

/// y = mean_y + slope · (x − mean_x), both relative to a reference pair.
struct ClockMap::Line {
  std::int64_t x_ref = 0, t_ref = 0;
  double mean_x = 0, mean_y = 0, slope = 0;
  double var_mean = 0, var_slope = 0;

  /// Weighted least squares with a prior N(0, prior²) on the slope. Because x is centred, offset and slope do
  /// not correlate, and one pair alone gives the offset with the prior's uncertainty of the drift.
  template <class Weight>
  static Line fit(Ring& ring, double prior, Weight&& weight) {
    Line l;
    l.x_ref = ring[0].x;
    l.t_ref = ring[0].t;
    double w = 0, wx = 0, wy = 0;
    for (std::size_t i = 0; i < ring.size(); ++i) {
      const double wi = weight(i);
      w += wi;
      wx += wi * l.x_of(ring[i]);
      wy += wi * l.y_of(ring[i]);
    }
    l.mean_x = wx / w;
    l.mean_y = wy / w;
    double sxx = 1 / square(prior), sxy = 0;
    for (std::size_t i = 0; i < ring.size(); ++i) {
      const double dx = l.x_of(ring[i]) - l.mean_x;
      sxx += weight(i) * dx * dx;
      sxy += weight(i) * dx * (l.y_of(ring[i]) - l.mean_y);
    }
    l.slope = sxy / sxx;
    l.var_slope = 1 / sxx;
    l.var_mean = 1 / w;
    return l;
  }
  double x_of(const Pair& p) const { return static_cast<double>(minus(p.x, x_ref)); }
  double y_of(const Pair& p) const {
    return static_cast<double>(minus(minus(p.t, t_ref), minus(p.x, x_ref)));
  }
  double residual(const Pair& p) const { return y_of(p) - mean_y - slope * (x_of(p) - mean_x); }
};

ClockMap::ClockMap(const ClockMapOptions& options) noexcept : options_(options) {}

void ClockMap::reset() noexcept {
  forget();
  state_.store(current_);
}

void ClockMap::forget() noexcept {
  latches_.clear();
  segments_.clear();
  segment_count_ = 0;
  suspects_ = 0;
  late_in_a_row_ = 0;
  const std::uint32_t generation = current_.generation + (current_.pairs > 0 ? 1 : 0);
  current_ = State{};
  current_.generation = generation;
}

// True when two observations in a row contradict the map in the same way: a step, not one bad stamp.
bool ClockMap::step_seen(std::int64_t shift_ns, std::int64_t limit_ns) noexcept {
  if (suspects_ > 0 && std::abs(minus(shift_ns, suspect_shift_ns_)) <= limit_ns) return true;
  suspects_ = 1;
  suspect_shift_ns_ = shift_ns;
  return false;
}

ClockMap::Update ClockMap::add_latch(DeviceTime x, BenchTime before, BenchTime after) noexcept {
  const Duration width = after - before;
  if (width.ns() < 0 || width > options_.window) return Update::ignored;
  Pair pair;
  pair.x = x.ns();
  pair.t = before.ns() + width.ns() / 2;
  pair.width_ns = static_cast<double>(width.ns() + options_.resolution.ns());
  pair.sigma_ns = std::max(1.0, pair.width_ns) * kOneOverSqrt12;

  bool stepped = false;
  if (current_.pairs > 0) {
    if (minus(x_last_, pair.x) > options_.resolution.ns()) {
      stepped = true;  // one thread reads the latch in order: the counter went back
    } else {
      const Mapped m = map(current_, x);
      const std::int64_t shift = minus(pair.t, m.t.ns());
      const std::int64_t limit =
          to_ns(pair.width_ns / 2 + 5 * static_cast<double>(m.sigma.ns())) + options_.step_threshold.ns();
      if (!m.known || shift > limit || shift < -limit) {
        if (!step_seen(shift, limit)) return Update::suspected;
        stepped = true;
      }
    }
    if (stepped) forget();
  }
  suspects_ = 0;
  late_in_a_row_ = 0;
  x_last_ = pair.x;
  latches_.push_newest(pair);
  drop_old(latches_);
  publish_latches();
  return stepped ? Update::reset : Update::used;
}

ClockMap::Update ClockMap::add_arrival(DeviceTime x, BenchTime arrival) noexcept {
  const std::int64_t t = (arrival - options_.min_delay).ns();
  bool stepped = false;
  double excess = 0;  // how much later than the map says, ns
  if (current_.pairs > 0) {
    const Mapped m = map(current_, x);
    const std::int64_t shift = minus(t, m.t.ns());
    const std::int64_t limit = to_ns(5 * static_cast<double>(m.sigma.ns())) + options_.step_threshold.ns();
    excess = static_cast<double>(shift);
    if (minus(x_last_, x.ns()) > kCertainRollback.ns()) {
      stepped = true;
    } else if (!m.known || shift < -limit) {  // here before it was measured
      if (!step_seen(shift, limit)) return Update::suspected;
      stepped = true;
    } else if (shift > limit) {  // late; a step back of the device looks like that too, and then it stays
      if (late_in_a_row_++ == 0) late_since_ = arrival;
      if (late_in_a_row_ < kLateForReset || arrival - late_since_ < kLateSpan) return Update::ignored;
      stepped = true;
    }
    if (stepped) forget(), excess = 0;
  }
  suspects_ = 0;
  late_in_a_row_ = 0;
  if (current_.pairs == 0 || minus(x.ns(), x_last_) > 0) x_last_ = x.ns();
  if (!latches_.empty()) {
    // Latches say more than arrivals ever can; they only grow old.
    if (minus(x.ns(), latches_.back().x) < options_.window.ns()) return Update::ignored;
    latches_.clear();
  }

  bool changed = stepped;
  if (segments_.empty() || minus(x.ns(), segment_end_) >= 0) {
    const std::int64_t length =
        std::max<std::int64_t>(1, options_.window.ns() / static_cast<std::int64_t>(kPairs));
    segments_.push_newest(Pair{x.ns(), t, kUnknownDelay_ns, 0, 0});
    segment_end_ = plus(x.ns(), length);
    segment_count_ = 0;
    segment_min_ = excess;
    segment_sum_ = 0;
    changed = true;
  }
  Pair& segment = segments_.back();
  segment.count = ++segment_count_;
  segment_sum_ += excess;
  if (excess < segment_min_) {
    segment_min_ = excess;
    segment.x = x.ns();
    segment.t = t;
    changed = true;
  }
  if (segment_count_ > 1) {
    // Of n delays with an exponential tail of mean m, the smallest lies m/n above the floor, give or take
    // m/n.
    const double n = segment_count_;
    segment.sigma_ns = std::max(1.0, (segment_sum_ / n - segment_min_) / n);
  }
  // The map is fitted anew when the segment's floor moved or its count doubled: fitting to each sample while
  // residuals are measured against the fit would only cost time.
  if (changed || (segment_count_ & (segment_count_ - 1)) == 0) {
    drop_old(segments_);
    publish_arrivals();
    // Residuals within the segment are relative to the map: carry the old ones over to the new one.
    const Pair& floor = segments_.back();
    const double moved =
        static_cast<double>(minus(floor.t, map(current_, DeviceTime(floor.x)).t.ns())) - segment_min_;
    segment_min_ += moved;
    segment_sum_ += moved * segment_count_;
    return stepped ? Update::reset : Update::used;
  }
  return Update::ignored;
}

void ClockMap::drop_old(Ring& ring) noexcept {
  // After a long silence two old pairs still hold the drift.
  while (ring.size() > 2 && minus(x_last_, ring[0].x) > options_.window.ns()) ring.pop_front();
}

void ClockMap::publish(const Line& line, double var_systematic, Ring& ring) noexcept {
  State s;
  s.generation = current_.generation;
  const std::int64_t shift = to_ns(line.mean_x);
  s.x_ref = plus(line.x_ref, shift);
  s.t_ref = plus(line.t_ref, shift);
  s.offset_ns = line.mean_y + line.slope * (static_cast<double>(shift) - line.mean_x);
  s.drift = line.slope;
  s.var_offset = line.var_mean;
  s.var_drift = line.var_slope;
  s.var_systematic = var_systematic;
  s.drift_wander = options_.drift_wander;
  s.x_first = ring[0].x;
  s.x_last = ring.back().x;
  s.pairs = static_cast<std::uint32_t>(ring.size());
  current_ = s;
  state_.store(s);
}

void ClockMap::publish_latches() noexcept {
  Line line = Line::fit(latches_, options_.drift_prior,
                        [&](std::size_t i) { return 1 / square(latches_[i].sigma_ns); });
  // A latch that happens always early in its window shifts all pairs alike: the narrowest window bounds that.
  double narrowest = latches_[0].width_ns;
  double chi2 = 0;
  for (std::size_t i = 0; i < latches_.size(); ++i) {
    narrowest = std::min(narrowest, latches_[i].width_ns);
    chi2 += square(line.residual(latches_[i]) / latches_[i].sigma_ns);
  }
  // More scatter than the windows allow for (a counter that jumps, a drift that changes): say so in sigma.
  if (latches_.size() > 2) {
    const double scale = std::max(1.0, chi2 / static_cast<double>(latches_.size() - 2));
    line.var_mean *= scale;
    line.var_slope *= scale;
  }
  publish(line, square(narrowest * kOneOverSqrt12), latches_);
}

void ClockMap::publish_arrivals() noexcept {
  const std::size_t n = segments_.size();
  std::array<bool, kPairs> out{};
  std::array<double, kPairs> width{};  // of a segment's scatter, in sigmas: the fewer arrivals, the wider
  double mean_count = 0;
  for (std::size_t i = 0; i < n; ++i) mean_count += segments_[i].count / static_cast<double>(n);
  double measured_var = 0;
  std::size_t measured = 0;
  for (std::size_t i = 0; i < n; ++i) {
    width[i] = std::max(1.0, mean_count / segments_[i].count);
    if (segments_[i].count < 2) continue;
    measured_var += square(segments_[i].sigma_ns / width[i]);
    ++measured;
  }
  // One arrival tells nothing of the scatter: what is guessed of it widens sigma, and shifts nothing.
  bool guessed = measured == 0;
  double sigma = guessed ? kUnknownDelay_ns : std::sqrt(measured_var / static_cast<double>(measured));
  // A young segment whose quickest arrival is far later than the map can be wrong by: its quick ones are to
  // come. (Of many segments the residuals tell which are late.)
  if (n > 1 && !guessed) {
    const Mapped floor = map(current_, DeviceTime(segments_.back().x));
    out[n - 1] = segment_min_ > 4 * (static_cast<double>(floor.sigma.ns()) + sigma * width[n - 1]);
  }
  Line line;
  const auto weight = [&](std::size_t i) { return (out[i] ? 1e-12 : 1.0) / square(sigma * width[i]); };
  for (int round = 0; round < 4; ++round) {
    line = Line::fit(segments_, options_.drift_prior, weight);
    if (n < 5) break;
    // Scatter from the quick side only: a segment without any quick sample lies far above, never far below.
    double sum = 0;
    std::size_t below = 0;
    for (std::size_t i = 0; i < n; ++i) {
      const double r = line.residual(segments_[i]) / width[i];
      if (r <= 0) sum += square(r), ++below;
    }
    sigma = std::max(1.0, kQuickSide * std::sqrt(sum / static_cast<double>(std::max<std::size_t>(below, 1))));
    guessed = false;
    bool changed = false;
    for (std::size_t i = 0; i < n; ++i) {
      const bool far = line.residual(segments_[i]) > 4 * sigma * width[i];
      changed |= far != out[i];
      out[i] = far;
    }
    if (!changed) break;
  }
  // Floors of segments lie above the true floor by about their scatter (exactly so for an exponential tail);
  // that the tail may be another is the systematic part.
  if (!guessed) line.mean_y -= sigma;
  publish(line, square(sigma) + square(static_cast<double>(options_.min_delay_sigma.ns())), segments_);
}

Mapped ClockMap::map(const State& s, DeviceTime x) noexcept {
  if (s.pairs == 0) return Mapped{BenchTime(0), Duration(0), s.generation, false};
  const std::int64_t dx = minus(x.ns(), s.x_ref);
  const double d = static_cast<double>(dx);
  const std::int64_t correction = to_ns(s.offset_ns + s.drift * d);
  std::int64_t t = 0;
  if (__builtin_add_overflow(s.t_ref, dx, &t) || __builtin_add_overflow(t, correction, &t))
    return Mapped{BenchTime::never(), Duration(0), s.generation, false};
  const double beyond = std::max(
      {0.0, static_cast<double>(minus(x.ns(), s.x_last)), static_cast<double>(minus(s.x_first, x.ns()))});
  const double var = s.var_offset + s.var_drift * d * d + s.var_systematic + square(s.drift_wander * beyond);
  return Mapped{BenchTime(t), Duration(to_ns(std::ceil(std::sqrt(var)))), s.generation, true};
}

DeviceTime ClockMap::unmap(BenchTime t) const noexcept {
  const State s = state_.load();
  if (s.pairs == 0) return DeviceTime(0);
  const std::int64_t dt = minus(t.ns(), s.t_ref);
  const double d = static_cast<double>(dt);
  return DeviceTime(plus(plus(s.x_ref, dt), to_ns((-s.offset_ns - s.drift * d) / (1 + s.drift))));
}

}  // namespace rigor
