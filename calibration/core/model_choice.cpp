#include "calibration/core/model_choice.h"

#include <cmath>
#include <limits>

namespace rigor::calibration {
namespace {

struct Mean {
  double value = 0, error = 0;
  std::size_t count = 0;
};

/// Weighted mean of finite values and its standard error.
Mean mean_of(const std::vector<double>& values, const std::vector<double>& weights) {
  const auto weight = [&](std::size_t i) { return weights.empty() ? 1.0 : weights[i]; };
  Mean m;
  double sum = 0;
  for (std::size_t i = 0; i < values.size(); ++i)
    if (std::isfinite(values[i])) m.value += weight(i) * values[i], sum += weight(i), ++m.count;
  if (!(sum > 0)) return {};
  m.value /= sum;
  for (std::size_t i = 0; i < values.size(); ++i)
    if (std::isfinite(values[i])) m.error += std::pow(weight(i) * (values[i] - m.value), 2);
  const auto n = static_cast<double>(m.count);
  m.error = m.count > 1 ? std::sqrt(m.error * n / (n - 1)) / sum : std::numeric_limits<double>::infinity();
  return m;
}

}  // namespace

double bic(double sum_of_squares, double residuals, std::size_t parameters) {
  // A perfect fit has no variance to take the logarithm of.
  const double mean = std::max(sum_of_squares / residuals, std::numeric_limits<double>::min());
  return residuals * std::log(mean) + static_cast<double>(parameters) * std::log(residuals);
}

void set_cross_validation(Candidate& c, std::vector<double> withheld, std::vector<double> weights) {
  const Mean m = mean_of(withheld, weights);
  c.cross_validation = m.count > 0 ? std::sqrt(m.value) : std::numeric_limits<double>::quiet_NaN();
  // d√x = dx/(2√x)
  c.cross_validation_sigma = m.count > 1 ? m.error / (2 * std::max(1e-300, c.cross_validation)) : 0;
  c.withheld = std::move(withheld);
  c.withheld_weights = std::move(weights);
}

double paired_improvement(const Candidate& a, const Candidate& b) {
  std::vector<double> difference;
  if (a.withheld.size() != b.withheld.size()) return std::numeric_limits<double>::quiet_NaN();
  for (std::size_t i = 0; i < a.withheld.size(); ++i) difference.push_back(a.withheld[i] - b.withheld[i]);
  const Mean m = mean_of(difference, a.withheld_weights);
  if (m.count < 2) return std::numeric_limits<double>::quiet_NaN();
  return m.error > 0 ? m.value / m.error : m.value > 0 ? 1e300 : m.value < 0 ? -1e300 : 0;
}

std::size_t choose_model(std::vector<Candidate>& candidates) {
  const std::size_t none = candidates.size();
  std::size_t best_cv = none, best_bic = 0, chosen = none;
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    if (candidates[i].bic < candidates[best_bic].bic) best_bic = i;
    const double cv = candidates[i].cross_validation;
    if (std::isfinite(cv) && (best_cv == none || cv < candidates[best_cv].cross_validation)) best_cv = i;
  }
  const auto beaten_by = [&](std::size_t i) {
    for (std::size_t k = 0; k < candidates.size(); ++k) {
      if (!(candidates[k].bic < candidates[i].bic)) continue;
      const double better = paired_improvement(candidates[i], candidates[k]);
      if (std::isnan(better) || better > 1) return k;
    }
    return none;
  };
  // The one of the least BIC is never beaten.
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    if (beaten_by(i) != none) continue;
    if (chosen == none || candidates[i].parameters < candidates[chosen].parameters ||
        (candidates[i].parameters == candidates[chosen].parameters &&
         candidates[i].bic < candidates[chosen].bic))
      chosen = i;
  }
  if (chosen == none) chosen = best_bic;  // a BIC that is no number
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    Candidate& c = candidates[i];
    c.chosen = i == chosen;
    std::string note;
    if (i == best_bic) note = "least BIC";
    if (i == best_cv) note += note.empty() ? "best in cross-validation" : ", best in cross-validation";
    if (c.chosen && i != best_bic)
      note += std::string(note.empty() ? "" : ", ") + "the smallest that no other beats";
    if (!c.chosen && note.empty()) {
      const std::size_t by = beaten_by(i);
      note = by == none
                 ? "more parameters that predict no better"
                 : (c.withheld.empty() ? "larger BIC than " : "predicts worse than ") + candidates[by].name;
    }
    if (c.note.empty()) c.note = note;
  }
  return chosen;
}

}  // namespace rigor::calibration
