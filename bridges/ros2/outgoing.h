// What leaves a run: each topic of its recording as a topic of ROS 2. The thread of a Recorder calls it.
//
// A message that DDS does not take, because a peer that acknowledges is behind, is dropped and counted; of
// each topic messages = accepted + dropped, exactly. Pictures and clouds are borrowed from their slots for as
// long as DDS needs them, by at most kMostBorrowed messages of a topic, and copied beyond that. In virtual
// time all is copied: which slots of a channel are free must not depend on a peer.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "bridges/ros2/participant.h"
#include "bridges/ros2/payload.h"
#include "sensor-hal/channel/bridge.h"
#include "sensor-hal/record/message_writer.h"

namespace rigor::ros2 {

/// `topics: { /left/*: { qos: sensor_data } }`: what holds for the topics that a pattern names.
struct TopicRule {
  std::string pattern;  ///< as fnmatch has it; `*` also stands for slashes
  bool send = true;
  std::optional<Qos> qos;  ///< none: as its channel and the bridge say
};

struct OutgoingSettings {
  std::string prefix;  ///< before each topic: `/rig1`, or empty
  Qos qos;             ///< where no rule says another
  std::vector<TopicRule> rules;
};

/// The topics of one run.
class Outgoing final : public record::MessageWriter {
 public:
  static constexpr std::uint32_t kMostBorrowed = 2;

  /// State that outlives the writer, for reports.
  struct Topic {
    std::string name, type, qos;
    std::unique_ptr<Writer> writer;
    Borrowed borrowed = std::make_shared<std::atomic<std::uint32_t>>(0);
    std::atomic<std::uint64_t> messages{0}, accepted{0}, dropped{0};
  };
  class Topics {
   public:
    void add(std::unique_ptr<Topic> topic);
    [[nodiscard]] std::vector<BridgeReport::Topic> report() const;
    /// One sentence for each topic with a peer that cannot be matched.
    [[nodiscard]] std::vector<std::string> problems() const;
    /// Peers of a topic by its name; none: there is no such topic.
    [[nodiscard]] std::optional<std::uint32_t> peers(const std::string& name) const;
    [[nodiscard]] std::vector<std::string> names() const;
    /// Leaves the network and keeps the numbers.
    void close();

   private:
    mutable std::mutex mutex_;
    std::vector<std::unique_ptr<Topic>> topics_;
    std::vector<BridgeReport::Topic> closed_;
    std::vector<std::string> closed_problems_;
    bool is_closed_ = false;
    [[nodiscard]] std::vector<BridgeReport::Topic> report_locked() const;
    [[nodiscard]] std::vector<std::string> problems_locked() const;
  };

  Outgoing(std::shared_ptr<Participant> participant, OutgoingSettings settings, bool virtual_time,
           std::shared_ptr<Topics> topics);

  Result<std::uint16_t> add_schema(const std::string& name, const std::string& encoding,
                                   const std::string& text) override;
  Result<std::uint16_t> add_channel(const record::ChannelOptions& channel) override;
  Status write(const record::MessageInfo& message, record::Pieces pieces) override;
  Status write_sample(const record::MessageInfo& message, record::Pieces pieces,
                      const SampleLease& sample) override;
  Status advance(std::uint64_t) override { return {}; }
  Status add_metadata(const record::Metadata&) override { return {}; }
  Status close() override;
  [[nodiscard]] const record::WriterStatistics& statistics() const override { return statistics_; }

 private:
  std::shared_ptr<Participant> participant_;
  OutgoingSettings settings_;
  bool virtual_time_;
  std::shared_ptr<Topics> topics_;
  std::vector<MessageType> schemas_;
  std::vector<Topic*> channels_;  ///< by id; null: not sent
  record::WriterStatistics statistics_;
};

}  // namespace rigor::ros2
