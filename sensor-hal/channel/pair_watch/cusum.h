// Cumulative sums (Page 1954) of standardised numbers, and how long they run without an alarm.
//
//   up_n = max(0, up_{n−1} + z_n − k),   down_n = max(0, down_{n−1} − z_n − k),   alarm at h
#pragma once

#include <cstdint>

namespace rigor::pair_watch {

/// Mean number of independent standard normal numbers, shifted by `shift`, until a one-sided sum with
/// reference value k reaches h: Siegmund's approximation, (e^{−2Δb} + 2Δb − 1)/(2Δ²) with Δ = shift − k and
/// b = h + 1.166 (Sequential Analysis, 1985, section 2.6). Good to some per cent for k up to 1; for
/// larger k it is too long, by 16 % at 1.5.
[[nodiscard]] double run_length_one_sided(double k, double h, double shift = 0);
/// Of both sides together, in control: half of one side's.
[[nodiscard]] double run_length_two_sided(double k, double h);
/// The h at which both sides together run `run_length` numbers on average; at least 1.
[[nodiscard]] double threshold_for(double k, double run_length);

/// Quantiles of the standard normal; after Wilson and Hilferty of the chi-squared; and, by the expansion of
/// Cornish and Fisher to the second order (for 15 degrees of freedom and more), of Student's distribution.
[[nodiscard]] double normal_quantile(double probability);
[[nodiscard]] double chi_squared_quantile(double probability, double degrees_of_freedom);
[[nodiscard]] double student_quantile(double probability, double degrees_of_freedom);

/// Two-sided. Any one thread; no allocation. A number adds to a sum h/2 at most, so that a single window that
/// was disturbed (a hand before the lens) is no alarm.
class Cusum {
 public:
  Cusum() = default;
  Cusum(double k, double h) noexcept : k_(k), h_(h) {}
  /// `window` counts the numbers of all sums alike. Not finite: nothing happens.
  void add(double z, std::uint64_t window) noexcept;
  void restart(std::uint64_t window) noexcept;
  [[nodiscard]] bool alarm() const noexcept { return level() >= 1; }
  /// The larger sum over h.
  [[nodiscard]] double level() const noexcept { return (up_ > down_ ? up_ : down_) / h_; }
  /// The first window since which the larger sum has not been 0: an estimate of when the change came.
  [[nodiscard]] std::uint64_t since() const noexcept { return up_ > down_ ? up_since_ : down_since_; }
  [[nodiscard]] double k() const noexcept { return k_; }
  [[nodiscard]] double h() const noexcept { return h_; }

 private:
  double k_ = 0.5, h_ = 5, up_ = 0, down_ = 0;
  std::uint64_t up_since_ = 0, down_since_ = 0;
};

}  // namespace rigor::pair_watch
