// A robot with two or more wheels on each side that are driven together and turn it by slipping.
//
// Told are either the speeds v and w or the rates of the wheels of each side; motors follow with ramps,
// limits, a dead band and a time constant, give way uphill, and hold where they are told to stand. The way
// over the ground follows from the rates of the sides by instantaneous centres of rotation: A. Mandow et al.,
// "Experimental kinematics for wheeled skid-steer mobile robots", IROS 2007, eq. 1 to 5, with centres that
// lie symmetrically at ±y and move with the turn rate and the slope:
//
//   V = r·rate·(1 − slip)                         of a side; slip grows uphill, and in events drawn by seed
//   w = (V_right − V_left) / (2·y)                2·y = track · (icr_ratio + icr_ratio_per_radps·|w0|),
//                                                 w0 = (V_right − V_left) / track
//   v = (V_right + V_left) / 2,   v_left = −x·w − sideslip·|v|·sine of the slope to the left
//   x = icr_x − icr_x_per_slope · sine of the slope ahead
//
// Height, roll and pitch come from the ground under the wheels (chassis.h). Where roll or pitch pass the
// limits, or a wheel leaves the terrain, the robot brakes and reports a fault until it is told `enable` 0.
//
// Signals told: left_angle, right_angle [rad], left_rate, right_rate [rad/s] (as encoders see them: the mean
// of a side's wheels), status (bit 0 enabled, 1 moving, 2 limited, 3 fault), fault (0 none, 1 tilted, 2 off
// the ground, 3 battery), battery [%]; and the truth x_m, y_m, z_m [m], roll_deg, pitch_deg, yaw_deg [deg],
// velocity_mps [m/s], yaw_rate_degps [deg/s], which a simulator of a test bench may broadcast and no robot
// knows. Commanded: enable (1 after power-up), v [m/s], w [rad/s], left, right [rad/s]; what was told last,
// v/w or left/right, counts. Registers: signal_registers.h, in steps of 0.001 of the unit (truth: 0.0001).
#pragma once

#include "sensor-hal/models/philox.h"
#include "sim/platform/chassis.h"
#include "sim/platform/platform.h"
#include "sim/platform/signal_platform.h"
#include "sim/platform/step_history.h"

namespace rigor {

struct SkidSteerConfig {
  // Shape.
  double length_m = 1.2, width_m = 0.83, height_m = 0.5;  ///< of the whole robot, for the eye
  double wheel_radius_m = 0.2, wheel_width_m = 0.12;
  double track_m = 0.7, wheelbase_m = 0.55;  ///< between the middles of the wheels
  // Drive.
  double max_speed_mps = 1.2, max_turn_radps = 1.396;
  double acceleration_mps2 = 0.8, braking_mps2 = 1.5;  ///< of a side, at the wheel's rim
  double time_constant_s = 0.1;
  double dead_band_mps = 0.01;   ///< of a side: less than this is none
  double droop_s = 0.05;         ///< m/s given up per m/s² of the slope's pull
  double command_timeout_s = 0;  ///< without a command for so long it stands; 0: never
  double effective_track_m = 0;  ///< by which its controller makes rates of v and w; 0: track · icr_ratio
  // Soil.
  double slip = 0.02, slip_per_slope = 0.3;  ///< along the wheels; on a slope of sine 1
  double icr_ratio = 1.5, icr_ratio_per_radps = 0;
  double icr_x_m = 0, icr_x_per_slope_m = 0.2;
  double sideslip = 0.1;
  // Events: a side slips more for about half a second.
  double slip_events_per_s = 0, slip_event = 0.5;  ///< of each side; greatest extra slip
  // Limits.
  double tip_roll_rad = 0.6, tip_pitch_rad = 0.7;
  // Battery.
  double mass_kg = 77, rolling_resistance = 0.05, efficiency = 0.6, idle_w = 60, battery_wh = 1200;
  Suspension suspension;
  Duration step = milliseconds(2);
};

/// Where a platform begins and what draws its luck.
struct PlatformStart {
  double x_m = 0, y_m = 0, yaw_rad = 0;
  std::uint64_t seed = 1;
  std::string name = "robot";  ///< keys the draws
};

class SkidSteer final : public SignalPlatform {
 public:
  SkidSteer(const SkidSteerConfig& config, const PlatformStart& start, Ground ground);

  void start(BenchTime t0) override;
  [[nodiscard]] PlatformMotion motion_at(BenchTime t) const noexcept override;
  /// left, right: the wheels of each side.
  [[nodiscard]] const std::vector<std::string>& joint_names() const override;
  [[nodiscard]] std::vector<PlatformPart> parts() const override;

 private:
  struct State {
    ChassisState chassis;
    std::array<double, 2> ramp_radps{}, rate_radps{}, angle_rad{};  ///< left, right
    double energy_j = 0;                                            ///< taken from the battery
    std::int32_t fault = 0, trouble = 0;                            ///< fault: what trouble stopped it
    bool limited = false;
  };
  struct Command {
    double v_mps = 0, w_radps = 0;
    std::array<double, 2> rate_radps{};  ///< left, right
    bool rates = false, enable = true;
    std::int64_t k = 0;  ///< when it was told, for the time-out
  };
  /// What StepHistory steps.
  struct Model {
    SkidSteerConfig c;
    Ground ground;
    Footprint wheels;
    models::PhiloxKey key;
    [[nodiscard]] State step(const State& from, const Command& told, std::int64_t k) const noexcept;
    [[nodiscard]] std::array<double, 2> wanted_radps(const Command& told, bool& limited) const noexcept;
    [[nodiscard]] double event_slip(std::int64_t k, std::size_t side) const noexcept;
  };

  void advance(BenchTime t) override { history_.advance(t); }
  [[nodiscard]] double value(std::size_t signal) override;
  [[nodiscard]] bool take(std::size_t signal, double value) override;

  Model model_;
  PlatformStart begin_;
  mutable StepHistory<Model, State, Command> history_;  // written under the mutex
};

}  // namespace rigor
