// What many runs say of a number or of an expectation, and how sure that is.
#pragma once

#include <cstddef>
#include <vector>

namespace rigor::sweep {

struct Interval95 {
  double from = 0, to = 0;
};

/// Of numbers that are finite. All are NaN of none; `mean95` and `sd` of one.
struct Summary {
  std::size_t count = 0;
  double mean = 0, sd = 0;  ///< sd: of the sample, with count − 1
  Interval95 mean95;        ///< of the mean: Student's t with count − 1 degrees of freedom
  double min = 0, p05 = 0, p50 = 0, p95 = 0, max = 0;  ///< linear between order statistics
};
/// NaN among `values` are left out.
[[nodiscard]] Summary summarize(std::vector<double> values);

/// Wilson's interval of a share: `hits` of `count`, which is not 0 (Wilson 1927, without correction for
/// continuity).
[[nodiscard]] Interval95 wilson95(std::size_t hits, std::size_t count);

/// The share of the variance of all values that lies between the groups: 1 − (SSW/(N − k)) / (SST/(N − 1)),
/// which is 0 on average where groups do not differ (Kelley 1935, ε²); not below 0. NaN where it is not
/// known: fewer than two groups, no more values than groups, or no variance.
[[nodiscard]] double explained_share(const std::vector<std::vector<double>>& groups);

}  // namespace rigor::sweep
