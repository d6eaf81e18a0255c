// A LiDAR as numbers: scan pattern, beam, echoes, range and remission errors. The simulator measures with it
// (sim/sensors/lidar), a calibrator fits it, configs/sensors/ holds it as files (lidar_yaml.h). The
// arithmetic is in lidar.glsl.h. Sensor frame: x forward, y left, z up; azimuth from x towards y, elevation
// from the xy plane up.
//
// A scan is `columns` firing sequences, one after the other by `column_period_s`; in each, every beam fires
// once at its own time. (The firings of a pattern's table have times of their own.) A parameter at its
// default is an effect that is off and costs nothing.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/models/lidar/scan_pattern.h"

namespace rigor::models {

inline constexpr std::size_t kMaxLidarBeams = 4096;
inline constexpr std::size_t kMaxLidarFirings = std::size_t{1} << 22;  ///< of one scan
inline constexpr int kMaxLidarSubRays = 256;

/// One laser. Where its beam starts and where it points, against the rotor's azimuth.
struct LidarBeam {
  double elevation_rad = 0, azimuth_rad = 0;
  double vertical_offset_m = 0;    ///< of the beam's origin, along z
  double horizontal_offset_m = 0;  ///< level, square to the beam, to its left
  double radial_offset_m = 0;      ///< level, along the beam
  double fire_time_s = 0;          ///< after the beginning of its column
  double range_bias_m = 0;         ///< is added to what it measures
  double remission_gain = 1;
};

enum class LidarScanKind : std::uint8_t { rotor, rosette, pattern };

/// Two turning wedges (lidar.glsl.h: lidar_risley_direction). Angles go on with bench time, so that scans
/// follow each other without repeating.
struct RisleyPrisms {
  std::array<double, 2> wedge_rad{0, 0};
  std::array<double, 2> rotation_radps{0, 0};  ///< signed
  std::array<double, 2> phase_rad{0, 0};       ///< at bench time 0
  double index = 1.51;
};

struct LidarScan {
  LidarScanKind kind = LidarScanKind::rotor;
  std::vector<LidarBeam> beams{LidarBeam{}};
  std::uint32_t columns = 1;     ///< of a pattern's table: most firings of a scan
  double column_period_s = 0;    ///< from one column's beginning to the next's; 0: a table without even steps
  double start_azimuth_rad = 0;  ///< rotor: of the first column
  double rotation_radps = 0;     ///< rotor, signed: positive anticlockwise seen from above
  RisleyPrisms prisms;           ///< rosette; beams are the directions that go into the prisms
  ScanPattern pattern;
  std::int64_t pattern_scan_ns = 0;  ///< pattern: of one scan; the next goes on where it ends
  int instants = 5;                  ///< at which the world is taken over a scan, where anything moves

  /// Of the beginning of column c, rotor.
  [[nodiscard]] double azimuth_rad(double column) const {
    return start_azimuth_rad + rotation_radps * column_period_s * column;
  }
  [[nodiscard]] double last_fire_time_s() const;
  /// From the first firing's column to the last firing; of a pattern's table, of the scan.
  [[nodiscard]] double duration_s() const {
    if (pattern.table) return static_cast<double>(pattern_scan_ns) * 1e-9;
    return column_period_s * static_cast<double>(columns > 0 ? columns - 1 : 0) + last_fire_time_s();
  }
};

enum class LidarProfile : std::uint8_t { gaussian, top_hat };

struct LidarFootprint {
  /// Full angles: of the 1/e² diameter of a Gaussian beam, or the edge of an even one.
  double horizontal_divergence_rad = 0, vertical_divergence_rad = 0;
  double start_diameter_m = 0;
  LidarProfile profile = LidarProfile::gaussian;
  int sub_rays = 1;  ///< 1: the centre alone; 5, 7, 13, 19, 37 and 61 lie in rings, others in a spiral
  /// More than sub_rays: a footprint's rays follow a sequence of its own, and where sub_rays of them leave
  /// open what the device says, their number is doubled, up to this. 0: never.
  int most_sub_rays = 0;
};

enum class LidarReturns : std::uint8_t { strongest, first, last, dual };

struct LidarEchoes {
  /// Returns of a footprint nearer to each other than this are one echo, at the mean by power.
  double separation_m = 0;
  /// dual: the strongest, and the last or (where the strongest is the last) the second strongest, if there is
  /// one.
  LidarReturns returns = LidarReturns::strongest;
};

/// lidar.glsl.h: lidar_least_remission.
struct LidarDetection {
  double minimum_remission = 0;
  double limit_remission = 0, limit_range_m = 0;  ///< this remission is just seen at this range; 0: no limit
  double overlap_m = 0;                           ///< nearer, the received power grows no more
};

/// lidar.glsl.h: lidar_range_error_m.
struct LidarRange {
  double min_m = 0, max_m = 100;
  double step_m = 0;            ///< of the device's number; 0: not rounded
  double bias_m = 0;            ///< of all beams
  double scale = 1;             ///< measured over true
  double remission_bias_m = 0;  ///< of an echo without light against a white plate's
  double incidence_bias_m = 0;  ///< of a surface seen along itself against one seen square on
  double housing_m = 0;         ///< what is nearer is the sensor's own housing and is not met
};

/// lidar.glsl.h: lidar_range_sigma_m.
struct LidarNoise {
  double floor_m = 0, scale_m = 0, offset = 0, exponent = 1;
  double reference_range_m = 0;  ///< q is the received power relative to remission 1 there; 0: the remission
  double retro_sigma_m = 0;      ///< of echoes of remission above 1 (crosstalk, edges); 0: as the others
};

/// lidar.glsl.h: lidar_remission_units; then relative noise, rounding, limit.
struct LidarRemission {
  double scale = 1;              ///< device units of remission 1
  double retro_scale = 0;        ///< device units per remission above 1
  double range_exponent = 0;     ///< 0: compensated for range, 2: raw
  double reference_range_m = 0;  ///< where both are the same; needed with range_exponent
  double noise = 0;              ///< relative standard deviation
  double maximum = 0;            ///< saturation; 0: none
  double step = 0;               ///< 0: not rounded
};

struct LidarRetro {
  double gain = 1;  ///< remission of a perfect retro-reflector
  /// Of a retro-reflector's remission (above 1) this share appears as a ghost at its range in the beams and
  /// columns beside it, its square in those two away, and so on.
  double crosstalk = 0;
  int crosstalk_beams = 1, crosstalk_columns = 1;  ///< how far it reaches
};

/// A beam within half_angle_rad of the sun, where the sun is up and not hidden, sees noise of
/// B = gain · irradiance in the beam's band: the least remission rises by 1 + B, sigma by sqrt(1 + B).
struct LidarSun {
  double half_angle_rad = 0;
  double gain_m2_per_w = 0;
};

struct LidarAir {
  double drop_reflectance = 0;  ///< of rain drops and flakes; 0: no early returns from them
  double lidar_ratio_sr = 0;    ///< extinction over backscatter of fog (18); 0: no returns from it
  double pulse_length_m = 0;    ///< over which fog's backscatter adds up
};

struct LidarModel {
  double wavelength_nm = 905;
  LidarScan scan;
  LidarFootprint footprint;
  LidarEchoes echoes;
  LidarDetection detection;
  LidarRange range;
  LidarNoise noise;
  LidarRemission remission;
  LidarRetro retro;
  LidarSun sun;
  LidarAir air;

  /// Says which value is out of its bounds, what was expected and what came. Setup.
  [[nodiscard]] Status validate() const;
  [[nodiscard]] std::size_t firings() const { return scan.beams.size() * scan.columns; }
};

/// A ray of the footprint: place on the unit disc (times half the divergence it is an angle, times half the
/// start diameter a shift) and its share of the beam's power. Shares add up to 1; [0] is the centre.
struct SubRay {
  double u = 0, v = 0;  ///< u level to the left, v up
  double weight = 1;
};
/// The disc in cells of the same area, one sub-ray in each, the weight that of the profile over the cell.
/// Setup; the same for the same footprint.
[[nodiscard]] std::vector<SubRay> footprint_pattern(const LidarFootprint& footprint);
/// Ray k of a footprint whose rays are a sequence: of low discrepancy, by the profile, so that all weigh the
/// same. `firing` shifts the sequence.
[[nodiscard]] SubRay footprint_ray(const LidarFootprint& footprint, std::uint32_t firing, std::uint32_t k);

/// Direction of a beam (unit length, sensor frame) and the point it starts from, for a rotor at `azimuth_rad`
/// (which includes the turn up to the firing).
struct LidarAim {
  std::array<double, 3> direction{1, 0, 0}, origin_m{0, 0, 0};
};
[[nodiscard]] LidarAim rotor_aim(const LidarBeam& beam, double azimuth_rad);
/// The same through prisms, at a bench time in seconds.
[[nodiscard]] LidarAim rosette_aim(const LidarBeam& beam, const RisleyPrisms& prisms, double t_s);
/// A scan by a formula: beams, columns and times of a scan of `scan_ns`. Precondition: a formula.
[[nodiscard]] LidarScan formula_scan(PatternFormula formula, std::int64_t scan_ns);
/// A scan by a table.
[[nodiscard]] LidarScan table_scan(std::shared_ptr<const PatternTable> table, std::int64_t scan_ns);

}  // namespace rigor::models
