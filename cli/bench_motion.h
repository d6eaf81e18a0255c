// Where the moving parts of the bench's own world stand, as its channels report them.
#pragma once

#include <array>
#include <cstdint>

#include "sensor-hal/channel/application.h"
#include "sensor-hal/channel/providers.h"
#include "sensor-hal/config/rig.h"

namespace rigor {

/// Keeps the last reports of each joint's position. Between two reports it interpolates, so that a twin which
/// is rendered after the fact sees the joint where it was; past the newest it extrapolates with the reported
/// rate. All calls: loop thread (simulated sources read it when they dispatch a capture), no allocation.
class BenchMotion final : public MotionSource {
 public:
  /// Setup: binds joint `index` of the world to a channel's values.
  [[nodiscard]] Status bind(std::size_t index, const JointBinding& binding, const InputPort& input);
  void set_joint_count(std::size_t count) { count_ = static_cast<std::uint32_t>(count); }
  /// Each cycle after the ports advanced: takes up what is fresh.
  void update() noexcept;
  [[nodiscard]] WorldMotion motion_at(BenchTime t) const noexcept override;

 private:
  static constexpr std::size_t kHistory = 64;
  struct Joint {
    const SamplePort* port = nullptr;
    std::size_t position_index = 0, rate_index = 0;
    bool has_rate = false;
    double scale_rad = 1;
    std::array<JointState, kHistory> history{};
    std::size_t size = 0, newest = 0;
  };
  std::array<Joint, WorldMotion::kMax> joints_{};
  std::uint32_t count_ = 0;
};

}  // namespace rigor
