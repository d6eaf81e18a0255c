// A wood harvester: a base on four wheels, and a crane with a felling head.
//
// Base: told are the speed v of the rear axle and the angle of the front wheels (bicycle model: turn rate
// v·tan(steer)/wheelbase); both follow with greatest rates, speed with a time constant too. Height, roll and
// pitch as in chassis.h; limits and faults as in skid_steer.h. No slip but a share of the way.
//
// Crane: six axes, each told a position that it goes to by a trapezoidal profile (turntable.h) within its end
// stops. All angles 0: the boom lies straight ahead, level.
//
//   slew       about the machine's z at the crane's foot; to the left is positive
//   boom       elevation of the boom;  stick: of the stick against the boom (negative folds it down)
//   telescope  lengthens the stick
//   rotate     of the head about the machine's z: it hangs along that axis, whatever boom and stick do
//   grip       0 open, 1 closed
//
// A rise of `fell` to 1 cuts the stem whose axis is nearest to the head, where one stands within reach of it;
// the tree falls away from the machine, along the crane. What was cut and when is told by `fellings`.
//
// Signals told: wheel_angle [rad], wheel_rate [rad/s], steer [deg], slew, boom, stick [deg], telescope [m],
// rotate [deg], grip, status (bit 0 enabled, 1 moving, 2 limited, 3 fault, 4 the last `fell` found a stem,
// 5 it found none), fault (0 none, 1 tilted, 2 off the ground), felled (how many); truth: x_m, y_m, z_m,
// roll_deg, pitch_deg, yaw_deg, velocity_mps, head_x_m, head_y_m, head_z_m, hang [deg] (of the joint that
// keeps the head plumb), felled_x_m, felled_y_m, felled_yaw_deg (where the head was at the last cut, and
// where the tree's top points; 0 while felled is 0). Commanded: enable, v [m/s], steer_to, slew_to, boom_to,
// stick_to [deg], telescope_to [m], rotate_to [deg], grip_to, fell. Registers: signal_registers.h, in steps
// of 0.001 (truth 0.0001; status, fault, felled, enable, fell: 1).
#pragma once

#include "sim/platform/chassis.h"
#include "sim/platform/platform.h"
#include "sim/platform/signal_platform.h"
#include "sim/platform/skid_steer.h"
#include "sim/platform/step_history.h"
#include "sim/platform/turntable.h"

namespace rigor {

/// Limits of one axis of the crane, in radians, metres or shares.
struct CraneAxis {
  double min = 0, max = 0, start = 0;
  double rate = 1, acceleration = 1;
};

struct HarvesterConfig {
  enum Axis : std::size_t { kSlew, kBoom, kStick, kTelescope, kRotate, kGrip, kAxes };
  // Shape.
  double length_m = 7.8, width_m = 2.9, hull_height_m = 1.4, clearance_m = 0.65;
  double wheel_radius_m = 0.7, wheel_width_m = 0.7, track_m = 2.2, wheelbase_m = 4.0;
  double cabin_x_m = 0.2, cabin_height_m = 3.6;
  // Drive.
  double max_speed_mps = 2.5, acceleration_mps2 = 0.5, time_constant_s = 0.3;
  double max_steer_rad = 0.6, steer_rate_radps = 0.35;
  double slip = 0.03;
  double tip_roll_rad = 0.45, tip_pitch_rad = 0.5;
  Suspension suspension{1.5, 0.6};
  // Crane.
  Eigen::Vector3d foot_m{1.6, 0, 2.0};  ///< the crane's foot in the machine's frame
  double boom_m = 4.2, stick_m = 3.6,
         head_m = 0.9;  ///< head: from the stick's end down to the middle of the grip
  std::array<CraneAxis, kAxes> axis{
      CraneAxis{-1.92, 1.92, 0, 0.5, 0.6},   CraneAxis{-0.2, 1.35, 0.9, 0.3, 0.4},
      CraneAxis{-2.4, -0.2, -1.9, 0.4, 0.5}, CraneAxis{0, 2.4, 0, 0.8, 1.2},
      CraneAxis{-3.14, 3.14, 0, 0.8, 1.5},   CraneAxis{0, 1, 0, 0.8, 2.0}};
  double reach_m = 0.45;  ///< of the head, to a stem's axis
  Duration step = milliseconds(2);
};

class Harvester final : public SignalPlatform {
 public:
  Harvester(const HarvesterConfig& config, const PlatformStart& start, Ground ground,
            std::vector<Stem> stems);

  void start(BenchTime t0) override;
  [[nodiscard]] PlatformMotion motion_at(BenchTime t) const noexcept override;
  /// wheels, steer, slew, boom, stick, telescope, hang (what keeps the head plumb), rotate, grip.
  [[nodiscard]] const std::vector<std::string>& joint_names() const override;
  [[nodiscard]] std::vector<PlatformPart> parts() const override;
  [[nodiscard]] std::span<const Felling> fellings() const noexcept override { return log_.fellings(); }
  bool apply_felling(double x_m, double y_m, double yaw_rad, BenchTime t) noexcept override;
  /// The middle of the grip, z along the machine's.
  [[nodiscard]] Eigen::Isometry3d T_world_head(BenchTime t) const noexcept;

 private:
  using Config = HarvesterConfig;
  struct Command {
    double v_mps = 0, steer_rad = 0;
    std::array<double, Config::kAxes> to{};
    bool enable = true, fell = false;
  };
  struct State {
    ChassisState chassis;
    double ramp_mps = 0, speed_mps = 0, steer_rad = 0, steer_radps = 0, wheel_rad = 0;
    std::array<TurntableProfile, Config::kAxes> axis;  ///< t_start counts from the start of the run
    std::array<double, Config::kAxes> goal{};
    std::int32_t fault = 0, trouble = 0;
    bool limited = false, stopped = false;
  };
  /// What the last `fell` did.
  struct Cut {
    enum { none, found, found_none } what = none;
    double x_m = 0, y_m = 0, yaw_rad = 0;
  };
  struct Model {
    HarvesterConfig c;
    Ground ground;
    Footprint wheels;
    [[nodiscard]] State step(const State& from, const Command& told, std::int64_t k) const noexcept;
  };
  using History = StepHistory<Model, State, Command>;

  [[nodiscard]] double axis_at(const History::Moment& m, std::size_t axis, BenchTime t,
                               double* rate) const noexcept;
  [[nodiscard]] PlatformMotion motion_of(const History::Moment& m, BenchTime t) const noexcept;
  [[nodiscard]] Eigen::Isometry3d head_of(const PlatformMotion& m) const noexcept;
  void advance(BenchTime t) override { history_.advance(t); }
  [[nodiscard]] double value(std::size_t signal) override;
  [[nodiscard]] bool take(std::size_t signal, double value) override;
  void fell(BenchTime t);

  Model model_;
  PlatformStart begin_;
  mutable History history_;  // written under the mutex, as what follows
  FellingLog log_;
  Cut last_cut_;
};

}  // namespace rigor
