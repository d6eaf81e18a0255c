#include "calibration/pair/pair_model.h"

#include <cmath>

namespace rigor::calibration {

double ResidualSample::rms() const { return seen_ > 0 ? std::sqrt(squares_ / double(seen_)) : 0; }

std::vector<NoiseLevel> NoiseByLevel::levels(std::uint64_t least) const {
  std::vector<NoiseLevel> out;
  for (const Sums& s : sums_) {
    if (s.count < least) continue;
    const double n = double(s.count), mean = s.difference / n;
    out.push_back({s.at / n, s.real / n, s.simulated / n, mean,
                   std::sqrt(std::max(0.0, s.squares / n - mean * mean) / (n - 1)), s.count});
  }
  return out;
}

void keep_solution(PairFit& fit, std::vector<Parameter> parameters, const Eigen::VectorXd& value,
                   const Eigen::MatrixXd& covariance, const std::vector<bool>& held,
                   const std::vector<std::string>& why) {
  std::vector<Eigen::Index> kept;
  std::vector<double> steps;
  fit.change.parameters.clear(), fit.change.not_identifiable.clear();
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    if (held[i]) continue;
    if (!std::isfinite(covariance(k, k))) {
      fit.change.not_identifiable.emplace_back(parameters[i].name, why[i]);
      continue;
    }
    parameters[i].value = value[k], parameters[i].sigma = std::sqrt(covariance(k, k));
    fit.change.parameters.push_back(parameters[i]);
    kept.push_back(k);
    if (i < fit.one_step.size()) steps.push_back(fit.one_step[i]);
  }
  fit.one_step = steps;
  const auto n = static_cast<Eigen::Index>(kept.size());
  fit.change.covariance.resize(n, n);
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j < n; ++j)
      fit.change.covariance(i, j) = covariance(kept[std::size_t(i)], kept[std::size_t(j)]);
  std::vector<double> left = fit.after.values();
  ResidualStatistics& r = fit.change.residuals;
  const std::string unit = r.unit;
  r = statistics_of(left, unit);
  r.count = fit.after.count(), r.rms = fit.after.rms();
}

}  // namespace rigor::calibration
