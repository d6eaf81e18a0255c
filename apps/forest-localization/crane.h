// A crane that works from a vehicle: where its head is, how to bring it to a stem, and the order of things
// there. What it is told and what it tells are plain numbers in the units of its signals.
//
// Kinematics, in the base's frame (x forward, y left, z up from the ground): the boom turns with the slew
// about the foot's vertical, rises by its angle, the stick folds against it (negative: down), the telescope
// lengthens the stick, and the head hangs `head_m` below the stick's end.
//
//   distance from the foot   r = boom·cos(b) + (stick + telescope)·cos(b + s)
//   height of the head       z = foot + boom·sin(b) + (stick + telescope)·sin(b + s) − head
//
// Work on a stem: swing there with the head short of it, reach out, grip, cut, let go, fold to rest. Each
// part ends when the crane tells that it is there; one that takes too long ends the work without a cut.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "rt-core/time.h"

namespace rigor::forest {

struct CraneAngles {
  double slew_rad = 0, boom_rad = 0, stick_rad = 0, telescope_m = 0;
};

struct CraneGeometry {
  double foot_x_m = 0, foot_y_m = 0, foot_z_m = 0;  ///< in the base's frame
  double boom_m = 4, stick_m = 3.5, head_m = 0.9;
  CraneAngles least{-1.9, -0.2, -2.4, 0}, greatest{1.9, 1.3, -0.2, 2.4};  ///< end stops
};

struct CranePlace {
  double x_m = 0, y_m = 0, z_m = 0;  ///< in the base's frame
};
[[nodiscard]] CranePlace place_of_head(const CraneGeometry& crane, const CraneAngles& angles) noexcept;
/// Angles that bring the head there, elbow up, with the telescope as short as it can be; none: out of reach.
[[nodiscard]] std::optional<CraneAngles> angles_for(const CraneGeometry& crane,
                                                    const CranePlace& head) noexcept;

struct CraneWorkConfig {
  CraneGeometry crane;
  CraneAngles rest{0, 1.0, -2.0, 0};
  double cut_height_m = 0.4;  ///< of the head above the base's ground
  double short_of_m = 1.0;    ///< the head stops so far before the stem, then reaches out
  double angle_tolerance_rad = 0.01, length_tolerance_m = 0.02;
  Duration grip_time = seconds(2), patience = seconds(30);
};

/// What the crane tells.
struct CraneTold {
  CraneAngles angles;
  double felled = 0;  ///< stems since it was switched on
};
/// What it is told.
struct CraneCommand {
  CraneAngles to;
  double rotate_rad = 0, grip = 0, fell = 0;
};

/// Loop thread; no allocation.
class CraneWork {
 public:
  enum class State : std::uint8_t { rest, swing, reach, grip, cut, release, fold };

  explicit CraneWork(const CraneWorkConfig& config);
  [[nodiscard]] const CraneWorkConfig& config() const noexcept { return config_; }
  /// Whether the stem can be cut from where the base stands.
  [[nodiscard]] bool reaches(double x_m, double y_m) const noexcept;
  /// Begins with a stem at a place in the base's frame. False: out of reach, or busy.
  bool begin(double x_m, double y_m, const CraneTold& told, BenchTime now) noexcept;
  [[nodiscard]] CraneCommand step(const CraneTold& told, BenchTime now) noexcept;
  [[nodiscard]] bool busy() const noexcept { return state_ != State::rest; }
  [[nodiscard]] State state() const noexcept { return state_; }
  /// Stems that the crane said it cut, and works that ended without.
  [[nodiscard]] std::uint32_t cut() const noexcept { return cut_; }
  [[nodiscard]] std::uint32_t failed() const noexcept { return failed_; }

 private:
  [[nodiscard]] std::optional<std::array<CraneAngles, 2>> way_to(double x_m, double y_m) const noexcept;
  [[nodiscard]] bool is_at(const CraneAngles& to, const CraneTold& told) const noexcept;
  void enter(State state, BenchTime now) noexcept;

  CraneWorkConfig config_;
  State state_ = State::rest;
  BenchTime since_;
  CraneAngles before_, at_;  ///< short of the stem, at the stem
  double felled_before_ = 0;
  bool success_ = false;
  std::uint32_t cut_ = 0, failed_ = 0;
};

}  // namespace rigor::forest
