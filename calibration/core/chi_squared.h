// What estimates of a variance need: the chi-squared distribution and the moments of its logarithm.
// Any thread.
#pragma once

namespace rigor::calibration {

/// Derivatives of ln Γ, x > 0: E[ln χ²_ν] = ψ(ν/2) + ln 2, Var = ψ₁(ν/2).
[[nodiscard]] double digamma(double x);
[[nodiscard]] double trigamma(double x);
/// P(χ²_ν ≤ x); ν > 0 need not be whole.
[[nodiscard]] double chi_squared_cdf(double x, double dof);
/// Its inverse, 0 < p < 1, to 1e-10 relative.
[[nodiscard]] double chi_squared_quantile(double p, double dof);
/// Limit that |Student's t| of `dof` degrees of freedom exceeds as often as a normal variable exceeds
/// `sigmas`
/// (> 0, below 8); infinite for less than one degree of freedom.
[[nodiscard]] double student_limit(double sigmas, double dof);
/// 97.5 % quantile of Student's t over 1.96: by how much an interval widens whose variance was itself
/// estimated from `dof` numbers; infinite for less than one.
[[nodiscard]] double student_widening(double dof);

}  // namespace rigor::calibration
