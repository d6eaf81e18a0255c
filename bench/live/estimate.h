// How far the application's estimate of its pose is from the truth, while the run goes on: what the analysis
// `localization` of the rig finds in the recording afterwards, by the same channel and the same sink.
#pragma once

#include <cstddef>
#include <deque>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <vector>

#include "bench/motion/pose_error.h"
#include "bench/run/bench_run.h"

namespace rigor::live {

/// Setup context constructs, the server's thread calls.
class LiveEstimate {
 public:
  /// Empty: the rig does not ask for that analysis, or the two are of other kinds.
  [[nodiscard]] static std::optional<LiveEstimate> of(const RunParts& parts);

  /// Of the tap: 2·channel.
  [[nodiscard]] std::size_t truth_stream() const { return 2 * channel_; }
  void truth(const Sample& sample);
  void told(std::uint32_t sink, const Command& command);

  struct At {
    BenchTime t;
    double x_m = 0, y_m = 0;           ///< the truth
    double along_m = 0, across_m = 0;  ///< estimate less truth, forward and to the left by the true yaw
    double yaw_rad = 0;                ///< NaN: not told
    double sigma_m = 0;                ///< √((σx² + σy²)/2) as told; NaN: not told
  };
  /// The next one whose truth is known; estimates without a truth within 0.1 s are left out.
  [[nodiscard]] std::optional<At> next();

 private:
  struct Told {
    PlanePose pose;
    double sigma_m = 0;
  };
  std::size_t channel_ = 0;
  std::uint32_t sink_ = 0;
  std::optional<std::size_t> x_, y_, yaw_deg_;                                  // of the truth's registers
  std::optional<std::size_t> to_x_, to_y_, to_yaw_, to_sx_, to_sy_, to_state_;  // of the sink's values
  std::vector<PlanePose> truth_;
  std::deque<Told> estimates_;
};

}  // namespace rigor::live
