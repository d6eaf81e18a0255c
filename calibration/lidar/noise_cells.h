// Shots of one beam at (nearly) one azimuth, and which of them are noise about a surface that holds still.
// Not for use beside range_noise.cpp.
//
// A person who walks through the scene makes the ranges of a beam jump, gives them several modes, or makes
// one shot follow from the one before. So each cell is judged over time, on its own:
//   - its centre is the mode of its ranges, not their median: a wall that was hidden for most of the time is
//     still found;
//   - shots beyond the limit are left out, and where three or more in a row are, so are the shots next to
//   them
//     (a beam that meets the outline of a person is part wall, part person);
//   - its scale is the smaller of that about its centre and that of successive differences, which neither a
//     jump nor a drift raises by much;
//   - a cell whose remaining shots are correlated from scan to scan, beyond what all cells are, is left out.
// What variance is typical is the mode of all cells of about one remission, and for a bin of remission that
// stands out against the bins on both sides of it, theirs.
#pragma once

#include <cstdint>
#include <vector>

#include "calibration/lidar/range_noise.h"

namespace rigor::calibration::lidar {

class NoiseCells {
 public:
  struct Group {
    std::uint32_t begin = 0, end = 0;  ///< into order()
    int degree = 0;                    ///< of the polynomial over azimuth that its shots lie about
    NoiseCell cell;
    double correlation = 0, pairs = 0;  ///< of successive shots that were both used
    bool moved = false;
  };

  NoiseCells(const LidarReturns& returns, const models::LidarModel& sensor_model);
  /// Fills the cells, `used` of each, and the residuals of the shots that are noise.
  void choose();

  std::vector<Group> groups;           ///< with a degree of freedom
  std::vector<std::uint32_t> order;    ///< indices of returns, group by group in the order of time
  std::vector<float> shot_residual_m;  ///< of each return; NaN: not used

 private:
  void group();
  /// Residuals of a cell's shots about a polynomial over azimuth; `limit_m` > 0: shots beyond it take no
  /// part.
  void measure(Group& g, double limit_m, bool keep);
  /// Of each group: what cells of its remission have, edges and movers aside.
  [[nodiscard]] std::vector<double> typical_variance() const;

  const LidarReturns& r_;
  const models::LidarModel& sensor_model_;
  double step_m_, width_ = 0;
};

}  // namespace rigor::calibration::lidar
