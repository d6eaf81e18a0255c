// Frames of a recording: what `/tf` and `/tf_static` tell, and which frames headers name.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <set>
#include <string>

#include "sensor-hal/record/ros2_messages.h"

namespace rigor {

class FrameCheck {
 public:
  /// Of different frames, and of frames on a topic; what comes beyond is not judged.
  static constexpr std::size_t kMostFrames = 20'000, kMostOnATopic = 64;
  /// `log_ns`: of the message; `text`: what is wrong.
  using Tell = std::function<void(const std::string& topic, std::uint64_t log_ns, std::string text)>;

  /// A transform that the recording tells of. A child with another parent than before is told at once.
  void transform(const std::string& topic, std::uint64_t log_ns, const record::msg::TransformStamped& t,
                 const Tell& tell);
  /// A frame that the header of a message names.
  void used(const std::string& topic, std::uint64_t log_ns, const std::string& frame);
  /// At the end: cycles, several trees, and headers' frames without a place. Where the recording has no
  /// transforms at all, frames have no place as soon as there are two of them.
  void finish(const Tell& tell) const;

 private:
  struct Place {
    std::string parent, topic;
    std::uint64_t log_ns = 0;
    bool told = false;
  };
  struct Use {
    std::string topic;
    std::uint64_t log_ns = 0;
  };
  /// The frame that has no parent above this one; empty: they go round in a cycle.
  [[nodiscard]] std::string root_of(const std::string& frame) const;

  std::map<std::string, Place> places_;  ///< by child
  std::map<std::string, std::set<std::string>> used_;
  std::map<std::string, std::map<std::string, std::uint64_t>> uses_;  ///< by frame and topic: first log time
};

}  // namespace rigor
