// What carries the sensors: a vehicle on the ground, a body on a path. Its own truth in one process: commands
// go in as signals or registers, where it is comes out as a BodyState and joints, and parts say how it looks.
//
// Frame: x forward, y left, z up; the origin lies on the ground under the middle of the wheels. Joints are
// counted within the platform; in a WorldMotion they follow the world's own.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "sensor-hal/channel/providers.h"
#include "sim/platform/felling_log.h"

namespace rigor {

/// Where a platform stands at an instant.
struct PlatformMotion {
  static constexpr std::size_t kMaxJoints = 12;
  BodyState body;
  std::uint32_t joint_count = 0;
  std::array<JointState, kMaxJoints> joint{};
};

/// A thing that is seen or that sensors are fixed to, moving with a joint of the platform or with its parent.
struct PlatformPart {
  enum class Shape : std::uint8_t { none, box, cylinder };
  enum class Moves : std::uint8_t { fixed, turns, slides };
  std::string name;                                                 ///< the node is called `platform.name`
  int parent = -1;                                                  ///< an earlier part; -1: the body
  Eigen::Isometry3d T_parent_part = Eigen::Isometry3d::Identity();  ///< with its joint at zero
  Shape shape = Shape::none;
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();  ///< cylinder: diameter, diameter, length, about z
  std::array<double, 6> reflectance{0.2, 0.2, 0.2, 0.2, 0.2, 0.2};
  Moves moves = Moves::fixed;
  int joint = -1;
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();  ///< of the joint, in the part's own frame
};

/// Setup, signals and registers: any thread, one at a time is kept by a lock. `motion_at`: any thread,
/// without a lock, no allocation; the same answer for the same instant whatever else was asked, as long as
/// the platform has been told all that takes effect until then.
class Platform : public SignalModel, public RegisterModel {
 public:
  using RegisterModel::read;
  using RegisterModel::write;
  using SignalModel::read;
  using SignalModel::write;
  /// From this instant on it moves; before it, and before this call, it stands at its start. Forgets what it
  /// was told.
  virtual void start(BenchTime t0) = 0;
  [[nodiscard]] virtual PlatformMotion motion_at(BenchTime t) const noexcept = 0;
  [[nodiscard]] virtual const std::vector<std::string>& joint_names() const = 0;
  /// What it looks like, parents before their children.
  [[nodiscard]] virtual std::vector<PlatformPart> parts() const = 0;
  /// What it cut since the start, in order. Any thread, without a lock.
  [[nodiscard]] virtual std::span<const Felling> fellings() const noexcept { return {}; }
  /// Of a platform that somebody else moves and that stands for it here: it is told to have cut what stands
  /// at a place, from `t` on. False: nothing stands there, or it does not cut. One thread at a time; no
  /// allocation.
  virtual bool apply_felling(double /*x_m*/, double /*y_m*/, double /*yaw_rad*/, BenchTime /*t*/) noexcept {
    return false;
  }
};

}  // namespace rigor
