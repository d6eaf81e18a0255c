// Which of nested models the data support. Two criteria that can disagree, both reported: BIC (in-sample) and
// cross-validation (error on what a model was not fitted to).
#pragma once

#include <vector>

#include "calibration/core/fit_result.h"

namespace rigor::calibration {

/// Bayesian information criterion of a Gaussian fit with unknown variance: m·ln(SSR/m) + p·ln(m).
/// Source: Schwarz, Ann. Statist. 6 (1978) 461. `p` counts what was fitted, nuisance included; `residuals`
/// are independent ones, which need not be a whole number.
[[nodiscard]] double bic(double sum_of_squares, double residuals, std::size_t parameters);

/// Sets the cross-validation error (RMS) and its standard error from the parts that were withheld. Parts of
/// which a candidate says nothing are NaN.
void set_cross_validation(Candidate& candidate, std::vector<double> withheld,
                          std::vector<double> weights = {});

/// By how much `b` predicts the withheld parts better than `a`: the mean of the differences of their squared
/// errors, part by part, in standard errors of that mean. All models have the same parts, easy and hard ones,
/// and what those have in common says nothing of the models. NaN: fewer than two parts in common.
[[nodiscard]] double paired_improvement(const Candidate& a, const Candidate& b);

/// Marks the smallest candidate that no other beats and returns its index. One beats another that has the
/// larger BIC and predicts the withheld parts worse by more than one standard error of the paired
/// differences; where parts were not withheld, by BIC alone. Of several of one size the one of the least BIC.
/// Each candidate's note says what decided. `candidates` is not empty.
std::size_t choose_model(std::vector<Candidate>& candidates);

}  // namespace rigor::calibration
