// From the points of a scan back to its firings: what an emulated scanner has to tell of each of them, those
// without a return included.
//
//   auto grid = ScanGrid::create(*parts.samples->scan());     // setup
//   grid->fill(points);                                        // of one scan, in the sensor's frame
//   for (column …) for (beam …)
//     if (const ScanGrid::Return& r = grid->at(column, beam); r.range_m > 0) …
//
// A point's t_offset_ns and ring name its firing: firings of one beam are a column period apart and stamped
// to the nanosecond, so nothing is guessed from where the point lies. Its range is measured from the origin
// of its beam along that beam's direction, as the device did before it was turned into a point. Where a
// pattern's firings point changes from scan to scan; a grid of one has the places of its returns instead.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/models/lidar/lidar_model.h"
#include "sensor-hal/types/sample.h"

namespace rigor::models {

/// Setup: create, copy. `fill` and the rest: one thread at a time, no allocation.
class ScanGrid {
 public:
  struct Return {
    float range_m = 0;  ///< 0: none
    float remission = 0;
  };
  static constexpr std::size_t kReturns = 2;

  /// bad_input: not a rotor, or a scan of no columns.
  [[nodiscard]] static Result<ScanGrid> create(const LidarScan& scan);
  /// bad_input: not a pattern, or one whose firings are not evenly apart, so that a scan holds not always
  /// the same.
  [[nodiscard]] static Result<ScanGrid> create_of_pattern(const LidarScan& scan);

  /// Takes the place of what was there. `turn_rad`: that of the request (SampleProvider::Request).
  void fill(std::span<const LidarPoint> points, double turn_rad = 0);
  /// Points that belonged to no firing of this scan; 0, unless the points are another scan's.
  [[nodiscard]] std::size_t strays() const { return strays_; }

  [[nodiscard]] std::uint32_t columns() const { return scan_.columns; }
  [[nodiscard]] std::uint32_t beams() const { return static_cast<std::uint32_t>(scan_.beams.size()); }
  /// `index`: 0 the strongest or only return, 1 the other. Precondition: column < columns(), beam < beams().
  [[nodiscard]] const Return& at(std::uint32_t column, std::uint32_t beam, std::size_t index = 0) const {
    return returns_[(std::size_t{column} * scan_.beams.size() + beam) * kReturns + index];
  }
  /// Of a pattern: where the first return is, in the sensor's frame. Precondition as above.
  [[nodiscard]] const std::array<float, 3>& place_m(std::uint32_t column, std::uint32_t beam) const {
    return places_[std::size_t{column} * scan_.beams.size() + beam];
  }
  [[nodiscard]] const LidarScan& scan() const { return scan_; }
  /// Of a firing, after the first column's beginning.
  [[nodiscard]] Duration fire_time(std::uint32_t column, std::uint32_t beam) const {
    return seconds_from(scan_.column_period_s * column + scan_.beams[beam].fire_time_s);
  }
  /// Of the rotor at a firing (a beam's own azimuth comes on top), anticlockwise, not wrapped.
  [[nodiscard]] double azimuth_rad(std::uint32_t column, std::uint32_t beam) const {
    return scan_.azimuth_rad(column) + scan_.rotation_radps * scan_.beams[beam].fire_time_s;
  }

 private:
  explicit ScanGrid(const LidarScan& scan);
  LidarScan scan_;
  std::vector<Return> returns_;
  std::vector<std::array<float, 3>> places_;  ///< of a pattern
  std::size_t strays_ = 0;
};

}  // namespace rigor::models
