// The plots that reports need, as SVG text. The script of a report's page (page.cpp) shows values under the
// pointer and enlarges what is dragged over; without it they are plain pictures.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

namespace rigor {

/// About `parts` round steps for an axis from a to b: 1, 2 or 5 times a power of ten. Only `a` where there is
/// no span.
[[nodiscard]] std::vector<double> axis_ticks(double a, double b, int parts);

/// Where a plot lies in its picture, and the values at its edges.
struct PlotFrame {
  double width = 560, height = 180, left = 56, top = 10, right = 12, bottom = 34;
  double x0 = 0, x1 = 1, y0 = 0, y1 = 1;
  std::string axis = "time";  ///< of x: `time` in seconds, or `log ns`, the decimal logarithm of nanoseconds
  [[nodiscard]] double plot_width() const { return width - left - right; }
  [[nodiscard]] double plot_height() const { return height - top - bottom; }
  [[nodiscard]] double px(double x) const { return left + plot_width() * (x - x0) / (x1 - x0); }
  [[nodiscard]] double py(double y) const { return top + plot_height() * (y1 - y) / (y1 - y0); }
};
/// Begins a plot: `<svg>`.
[[nodiscard]] std::string open_plot(const PlotFrame& frame, const std::string& style = {});
/// Begins what moves with a zoom, clipped to the frame; ends with `</svg>`.
[[nodiscard]] std::string open_data(const PlotFrame& frame);
/// Labels of the x axis.
[[nodiscard]] std::string x_label(const PlotFrame& frame, double x, const std::string& text);
/// `points` are in the picture's coordinates, "x,y x,y …". `colour`: a CSS colour.
[[nodiscard]] std::string plot_line(const std::string& name, const std::string& colour,
                                    const std::string& points);

/// A histogram of nanoseconds on a logarithmic axis; `buckets` as report_json writes them: [[from, to,
/// count], …]. Bars above `limit_ns` are red.
[[nodiscard]] std::string svg_histogram(const nlohmann::json& histogram, const std::string& label,
                                        std::optional<double> limit_ns = {});

struct SvgSeries {
  std::string name, colour;  ///< a CSS colour, such as "var(--series-1)"
  std::vector<double> x, y;
};
/// Lines over time.
[[nodiscard]] std::string svg_lines(const std::vector<SvgSeries>& series, const std::string& x_title,
                                    const std::string& y_title);
/// Status of a port over the run: one bar, coloured by status.
[[nodiscard]] std::string svg_status(const nlohmann::json& spans, double duration_s);

}  // namespace rigor
