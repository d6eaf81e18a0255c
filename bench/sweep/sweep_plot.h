// One number of many runs over one parameter, as SVG text: each run a dot, the mean of each value of the
// parameter with its 95 % interval.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "bench/sweep/statistics.h"
#include "bench/sweep/sweep_plan.h"

namespace rigor::sweep {

/// Runs with one value of a parameter, or with values that lie near each other.
struct Group {
  std::string label;
  double x = 0;  ///< on the axis
  std::vector<std::uint64_t> runs;
};
/// The values of one parameter over all runs, as an axis.
struct Axis {
  std::string key;
  bool numbers = false;      ///< else places 0, 1, … of the values
  bool logarithmic = false;  ///< x is the decimal logarithm of the value
  std::vector<double> x;     ///< by run
  std::vector<Group> groups;
  std::vector<std::vector<std::uint64_t>> same;  ///< runs with exactly the same value
};
/// Of parameter `parameter` of the plan. More than kMostGroups different numbers are put into kBins equal
/// parts of their range.
[[nodiscard]] Axis axis_of(const SweepPlan& plan, std::size_t parameter);
inline constexpr std::size_t kMostGroups = 24, kBins = 10;

/// What is drawn at a group.
struct GroupMean {
  double mean = 0;
  Interval95 interval;  ///< NaN: not known
};
enum class PlotOf : std::uint8_t {
  runs,   ///< a dot for each run, and the means
  means,  ///< these alone
  shares  ///< these alone, on an axis from 0 to 1
};
/// `values`: by run; NaN is left out. `means`: by group.
[[nodiscard]] std::string sweep_plot(const Axis& axis, const std::vector<double>& values,
                                     const std::vector<GroupMean>& means, PlotOf what);

}  // namespace rigor::sweep
