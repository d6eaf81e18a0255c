// How far the device shows features from where the simulated side shows them, once the change that a window
// found (gain, focal length, mount …) is taken off: what is left is the lens, parallax, a world that is not
// the simulated side's.
//
// Lucas and Kanade's step in each field of the picture, with what is left of the residuals:
//
//   d = −(Σ w ∇I ∇Iᵀ)⁻¹ Σ w ∇I (r − J δ̂)     px, real − simulated
//
// The sums are linear in δ̂, which is known at the end of the window alone.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include "sensor-hal/channel/pair_watch/window_fit.h"

namespace rigor::pair_watch {

class FeatureShift {
 public:
  static constexpr std::size_t kMostTerms = 7;

  FeatureShift() = default;
  /// Setup; allocates.
  explicit FeatureShift(std::size_t fields) : fields_(fields) {}

  // One thread at a time; no allocation.
  /// A row of the window's fit: residual in DN, gradient in DN/px, weight in 1/DN². The rows of a field have
  /// the same parameters, kMostTerms at most.
  void add(std::size_t field, double gx, double gy, double weight, double residual,
           std::span<const WindowFit::Term> terms) noexcept {
    Field& f = fields_[field];
    const double x = weight * gx, y = weight * gy;
    f.xx += x * gx, f.xy += x * gy, f.yy += y * gy;
    f.x += x * residual, f.y += y * residual;
    f.terms = terms.size();
    for (std::size_t k = 0; k < terms.size(); ++k) {
      f.term[k].parameter = terms[k].parameter;
      f.term[k].x += x * terms[k].derivative, f.term[k].y += y * terms[k].derivative;
    }
  }
  /// Root mean square over the fields whose structure tells of both directions to a fifth of a pixel, less
  /// what the pixels' noise adds to it; NaN with less than three of them. `estimate`: of this window; what it
  /// does not know was not taken off.
  [[nodiscard]] double finish(const Estimate& estimate) noexcept {
    constexpr double kLeastInformation = 25;  // 1/px²
    double squares = 0, count = 0;
    for (Field& f : fields_) {
      const double half = (f.xx - f.yy) / 2, least = (f.xx + f.yy) / 2 - std::hypot(half, f.xy);
      if (least >= kLeastInformation) {
        for (std::size_t k = 0; k < f.terms; ++k)
          if (const double v = estimate.value[f.term[k].parameter]; std::isfinite(v))
            f.x -= f.term[k].x * v, f.y -= f.term[k].y * v;
        const double determinant = f.xx * f.yy - f.xy * f.xy;
        const double u = (f.yy * f.x - f.xy * f.y) / determinant, v = (f.xx * f.y - f.xy * f.x) / determinant;
        squares += u * u + v * v - (f.xx + f.yy) / determinant, ++count;
      }
      f = {};
    }
    return count >= 3 ? std::sqrt(std::max(0.0, squares / count)) : kNaN;
  }

 private:
  struct Term {
    std::size_t parameter = 0;
    double x = 0, y = 0;
  };
  struct Field {
    double xx = 0, xy = 0, yy = 0, x = 0, y = 0;
    std::array<Term, kMostTerms> term{};
    std::size_t terms = 0;
  };
  std::vector<Field> fields_;
};

}  // namespace rigor::pair_watch
