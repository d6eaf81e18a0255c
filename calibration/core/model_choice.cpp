#include "calibration/core/model_choice.h"

#include <cmath>
#include <cstdio>
#include <limits>

namespace rigor::calibration {

double bic(double sum_of_squares, std::size_t residuals, std::size_t parameters) {
  const auto m = static_cast<double>(residuals);
  // A perfect fit has no variance to take the logarithm of.
  const double mean = std::max(sum_of_squares / m, std::numeric_limits<double>::min());
  return m * std::log(mean) + static_cast<double>(parameters) * std::log(m);
}

std::size_t choose_model(std::vector<Candidate>& candidates) {
  std::size_t best_cv = candidates.size(), best_bic = 0;
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    if (candidates[i].bic < candidates[best_bic].bic) best_bic = i;
    const double cv = candidates[i].cross_validation;
    if (std::isfinite(cv) && (best_cv == candidates.size() || cv < candidates[best_cv].cross_validation))
      best_cv = i;
  }
  std::size_t chosen = best_bic;
  if (best_cv < candidates.size()) {
    const double limit = candidates[best_cv].cross_validation + candidates[best_cv].cross_validation_sigma;
    chosen = best_cv;
    for (std::size_t i = 0; i < candidates.size(); ++i)
      if (candidates[i].cross_validation <= limit && candidates[i].parameters < candidates[chosen].parameters)
        chosen = i;
  }
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    Candidate& c = candidates[i];
    c.chosen = i == chosen;
    std::string note;
    if (i == best_bic) note = "least BIC";
    if (i == best_cv) note += note.empty() ? "best in cross-validation" : ", best in cross-validation";
    if (c.chosen && best_cv < candidates.size() && i != best_cv)
      note += std::string(note.empty() ? "" : ", ") + "the smallest that predicts as well";
    if (!c.chosen && note.empty()) {
      const Candidate& winner = candidates[chosen];
      note = c.parameters > winner.parameters ? "more parameters that predict no better" : "predicts worse";
    }
    if (c.note.empty()) c.note = note;
  }
  return chosen;
}

}  // namespace rigor::calibration
