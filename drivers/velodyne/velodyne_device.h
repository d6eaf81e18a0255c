// What is known of the two devices beside their bytes: lasers, when each fires, and what their calibration
// says.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include "drivers/velodyne/velodyne_packet.h"
#include "rt-core/result.h"

namespace rigor::velodyne {

enum class Model : std::uint8_t { vlp16, hdl32e };

/// Where a laser is and points, and how its numbers are corrected. Sensor frame: x forward, y left, z up.
struct LaserCalibration {
  double elevation_rad = 0;
  double azimuth_rad = 0;          ///< of the beam against the rotor, anticlockwise
  double range_correction_m = 0;   ///< is added to what it measures
  double vertical_offset_m = 0;    ///< of the beam's origin, along z
  double horizontal_offset_m = 0;  ///< of the beam's origin, level, to the beam's left
  double min_intensity = 0, max_intensity = 255;
  double focal_distance_m = 0, focal_slope = 0;  ///< intensity by range; slope 0: none
};
struct Calibration {
  std::vector<LaserCalibration> lasers;  ///< by laser id, which is the order of firing
  double range_unit_m = kRangeUnit_m;
};

/// Timing from the manuals: 2.304 µs from laser to laser and 55.296 µs from sequence to sequence (VLP-16: 16
/// lasers and a pause), 1.152 µs and 46.080 µs (HDL-32E).
struct DeviceFacts {
  Model model;
  std::string_view name, key;  ///< "VLP-16", `vlp16`
  std::uint8_t product;
  std::uint32_t lasers, sequences_per_block;
  std::int64_t laser_ns, sequence_ns;

  [[nodiscard]] constexpr std::uint32_t sequences_per_packet(bool dual) const {
    return sequences_per_block * static_cast<std::uint32_t>(dual ? kBlocks / 2 : kBlocks);
  }
  [[nodiscard]] constexpr std::int64_t packet_ns(bool dual) const {
    return sequences_per_packet(dual) * sequence_ns;
  }
  [[nodiscard]] constexpr double packets_per_s(bool dual) const {
    return 1e9 / static_cast<double>(packet_ns(dual));
  }
};
[[nodiscard]] const DeviceFacts& facts_of(Model model);
/// By the product byte; empty: another product.
[[nodiscard]] std::optional<Model> model_of(std::uint8_t product);
[[nodiscard]] std::optional<Model> model_named(std::string_view key);

/// What the manual says of the model; no specimen's own corrections.
[[nodiscard]] Calibration factory_calibration(Model model);
/// Place of each laser in the order of elevation, the lowest 0.
[[nodiscard]] std::vector<std::uint16_t> elevation_order(const Calibration& calibration);

/// Which model a stream is of, whatever its product byte says: by the device's own time from packet to
/// packet, which is 1327.1 µs for a VLP-16 and 553.0 µs for an HDL-32E (half of it with dual returns). One
/// thread.
class ModelEvidence {
 public:
  void add(const DataPacket& packet) noexcept;
  /// Empty until enough packets were seen, and where they fit neither.
  [[nodiscard]] std::optional<Model> model() const noexcept;
  [[nodiscard]] std::uint64_t votes(Model model) const noexcept {
    return votes_[static_cast<std::size_t>(model)];
  }

 private:
  bool any_ = false;
  std::uint32_t last_us_ = 0;
  std::uint64_t votes_[2] = {0, 0};
};

}  // namespace rigor::velodyne
