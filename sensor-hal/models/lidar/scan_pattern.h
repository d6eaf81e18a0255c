// Where a LiDAR looks, firing by firing: a table from a file, or a formula. Such patterns go on from scan to
// scan: scan k has the firings of the pattern's time from k · scan time to (k + 1) · scan time.
//
//   time_s,azimuth_deg,elevation_deg,divergence_mrad     # the header may be left out, and so may divergence
//   0.000000,12.5,-3.25,3.0
//   0.000005,13.1,-3.20,3.0
//
// Times count from the first row and do not decrease; rows of the same time fire together. A periodic table
// begins again after its period; another one ends, and later scans have no firings. Azimuth from x towards y,
// elevation from the xy plane up, as everywhere in the sensor's frame.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "rt-core/result.h"

namespace rigor::models {

inline constexpr std::size_t kMaxPatternRows = std::size_t{1} << 22;

struct PatternFiring {
  std::int64_t time_ns = 0;  ///< after the first
  float azimuth_rad = 0, elevation_rad = 0;
  float divergence_rad = 0;  ///< full angle, of both axes
};

struct PatternTable {
  std::vector<PatternFiring> firings;
  bool has_divergence = false;
  bool periodic = false;
  std::int64_t period_ns = 0;  ///< where periodic

  /// Appends the firings of scan `index`, their times after the scan's beginning.
  void scan(std::uint64_t index, std::int64_t scan_ns, std::vector<PatternFiring>& out) const;
  /// Most firings that any scan of this length has.
  [[nodiscard]] std::size_t max_firings(std::int64_t scan_ns) const;
  /// Time between firings where it is always the same, over the end of a period, too; 0: it is not.
  [[nodiscard]] std::int64_t step_ns() const;
};

enum class PatternFormula : std::uint8_t { none, livox_mid360 };

/// A table or a formula.
struct ScanPattern {
  std::shared_ptr<const PatternTable> table;
  PatternFormula formula = PatternFormula::none;
};

/// bad_input with `name`:line: what was expected, what came. The period is set apart (set_period). Setup.
[[nodiscard]] Result<PatternTable> parse_scan_pattern(std::string_view text, const std::string& name);
/// The same of a file; not_found.
[[nodiscard]] Result<PatternTable> load_scan_pattern(const std::filesystem::path& file);
/// Makes it periodic. `period_ns` 0: derived, so that the first firing follows the last after the mean step.
/// bad_input: a period that ends before the last firing; none given with a single row, or rows of one time.
[[nodiscard]] Status set_period(PatternTable& table, std::int64_t period_ns);

/// A Livox Mid-360: 200,000 firings a second in groups of four lines, 360° by −7 to 52°, that do not repeat.
inline constexpr std::uint32_t kLivoxLines = 4;
inline constexpr double kLivoxFiring_s = 5e-6;
/// Unit direction of a line at a time of the pattern. An approximation of the table that Livox publishes for
/// its simulators (livox_laser_simulation, scan_mode/mid360.csv, MIT): two elements turn evenly; see the
/// source.
[[nodiscard]] std::array<double, 3> livox_mid360_direction(std::uint32_t line, double t_s);

}  // namespace rigor::models
