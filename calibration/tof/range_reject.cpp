// What does not belong to the range fit: single samples, whole scenes.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/tof/range_parts.h"
#include "calibration/tof/range_problem.h"

namespace rigor::calibration {
namespace {

constexpr std::size_t kNamed = 200;  ///< rejected samples that are named one by one

}  // namespace

double RangeProblem::robust_scale(const RangeModel& m, const RangeState& s) const {
  std::vector<double> z;
  Cell c;
  const WigglingCurve w = wiggling(m, s);
  const std::size_t stride = std::max<std::size_t>(1, all_.pixels() / 2000);
  for (std::size_t p = 0; p < all_.pixels(); p += stride)
    for (std::size_t k = 0; k < scenes_.size(); ++k) {
      if (!scene_used_[k]) continue;
      bool evaluated = false;
      for (const std::size_t i : scenes_[k]->frames) {
        if (!used_[i][p]) continue;
        if (!evaluated) evaluate(m, s, w, k, p, c), evaluated = true;
        z.push_back(std::abs(residual(all_.frames[i], p, c.value_m + s.pixel_m[p], nullptr)) /
                    sigma_m_[k * all_.pixels() + p]);
      }
    }
  return 1.4826 * median_of(z);
}

void RangeProblem::gather(const RangeModel& m, const RangeState& s) {
  gathered_.assign(scenes_.size() * all_.pixels(), {});
  const WigglingCurve w = wiggling(m, s);
  in_parts(64, [&](std::size_t part) {
    Cell c;
    for (std::size_t k = 0; k < scenes_.size(); ++k)
      for (std::size_t p = part; p < all_.pixels(); p += 64) {
        double n = 0, sum = 0, squares = 0, predicted = 0;
        for (const std::size_t i : scenes_[k]->frames) {
          if (!used_[i][p]) continue;
          if (n == 0) evaluate(m, s, w, k, p, c), predicted = c.value_m + s.pixel_m[p];
          const double r = residual(all_.frames[i], p, predicted, nullptr);
          n += 1, sum += r, squares += r * r;
        }
        if (n > 0)
          gathered_[k * all_.pixels() + p] = {predicted + sum / n, static_cast<float>(n),
                                              static_cast<float>(std::max(0.0, squares - sum * sum / n))};
      }
  });
}

void RangeProblem::reject(const RangeModel& m, RangeState& s, const StopToken& stop) {
  // Everything that has a range begins anew.
  for (std::size_t k = 0; k < scenes_.size(); ++k)
    for (const std::size_t i : scenes_[k]->frames)
      for (std::size_t p = 0; p < all_.pixels(); ++p)
        used_[i][p] = std::isfinite(all_.frames[i].range_m[p]) && rays_[p][2] > 0 &&
                      (!amplitudes_ || inverse_[k * all_.pixels() + p] > 0);
  std::fill(scene_used_.begin(), scene_used_.end(), true);
  double scale = robust_scale(m, s), narrow = 1;
  for (int round = 0; round < 10 && scale > 0 && !stop.stop_requested(); ++round) {
    s.scale = scale;
    Normal n;
    for (int i = 0; i < 2; ++i) {
      n = accumulate(m, s, 1, nullptr, 2.385 * scale * narrow);
      step(m, s, n, nullptr);
    }
    const double now = robust_scale(m, s);
    const bool falls = now < 0.98 * scale;
    scale = now;
    if (!falls && narrow < 0.6) break;
    narrow = falls ? narrow : narrow / 2;
  }
  const double crowd = std::max(1.0, samples_per_pixel());
  double limit = reject_sigmas_ * scale * std::sqrt(crowd / std::max(0.5, crowd - 1));
  std::size_t before = std::numeric_limits<std::size_t>::max();
  std::vector<bool> dropped(scenes_.size(), false);
  for (int round = 0; round < 10; ++round) {
    std::vector<std::size_t> all(scenes_.size(), 0), out(scenes_.size(), 0);
    std::vector<std::vector<Left>> of_scene(scenes_.size());
    const auto farthest = [](const Left& a, const Left& b) {
      return a.sigmas != b.sigmas ? a.sigmas > b.sigmas
                                  : std::make_pair(a.frame, a.pixel) < std::make_pair(b.frame, b.pixel);
    };
    const WigglingCurve w = wiggling(m, s);
    in_parts(scenes_.size(), [&](std::size_t k) {
      Cell c;
      std::vector<Left>& left = of_scene[k];
      for (std::size_t p = 0; p < all_.pixels(); ++p) {
        if (!(rays_[p][2] > 0)) continue;
        bool evaluated = false;
        for (const std::size_t i : scenes_[k]->frames) {
          const TofFrame& f = all_.frames[i];
          if (!std::isfinite(f.range_m[p]) || (amplitudes_ && !(inverse_[k * all_.pixels() + p] > 0)))
            continue;
          if (!evaluated) evaluate(m, s, w, k, p, c), evaluated = true;
          const double r = residual(f, p, c.value_m + s.pixel_m[p], nullptr);
          const double z = std::abs(r) / sigma_m_[k * all_.pixels() + p];
          used_[i][p] = scale == 0 || z <= limit;
          ++all[k];
          if (used_[i][p]) continue;
          ++out[k];
          left.push_back({i, p, r, z / std::max(limit / reject_sigmas_, 1e-300)});
          if (left.size() > 20 * kNamed) {
            std::nth_element(left.begin(), left.begin() + kNamed, left.end(), farthest);
            left.resize(kNamed);
          }
        }
      }
    });
    left_.clear();
    left_count_ = 0;
    for (std::size_t k = 0; k < scenes_.size(); ++k) {
      left_.insert(left_.end(), of_scene[k].begin(), of_scene[k].end());
      left_count_ += out[k];
    }
    // A plane of which most does not fit was not where it was said to be.
    for (std::size_t k = 0; k < scenes_.size(); ++k) {
      scene_empty_[k] = all[k] == 0;
      scene_used_[k] = !dropped[k] && all[k] > 0 && 2 * out[k] <= all[k];
    }
    std::sort(left_.begin(), left_.end(), farthest);
    if (left_.size() > kNamed) left_.resize(kNamed);
    gather(m, s);
    if (left_count_ == before || stop.stop_requested()) break;
    before = left_count_;
    solve(m, s, 4, 1, nullptr);
    limit = reject_sigmas_ * s.scale;
    scale = s.scale;
    // Nor was one whose distance is off by far more than the others' are: the worst first, as it pulls them.
    std::vector<double> errors;
    std::size_t worst = 0;
    for (std::size_t k = 0; k < scenes_.size(); ++k) {
      if (!scene_used_[k]) continue;
      errors.push_back(std::abs(s.error_m[k]));
      if (!scene_used_[worst] || errors.back() > std::abs(s.error_m[worst])) worst = k;
    }
    if (errors.size() < 5) continue;
    const double typical = estimates_distance_sigma()
                               ? std::max(1.4826 * median_of(errors), 0.1 * assumed_distance_sigma_m_)
                               : given_distance_sigma_m_;
    if (std::abs(s.error_m[worst]) > 6 * typical) {
      dropped[worst] = true;
      scene_used_[worst] = false;
      s.error_m[worst] = 0;
      solve(m, s, 6, 1, nullptr);
      limit = reject_sigmas_ * s.scale;
      before = std::numeric_limits<std::size_t>::max();
    }
  }
}

void RangeProblem::report_rejected(const RangeState&, FitResult& r) const {
  r.residuals.rejected = left_count_;
  for (std::size_t k = 0; k < scenes_.size(); ++k)
    if (scene_empty_[k])
      r.warnings.push_back(scenes_[k]->name + ": no range in it: saturated, or nothing came back");
    else if (!scene_used_[k])
      r.rejected.push_back(
          {scenes_[k]->name + ": all of it; it does not agree with the other distances", 0, 0});
  for (const Left& l : left_) {
    const auto width = static_cast<std::size_t>(all_.width_px);
    r.rejected.push_back(
        {fmt::format("{} pixel ({}, {})", all_.frames[l.frame].name, l.pixel % width, l.pixel / width),
         std::abs(l.residual_m), l.sigmas});
  }
  if (left_count_ > left_.size())
    r.warnings.push_back(fmt::format("{} samples were rejected; the {} that are farthest off are named",
                                     left_count_, left_.size()));
}

}  // namespace rigor::calibration
