#include "bridges/ros2/outgoing.h"

#include <fmt/format.h>
#include <fnmatch.h>

#include <algorithm>

#include "bridges/ros2/names.h"

namespace rigor::ros2 {
namespace {

/// Of all reliable topics together, after the last message of a run.
constexpr Duration kMostDrain = milliseconds(1000);

/// ROS 2 gives topics that say once how things are (`/tf_static`) to those who come later, too; a recording
/// says so of a topic as rosbag2 does.
bool is_latched(const record::ChannelOptions& channel) {
  if (channel.topic == "/tf_static" || channel.topic.ends_with("/tf_static")) return true;
  const auto at = channel.metadata.find("offered_qos_profiles");
  return at != channel.metadata.end() && (at->second.find("durability: 1") != std::string::npos ||
                                          at->second.find("transient_local") != std::string::npos);
}

/// Topics that ROS 2 has once for all nodes, whatever their namespace.
bool is_global(const std::string& topic) {
  return topic == "/tf" || topic == "/tf_static" || topic == "/clock" || topic == "/diagnostics";
}

const char* offered(const std::string& policy, const std::string& qos) {
  const bool best_effort = qos.starts_with("sensor_data");
  if (policy == "RELIABILITY" && best_effort) return "best effort";
  if (policy == "DURABILITY") return "volatile";
  return nullptr;
}

}  // namespace

// ------------------------------------------------------------------ topics

void Outgoing::Topics::add(std::unique_ptr<Topic> topic) {
  const std::lock_guard lock(mutex_);
  topics_.push_back(std::move(topic));
}

std::vector<BridgeReport::Topic> Outgoing::Topics::report_locked() const {
  std::vector<BridgeReport::Topic> all;
  for (const auto& t : topics_) {
    BridgeReport::Topic r;
    r.topic = t->name;
    r.type = t->type;
    r.qos = t->qos;
    r.messages = t->messages.load(std::memory_order_relaxed);
    r.accepted = t->accepted.load(std::memory_order_relaxed);
    r.dropped = t->dropped.load(std::memory_order_relaxed);
    r.peers = t->writer->peers();
    all.push_back(std::move(r));
  }
  return all;
}

std::vector<BridgeReport::Topic> Outgoing::Topics::report() const {
  const std::lock_guard lock(mutex_);
  return is_closed_ ? closed_ : report_locked();
}

std::vector<std::string> Outgoing::Topics::problems_locked() const {
  std::vector<std::string> all;
  for (const auto& t : topics_) {
    const Mismatch m = t->writer->mismatch();
    if (m.count == 0) continue;
    const char* what = offered(m.policy, t->qos);
    std::string cure;
    if (m.policy == "RELIABILITY")
      cure =
          fmt::format("set `topics: {{ {}: {{ qos: reliable }} }}`, or let it ask for best effort", t->name);
    else if (m.policy == "DURABILITY")
      cure = fmt::format("set `topics: {{ {}: {{ qos: transient_local }} }}`, or let it ask for volatile",
                         t->name);
    all.push_back(fmt::format("{}: {} of {} subscribers asked for another {} than it offers ({}){}{}",
                              t->name, m.count, m.count + t->writer->peers(),
                              m.policy.empty() ? "quality of service" : m.policy,
                              what ? what : t->qos.c_str(), cure.empty() ? "" : "; ", cure));
  }
  return all;
}

std::vector<std::string> Outgoing::Topics::problems() const {
  const std::lock_guard lock(mutex_);
  return is_closed_ ? closed_problems_ : problems_locked();
}

std::optional<std::uint32_t> Outgoing::Topics::peers(const std::string& name) const {
  const std::lock_guard lock(mutex_);
  for (const auto& t : topics_)
    if (t->name == name) return t->writer->peers();
  return std::nullopt;
}

std::vector<std::string> Outgoing::Topics::names() const {
  const std::lock_guard lock(mutex_);
  std::vector<std::string> all;
  for (const auto& t : topics_) all.push_back(t->name);
  return all;
}

void Outgoing::Topics::close() {
  const std::lock_guard lock(mutex_);
  if (is_closed_) return;
  closed_ = report_locked();
  closed_problems_ = problems_locked();
  is_closed_ = true;
  topics_.clear();
}

// ------------------------------------------------------------------ writer

Outgoing::Outgoing(std::shared_ptr<Participant> participant, OutgoingSettings settings, bool virtual_time,
                   std::shared_ptr<Topics> topics)
    : participant_(std::move(participant)),
      settings_(std::move(settings)),
      virtual_time_(virtual_time),
      topics_(std::move(topics)) {}

Result<std::uint16_t> Outgoing::add_schema(const std::string& name, const std::string&,
                                           const std::string& text) {
  schemas_.push_back({name, text});
  return static_cast<std::uint16_t>(schemas_.size());  // 0: none
}

Result<std::uint16_t> Outgoing::add_channel(const record::ChannelOptions& channel) {
  if (channels_.empty()) channels_.push_back(nullptr);  // 0 is no topic
  const auto id = static_cast<std::uint16_t>(channels_.size());
  if (channel.schema == 0 || channel.schema > schemas_.size())
    return fail(ErrorCode::internal, channel.topic, "expected a topic with a type, got none");
  Qos qos = settings_.qos;
  bool send = true;
  if (is_latched(channel)) qos = {Qos::Profile::transient_local, 0};
  for (const TopicRule& rule : settings_.rules) {
    if (fnmatch(rule.pattern.c_str(), channel.topic.c_str(), 0) != 0) continue;
    send = rule.send;
    if (rule.qos) qos = *rule.qos;
  }
  if (!send) {
    channels_.push_back(nullptr);
    return id;
  }
  auto topic = std::make_unique<Topic>();
  topic->name = ros_topic((is_global(channel.topic) ? "" : settings_.prefix) + channel.topic);
  if (topics_->peers(topic->name))
    return fail(ErrorCode::bad_input, topic->name,
                "expected each topic of the run to have a name of its own on ROS 2, where `-` is `_`, got it "
                "twice; rename a channel");
  const MessageType& type = schemas_[channel.schema - 1u];
  topic->type = full_type(type.name);
  topic->qos = name_of(qos);
  auto writer = participant_->write(topic->name, type, qos);
  if (!writer) return tl::unexpected<Error>(writer.error());
  topic->writer = std::move(*writer);
  channels_.push_back(topic.get());
  topics_->add(std::move(topic));
  return id;
}

Status Outgoing::write(const record::MessageInfo& message, record::Pieces pieces) {
  return write_sample(message, pieces, {});
}

Status Outgoing::write_sample(const record::MessageInfo& message, record::Pieces pieces,
                              const SampleLease& sample) {
  if (message.channel >= channels_.size())
    return fail(ErrorCode::internal, "ros2", "a message is of a topic that was not added");
  Topic* topic = channels_[message.channel];
  if (!topic) return {};
  topic->messages.fetch_add(1, std::memory_order_relaxed);
  const bool may_borrow = !virtual_time_ && topic->borrowed->load(std::memory_order_acquire) < kMostBorrowed;
  const bool sent = topic->writer->send(
      make_message(topic->writer->type(), pieces, may_borrow ? sample : SampleLease{}, topic->borrowed));
  (sent ? topic->accepted : topic->dropped).fetch_add(1, std::memory_order_relaxed);
  ++statistics_.messages;
  if (sent)
    for (const auto& piece : pieces) statistics_.file_bytes += piece.size();
  return {};
}

Status Outgoing::close() {
  const MonotonicTime until = monotonic_now() + kMostDrain;
  for (Topic* topic : channels_)
    if (topic && topic->writer->peers() > 0)
      topic->writer->drain(std::max(Duration(0), until - monotonic_now()));
  channels_.clear();
  participant_.reset();
  return {};
}

}  // namespace rigor::ros2
