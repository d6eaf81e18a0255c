// Where the moving parts of the bench's own world stand: as its channels report them, or as the platforms say
// that the bench itself moves.
#pragma once

#include <array>
#include <cstdint>
#include <memory>

#include "bench/motion/platforms.h"
#include "rt-core/fixed_ring.h"
#include "sensor-hal/channel/application.h"
#include "sensor-hal/channel/providers.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

/// Keeps the last reports of each joint's position and of each body's pose. Between two reports it
/// interpolates, so that a simulated side which is rendered after the fact sees them where they were; past
/// the newest it extrapolates with the acceleration that the last reports show. Platforms of this process are
/// asked themselves. All calls: loop thread (simulated sources read it when they dispatch a capture), no
/// allocation.
///
/// A joint's acceleration is the slope of a straight-line fit to its reported rates of 150 ms, where it is
/// significant (estimated_acceleration); a capture that takes time, such as a scan, goes on with it, too.
/// Without reported rates, and while they are constant, it is zero.
class BenchMotion final : public MotionSource {
 public:
  /// Setup: binds joint `index` of the world to a channel's values.
  [[nodiscard]] Status bind(std::size_t index, const JointBinding& binding, const InputPort& input);
  void set_joint_count(std::size_t count) { count_ = static_cast<std::uint32_t>(count); }
  /// Setup: body `index` and its joints are those of a platform that the bench moves. Joints that are bound
  /// are those of their channels.
  void carry(std::size_t index, const WorldPlatform& platform);
  /// Setup: nobody tells where body `index` is; it stands there.
  void stand(std::size_t index, const BodyState& start);
  /// Setup: body `index` is where a channel says: of kind pose, or of kind registers with values x_m, y_m
  /// and, where they are there, z_m, roll_deg, pitch_deg, yaw_deg. Until its first report it stands at
  /// `start`. Around a report velocity and acceleration come from its neighbours; past the newest it
  /// goes on for half a second, for 150 ms of it with the acceleration that the last 150 ms show.
  [[nodiscard]] Status follow(std::size_t index, const std::string& platform, const BodyState& start,
                              const InputPort& input);
  /// Setup: a channel of kind registers tells what the platform of body `index` cuts, with values felled (how
  /// many), felled_x_m, felled_y_m, felled_yaw_deg (where, and where the top of the last one points). `model`
  /// stands for it in the bench's world, and loses its trees from the cycle on in which the bench learns of
  /// it.
  [[nodiscard]] Status follow_fellings(std::size_t index, std::shared_ptr<Platform> model,
                                       const InputPort& input);
  /// Each cycle after the ports advanced: takes up what is fresh.
  void update(BenchTime t_cycle) noexcept;
  [[nodiscard]] WorldMotion motion_at(BenchTime t) const noexcept override;

 private:
  static constexpr std::size_t kHistory = 256;  ///< of a joint: 150 ms at 1 kHz, and as much after an instant
  static constexpr std::size_t kPoses = 64;
  struct Joint {
    const SamplePort* port = nullptr;
    std::size_t position_index = 0, rate_index = 0;
    bool has_rate = false;
    double scale_rad = 1;
    FixedRing<JointState, kHistory> history;
    [[nodiscard]] JointState at(BenchTime t) const noexcept;
    /// By the reports up to number `newest`.
    [[nodiscard]] double acceleration_radps2(std::size_t newest) const noexcept;
  };
  struct Report {
    BenchTime t;
    Pose T_world_body;
  };
  struct Body {
    WorldPlatform platform;  ///< of this process; its model is null where a channel tells
    const SamplePort* port = nullptr;
    std::array<std::size_t, 6> value_index{};  ///< x, y, z, roll, pitch, yaw; kNone: none
    BodyState start;
    FixedRing<Report, kPoses> history;
    std::shared_ptr<Platform> cuts;  ///< null: nobody tells what it cuts
    const SamplePort* cuts_port = nullptr;
    std::array<std::size_t, 4> cuts_index{};  ///< felled, x, y, yaw
    double cuts_known = 0;
    [[nodiscard]] const Report& back(std::size_t n) const noexcept { return history[history.size() - 1 - n]; }
    [[nodiscard]] BodyState at(BenchTime t) const noexcept;
    [[nodiscard]] double velocity_mps(std::size_t later, std::size_t axis) const noexcept;
    [[nodiscard]] double acceleration_mps2(std::size_t axis) const noexcept;
  };
  static constexpr std::size_t kNone = ~std::size_t{0};
  void take_pose(Body& body) noexcept;
  static void take_felling(Body& body, BenchTime t_cycle) noexcept;

  std::array<Joint, WorldMotion::kMax> joints_{};
  std::array<Body, WorldMotion::kMaxBodies> bodies_{};
  std::uint32_t count_ = 0, body_count_ = 0;
};

}  // namespace rigor
