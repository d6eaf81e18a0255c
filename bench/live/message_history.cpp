#include "bench/live/message_history.h"

namespace rigor::live {
namespace {

constexpr std::uint64_t kBack_ns = 1'000'000'000;

}  // namespace

void MessageHistory::keep(std::uint32_t channel, Keep how) {
  const std::lock_guard lock(mutex_);
  topics_[channel].how = how;
}

bool MessageHistory::keeps(std::uint32_t channel) const {
  const std::lock_guard lock(mutex_);
  return topics_.contains(channel);
}

void MessageHistory::add(std::uint32_t channel, std::uint64_t time_ns, const Bytes& message) {
  if (!message || message->size() > kLongest) return;
  const std::lock_guard lock(mutex_);
  const auto found = topics_.find(channel);
  if (found == topics_.end()) return;
  Topic& topic = found->second;
  if (!topic.kept.empty() && time_ns + kBack_ns < topic.kept.back().time_ns)
    topic = Topic{topic.how, {}, {}, 0};  // the run was begun anew
  if (topic.how == Keep::newest) {
    topic.kept.push_back({time_ns, message});
    if (topic.kept.size() > kMost) topic.kept.pop_front();
    return;
  }
  if (!topic.kept.empty() && time_ns < topic.kept.back().time_ns + topic.gap_ns) {
    topic.newest = {time_ns, message};
    return;
  }
  topic.newest = {};
  topic.kept.push_back({time_ns, message});
  if (topic.kept.size() < kMost) return;
  for (std::size_t i = 0; i < kMost / 2; ++i) topic.kept[i] = std::move(topic.kept[2 * i]);
  topic.kept.resize(kMost / 2);
  topic.gap_ns = (topic.kept.back().time_ns - topic.kept.front().time_ns) / (kMost / 2 - 1);
}

std::vector<MessageHistory::Kept> MessageHistory::messages(std::uint32_t channel) const {
  const std::lock_guard lock(mutex_);
  const auto found = topics_.find(channel);
  if (found == topics_.end()) return {};
  std::vector<Kept> all(found->second.kept.begin(), found->second.kept.end());
  if (found->second.newest.message) all.push_back(found->second.newest);
  return all;
}

}  // namespace rigor::live
