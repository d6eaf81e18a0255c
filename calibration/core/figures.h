// What a calibration shows beside its numbers: plots as data. The command line draws them.
#pragma once

#include <string>
#include <vector>

namespace rigor::calibration {

struct Series {
  std::string name;
  std::vector<double> x, y;
  bool line = false;  ///< joined; else points
};

/// Of metres.
[[nodiscard]] inline std::vector<double> in_mm(std::vector<double> v) {
  for (double& x : v) x *= 1e3;
  return v;
}

struct Figure {
  enum class Kind : std::uint8_t {
    series,     ///< `series` over axes
    histogram,  ///< of series[0].y; series[1], where there is one, is a curve over it in counts
    quantiles,  ///< Q–Q: series[0].y sorted against the normal distribution, in standard deviations
    map,        ///< `values`, row by row, `columns` wide, over the ranges of x and y
    arrows      ///< series[0] places, series[1] what to add to them times `stretch`
  } kind = Kind::series;
  std::string title{}, caption{}, x_label{}, y_label{};
  std::vector<Series> series{};
  std::vector<double> values{};  ///< NaN: nothing there
  int columns = 0;
  double x_from = 0, x_to = 0, y_from = 0,
         y_to = 0;  ///< of maps and arrows; of series where given: else they span the data
  double stretch = 1;
  std::string value_label{};
};

}  // namespace rigor::calibration
