#include "calibration/core/fit_result.h"

#include <algorithm>
#include <cmath>

namespace rigor::calibration {

int FitResult::index_of(std::string_view name) const {
  for (std::size_t i = 0; i < parameters.size(); ++i)
    if (parameters[i].name == name) return static_cast<int>(i);
  return -1;
}

const Parameter* FitResult::find(std::string_view name) const {
  const int i = index_of(name);
  return i < 0 ? nullptr : &parameters[static_cast<std::size_t>(i)];
}

bool FitResult::identifiable(std::string_view name) const {
  return std::ranges::none_of(not_identifiable, [&](const auto& n) { return n.first == name; });
}

ResidualStatistics statistics_of(std::vector<double>& residuals, std::string unit) {
  ResidualStatistics s;
  s.unit = std::move(unit);
  s.count = residuals.size();
  if (residuals.empty()) return s;
  double sum = 0;
  for (double& r : residuals) {
    sum += r * r;
    r = std::abs(r);
  }
  s.rms = std::sqrt(sum / static_cast<double>(residuals.size()));
  const auto quantile = [&](double q) {
    const auto k =
        std::min(residuals.size() - 1, static_cast<std::size_t>(q * static_cast<double>(residuals.size())));
    std::nth_element(residuals.begin(), residuals.begin() + static_cast<std::ptrdiff_t>(k), residuals.end());
    return residuals[k];
  };
  s.median_absolute = quantile(0.5);
  s.p95_absolute = quantile(0.95);
  s.largest = *std::max_element(residuals.begin(), residuals.end());
  return s;
}

}  // namespace rigor::calibration
