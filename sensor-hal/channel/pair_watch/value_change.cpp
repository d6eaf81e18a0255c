#include "sensor-hal/channel/pair_watch/value_change.h"

#include <algorithm>
#include <cmath>

namespace rigor::pair_watch {

Result<ValueChange> ValueChange::make(const std::vector<WatchedValue>& values) {
  if (values.empty() || values.size() > kMaxParameters / 4)
    return fail(ErrorCode::bad_input, "values",
                "expected 1 to 10 numbers, got " + std::to_string(values.size()));
  for (const WatchedValue& v : values)
    if (!(v.resolution >= 0))
      return fail(ErrorCode::bad_input, v.name,
                  "expected a resolution of 0 or more, got " + std::to_string(v.resolution));
  return ValueChange(values);
}

ValueChange::ValueChange(const std::vector<WatchedValue>& values) {
  for (const WatchedValue& v : values) {
    values_.emplace_back();
    values_.back().resolution = v.resolution, values_.back().has_scale = v.has_scale;
    values_.back().first = parameters_.size();
    parameters_.push_back({v.name + " bias", v.unit, 0});
    if (v.has_scale) parameters_.push_back({v.name + " scale", "1", 0});
    parameters_.push_back({v.name + " delay", "s", 0});
    parameters_.push_back({v.name + " noise", "ln", 0});
  }
}

bool ValueChange::add(double t_s, std::span<const double> real, std::span<const double> simulated) noexcept {
  if (real.size() != values_.size() || simulated.size() != values_.size() || !std::isfinite(t_s))
    return false;
  for (std::size_t i = 0; i < values_.size(); ++i) {
    Value& v = values_[i];
    const Instant now{t_s, simulated[i], real[i] - simulated[i]};
    if (!std::isfinite(now.residual)) continue;
    if (v.run > 0 && !(t_s > v.last[2].t_s)) {
      // Time went back: what follows is a new run.
      if (t_s < v.last[2].t_s)
        v.run = 0;
      else
        continue;
    }
    v.last = {v.last[1], v.last[2], now};
    if (++v.run < 3) continue;
    const auto& [a, b, c] = v.last;
    const double slope = (c.x - a.x) / (c.t_s - a.t_s);
    const std::array<WindowFit::Term, 3> terms{{{0, 1}, {1, v.has_scale ? b.x : 0}, {2, -slope}}};
    v.fit.add(terms, b.residual, 1);
    v.still.add({terms.data(), 1}, b.residual, 1);
    const double x2 = a.x - 2 * b.x + c.x, r2 = a.residual - 2 * b.residual + c.residual;
    if (!v.any) v.origin = b.x, v.any = true;
    const double x = b.x - v.origin;
    v.x_sum += x, v.x_squares += x * x;
    v.x_second += x2 * x2 / 6, v.r_second += r2 * r2 / 6;
    v.slope_noise += 2 / ((c.t_s - a.t_s) * (c.t_s - a.t_s));
    ++v.count;
  }
  return true;
}

void ValueChange::finish(Estimate& e) noexcept {
  e.value.fill(kNaN), e.sigma.fill(kNaN);
  e.left = e.shift_px = kNaN;
  for (std::size_t i = 0; i < values_.size(); ++i) {
    Value& v = values_[i];
    const double n = v.count;
    if (n >= 4) {
      const double shifted = v.x_sum / n, mean = v.origin + shifted;
      const double variance = v.x_squares / n - shifted * shifted;
      const bool moves =
          n >= 8 && variance > 25 * v.x_second / n && (!v.has_scale || variance > 0.01 * mean * mean);
      WindowFit& fit = moves ? v.fit : v.still;
      // The instant's own x is in the residual, too; the slope is of its neighbours.
      if (moves && v.has_scale) fit.correct(1, v.x_second, v.x_second);
      if (moves) fit.correct(2, v.slope_noise * v.x_second / n, 0);
      fit.solve();
      std::size_t at = v.first;
      const auto put = [&](double value, double sigma) { e.value[at] = value, e.sigma[at++] = sigma; };
      put(fit.value(0), fit.sigma(0));
      if (v.has_scale) put(moves ? fit.value(1) : kNaN, moves ? fit.sigma(1) : kNaN);
      put(moves ? fit.value(2) : kNaN, moves ? fit.sigma(2) : kNaN);
      const double noise = v.r_second / n + v.resolution * v.resolution / 12;
      // Of mean squares of second differences of white noise.
      if (noise > 0) put(std::log(noise), std::sqrt(35.0 / 9 / n));
    }
    v.fit.clear(), v.still.clear();
    v.x_sum = v.x_squares = v.x_second = v.r_second = v.slope_noise = v.count = 0;
    v.any = false;
  }
}

}  // namespace rigor::pair_watch
