// Which of nested models the data support. Two judges that can disagree, both reported: BIC (in-sample) and
// cross-validation (error on what a model was not fitted to).
#pragma once

#include <vector>

#include "calibration/core/fit_result.h"

namespace rigor::calibration {

/// Bayesian information criterion of a Gaussian fit with unknown variance: m·ln(SSR/m) + p·ln(m).
/// Source: Schwarz, Ann. Statist. 6 (1978) 461. `p` counts what was fitted, nuisance included.
[[nodiscard]] double bic(double sum_of_squares, std::size_t residuals, std::size_t parameters);

/// Marks the smallest candidate that the data support and returns its index: of those whose cross-validation
/// error is within one standard error of the best one's (Breiman et al. 1984, the one-standard-error rule)
/// the one with the fewest parameters; where no candidate was cross-validated, that of the least BIC. Says in
/// each candidate's note what spoke against it. `candidates` is not empty.
std::size_t choose_model(std::vector<Candidate>& candidates);

}  // namespace rigor::calibration
