// The two plots that a report needs, as SVG text.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

namespace rigor {

/// About `parts` round steps for an axis from a to b: 1, 2 or 5 times a power of ten. Only `a` where there is
/// no span.
[[nodiscard]] std::vector<double> axis_ticks(double a, double b, int parts);

/// A histogram of nanoseconds on a logarithmic axis; `buckets` as run_result writes them: [[from, to, count],
/// …].
[[nodiscard]] std::string svg_histogram(const nlohmann::json& histogram, const std::string& label);

struct SvgSeries {
  std::string name, colour;
  std::vector<double> x, y;
};
/// Lines over time.
[[nodiscard]] std::string svg_lines(const std::vector<SvgSeries>& series, const std::string& x_label,
                                    const std::string& y_label);
/// Status of a port over the run: one bar, coloured by status.
[[nodiscard]] std::string svg_status(const nlohmann::json& spans, double duration_s);

}  // namespace rigor
