#include "bench/analysis/frame_check.h"

#include <fmt/format.h>

#include <algorithm>

namespace rigor {
namespace {

/// Names come from the file: they are shown cut short.
std::string shown(const std::string& frame) {
  return frame.size() <= 60 ? frame : frame.substr(0, 57) + "...";
}

}  // namespace

void FrameCheck::transform(const std::string& topic, std::uint64_t log_ns,
                           const record::msg::TransformStamped& t, const Tell& tell) {
  if (t.child_frame_id.empty() || t.header.frame_id.empty() || t.child_frame_id == t.header.frame_id)
    return tell(topic, log_ns,
                fmt::format("expected a transform from one named frame to another, got \"{}\" in \"{}\"",
                            shown(t.child_frame_id), shown(t.header.frame_id)));
  const auto at = places_.find(t.child_frame_id);
  if (at == places_.end()) {
    if (places_.size() < kMostFrames) places_[t.child_frame_id] = {t.header.frame_id, topic, log_ns, false};
    return;
  }
  if (at->second.parent == t.header.frame_id || at->second.told) return;
  at->second.told = true;  // who tells it goes on telling it
  tell(topic, log_ns,
       fmt::format("the frame {} has two parents, {} and {}: a tree has one", shown(t.child_frame_id),
                   shown(at->second.parent), shown(t.header.frame_id)));
}

void FrameCheck::used(const std::string& topic, std::uint64_t log_ns, const std::string& frame) {
  std::set<std::string>& on_topic = used_[topic];
  if (on_topic.contains(frame) || on_topic.size() >= kMostOnATopic) return;
  on_topic.insert(frame);
  if (uses_.size() < kMostFrames || uses_.contains(frame)) uses_[frame].emplace(topic, log_ns);
}

std::string FrameCheck::root_of(const std::string& frame) const {
  std::string at = frame;
  for (std::size_t steps = 0; steps <= places_.size(); ++steps) {
    const auto place = places_.find(at);
    if (place == places_.end()) return at;
    at = place->second.parent;
  }
  return {};
}

void FrameCheck::finish(const Tell& tell) const {
  std::map<std::string, std::size_t> roots;  // how many frames hang on each
  bool cycle_told = false;
  for (const auto& [child, place] : places_) {
    const std::string root = root_of(child);
    if (!root.empty()) {
      ++roots[root];
    } else if (!cycle_told) {
      cycle_told = true;
      tell(place.topic, place.log_ns, fmt::format("the frame {} is its own ancestor", shown(child)));
    }
  }
  const auto largest = std::max_element(roots.begin(), roots.end(),
                                        [](const auto& a, const auto& b) { return a.second < b.second; });
  for (const auto& [frame, topics] : uses_)
    for (const auto& [topic, log_ns] : topics) {
      if (frame.empty()) {
        tell(topic, log_ns, "its headers name no frame");
      } else if (places_.empty()) {
        if (uses_.size() > 1)
          tell(topic, log_ns,
               fmt::format("the frame {} has no place: the recording has neither /tf nor /tf_static, and {} "
                           "frames",
                           shown(frame), uses_.size()));
      } else if (const std::string root = root_of(frame); root == frame && !roots.contains(frame)) {
        tell(topic, log_ns,
             fmt::format("the frame {} is not in the tree of /tf and /tf_static", shown(frame)));
      } else if (largest != roots.end() && root != largest->first && !root.empty()) {
        tell(topic, log_ns,
             fmt::format("the frame {} is in the tree of {}, most others are in that of {}", shown(frame),
                         shown(root), shown(largest->first)));
      }
    }
}

}  // namespace rigor
