#include "bridges/ros2/ros2_bridge.h"

#include <fmt/format.h>

#include <algorithm>
#include <set>
#include <thread>

#include "bridges/ros2/incoming.h"
#include "bridges/ros2/names.h"
#include "bridges/ros2/outgoing.h"
#include "bridges/ros2/settings.h"
#include "sensor-hal/channel/bridge.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor {
namespace {

using namespace ros2;

class Ros2Bridge final : public Bridge {
 public:
  ~Ros2Bridge() override { close(); }

  Status configure(const ConfigNode& n, const BridgeRig& rig) override {
    domain_ = read_domain(n);
    outgoing_.prefix = n.text_or("namespace", "");
    if (!outgoing_.prefix.empty()) check_topic(n, "namespace", outgoing_.prefix);
    outgoing_.qos = read_qos(n, {Qos::Profile::reliable, 0});
    all_channels_ = !n.has("channels");
    for (const ConfigNode& item : n.list_or_empty("channels")) {
      const std::string name = item.as_text();
      if (std::ranges::find(rig.channels, name) == rig.channels.end())
        throw item.error("",
                         fmt::format("expected a channel of the rig, one of {}, got \"{}\"{}",
                                     joined_or_none(rig.channels), name, did_you_mean(name, rig.channels)));
      channels_.insert(name);
    }
    if (const ConfigNode topics = n.map_or_absent("topics"); topics.present())
      for (const std::string& pattern : topics.keys()) {
        const ConfigNode t = topics.map(pattern);
        TopicRule rule{pattern, t.flag_or("send", true), {}};
        if (t.has("qos") || t.has("depth")) rule.qos = read_qos(t, outgoing_.qos);
        (void)read_qos(t, outgoing_.qos);
        t.finish();
        outgoing_.rules.push_back(std::move(rule));
      }
    std::vector<CommandSettings> commands;
    if (const ConfigNode map = n.map_or_absent("commands"); map.present())
      for (const std::string& topic : map.keys())
        commands.push_back(read_command(map.map(topic), topic, rig));
    for (const ConfigNode& item : n.list_or_empty("wait_for")) {
      check_topic(item, "", item.as_text());
      wait_for_.push_back({item.as_text(), item.place()});
    }
    wait_ = seconds_from(n.number_or("wait_s", 30, {.min = 0, .max = 1e6}));
    incoming_ = std::make_unique<Incoming>(std::move(commands));
    return {};
  }

  bool wants_channel(const std::string& name) const override {
    return all_channels_ || channels_.contains(name);
  }

  Result<std::unique_ptr<record::MessageWriter>> open(bool virtual_time) override {
    auto participant = Participant::open(domain_);
    if (!participant) return tl::unexpected<Error>(participant.error());
    participant_ = std::move(*participant);
    if (auto s = incoming_->open(participant_); !s) return tl::unexpected<Error>(s.error());
    return std::make_unique<Outgoing>(participant_, outgoing_, virtual_time, topics_);
  }

  Status wait_for_peers(StopToken stop) override {
    const MonotonicTime until = monotonic_now() + wait_;
    for (const Awaited& awaited : wait_for_) {
      while (true) {
        auto peers = topics_->peers(awaited.topic);
        if (!peers) peers = incoming_->peers(awaited.topic);
        if (!peers) {
          const auto names = topics_->names();
          return fail(ErrorCode::bad_input, awaited.place,
                      fmt::format("expected a topic of this bridge, one of {}, got \"{}\"{}",
                                  joined_or_none(names), awaited.topic, did_you_mean(awaited.topic, names)));
        }
        if (*peers > 0) break;
        if (stop.stop_requested())
          return fail(ErrorCode::unavailable, awaited.place,
                      "interrupted while the run waited for a peer of " + awaited.topic);
        if (monotonic_now() >= until) {
          std::string why;
          for (const std::string& p : problems()) why += "; " + p;
          return fail(ErrorCode::timeout, awaited.place,
                      fmt::format("expected a peer of {} within {:g} s, got none{}", awaited.topic,
                                  wait_.seconds(), why));
        }
        std::this_thread::sleep_for(std::chrono::milliseconds(2));
      }
    }
    // A peer learns of this side when it does, and nothing tells when it has.
    if (!wait_for_.empty()) std::this_thread::sleep_for(std::chrono::milliseconds(100));
    return {};
  }

  bool poll(BenchTime now, BridgeCommand& command) noexcept override { return incoming_->poll(now, command); }

  void close() override {
    if (!participant_) return;
    other_types_ = problems_of_types();
    incoming_->close();
    topics_->close();
    participant_.reset();
  }

  BridgeReport report() const override {
    BridgeReport r;
    r.topics = topics_->report();
    r.commands = incoming_->report();
    r.problems = problems();
    return r;
  }

 private:
  struct Awaited {
    std::string topic, place;
  };
  std::vector<std::string> problems_of_types() const {
    if (participant_)
      for (const OtherType& o : participant_->other_types())
        other_types_.push_back(
            fmt::format("{}: a {} takes it for {}, here it is {}: the topic is inconsistent, and the two do "
                        "not meet; use "
                        "another topic or type",
                        o.topic, o.they_write ? "publisher" : "subscriber", o.theirs, o.ours));
    return other_types_;
  }
  std::vector<std::string> problems() const {
    const std::lock_guard lock(mutex_);
    std::vector<std::string> all = topics_->problems();
    for (std::string& p : incoming_->problems()) all.push_back(std::move(p));
    for (const std::string& p : problems_of_types()) all.push_back(p);
    return all;
  }

  DomainSettings domain_;
  OutgoingSettings outgoing_;
  bool all_channels_ = true;
  std::set<std::string> channels_;
  std::vector<Awaited> wait_for_;
  Duration wait_;
  std::shared_ptr<Participant> participant_;
  std::unique_ptr<Incoming> incoming_ = std::make_unique<Incoming>(std::vector<CommandSettings>{});
  std::shared_ptr<Outgoing::Topics> topics_ = std::make_shared<Outgoing::Topics>();
  mutable std::mutex mutex_;
  mutable std::vector<std::string> other_types_;
};

}  // namespace

NamedBridge ros2_bridge() {
  return {"ros2", "channels as topics of ROS 2 over DDS, and commands of ROS 2 nodes",
          [] { return std::make_unique<Ros2Bridge>(); }};
}

}  // namespace rigor
