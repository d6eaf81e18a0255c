// The crane of forest-localization at the ports of the bench: which values of which channels and sinks are
// its own, by their names.
//
//   crane:
//     sinks: [crane, head]             # with the values slew_to, boom_to, stick_to [deg], telescope_to [m],
//                                      # rotate_to [deg], grip_to, fell; each in one of them
//     channels: [crane_state, head_state]     # registers with slew, boom, stick [deg], telescope [m], felled
//     foot_m: [3.6, 0, 2.0]            # in the base's frame
//     boom_m: 4.2
//     stick_m: 3.6
//     head_m: 0.9
//     slew_deg: [-110, 110]            # end stops
//     boom_deg: [-10, 78]
//     stick_deg: [-138, -10]
//     telescope_m: [0, 2.4]
//     rest: { slew_deg: 0, boom_deg: 60, stick_deg: -130, telescope_m: 0 }
//     cut_height_m: 0.4
//     best_slew_deg: 50                # to either side: where it stops for a stem
//     hide_m: 0.6                      # scanners' points nearer than this to boom and stick, seen from above
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "apps/forest-localization/crane.h"
#include "apps/forest-localization/level_scan.h"
#include "sensor-hal/channel/application.h"

namespace rigor::forest {

class CranePorts {
 public:
  /// Setup context. Throws ConfigError with its place.
  CranePorts(const ConfigNode& n, const ApplicationPorts& ports);

  // Loop thread; no allocation.
  /// Takes up what the crane tells and tells it what it shall do.
  void step(BenchTime now) noexcept;
  bool begin(double x_m, double y_m, BenchTime now) noexcept;
  /// How far off its best bearing a place in the base's frame is; infinite where it does not reach.
  [[nodiscard]] double cost(double x_m, double y_m) const noexcept;
  /// Above which ground boom and stick hang; none before the crane has told.
  [[nodiscard]] std::optional<IgnoredStrip> strip() const noexcept;
  [[nodiscard]] const CraneWork& work() const noexcept { return work_; }

 private:
  static constexpr std::size_t kTold = 5, kCommanded = 7;
  struct Value {
    const SamplePort* port = nullptr;
    std::size_t index = 0;
  };
  struct Output {
    CommandPort* port = nullptr;
    std::array<std::size_t, 16> value{};  ///< which of the commanded ones
    std::size_t count = 0;
  };
  static CraneWorkConfig read(const ConfigNode& n);
  void find(const ConfigNode& n, const ApplicationPorts& ports);
  void listen() noexcept;

  CraneWork work_;
  double best_slew_rad_ = 0, hide_m_ = 0;
  std::array<Value, kTold> sources_{};
  std::vector<Output> outputs_;
  CraneTold now_;
  unsigned known_ = 0;  ///< a bit for each value that was told
};

}  // namespace rigor::forest
