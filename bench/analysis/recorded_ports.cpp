#include "bench/analysis/recorded_ports.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <deque>
#include <optional>
#include <utility>

#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/recorder.h"
#include "sensor-hal/record/replay_sink.h"
#include "sensor-hal/record/ros2_messages.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor {
namespace {

namespace msg = record::msg;

constexpr Duration kLongestRun = seconds(10'000'000);

/// A message of one type, read one ahead.
template <class M>
class Messages {
 public:
  Messages(record::McapReader& reader, const char* topic)
      : cursor_(reader.messages({.topics = {topic}, .order = record::MessageOrder::file})) {}
  /// Null: there is none left.
  [[nodiscard]] Result<const M*> peek() {
    if (!has_) {
      record::MessageView view;
      const auto more = cursor_.next(view);
      if (!more) return tl::unexpected<Error>(more.error());
      if (!*more) return nullptr;
      if (auto s = record::CdrReader::read(view.data, message_); !s) return tl::unexpected<Error>(s.error());
      has_ = true;
    }
    return &message_;
  }
  void drop() { has_ = false; }

 private:
  record::MessageCursor cursor_;
  M message_;
  bool has_ = false;
};

/// The samples of one topic, in the order of the file, one ahead.
class Samples {
 public:
  Samples(record::McapReader& reader, std::string topic, SamplePool& pool)
      : decoder_(topic), cursor_(reader.messages(filter(topic))), pool_(&pool) {}

  /// Empty: there is none left.
  [[nodiscard]] Result<const SampleLease*> peek() {
    while (!ahead_) {
      record::MessageView view;
      const auto more = cursor_.next(view);
      if (!more) return tl::unexpected<Error>(more.error());
      if (!*more) break;
      const auto whole = decoder_.take(view);
      if (!whole) return tl::unexpected<Error>(whole.error());
      if (!*whole) continue;
      SampleSlot slot = pool_->try_acquire();
      if (!slot) return fail(ErrorCode::internal, "recording", "more samples wait than a port holds");
      Sample& sample = *slot;
      sample.info = std::monostate{};
      sample.size_bytes = 0;
      if (decoder_.size_bytes() == 0)
        if (auto s = decoder_.fill(sample); !s) return tl::unexpected<Error>(s.error());
      sample.stamp = decoder_.stamp();
      ahead_ = std::move(slot);
    }
    return &ahead_;
  }
  [[nodiscard]] SampleLease take() { return std::move(ahead_); }

 private:
  static record::MessageFilter filter(const std::string& topic) {
    record::MessageFilter f;
    f.topics.insert(topic);
    for (const std::string_view companion : record::kCompanionTopics)
      f.topics.insert(topic + std::string(companion));
    f.order = record::MessageOrder::file;
    return f;
  }
  record::SampleDecoder decoder_;
  record::MessageCursor cursor_;
  SamplePool* pool_;
  SampleLease ahead_;
};

}  // namespace

struct RecordedPorts::Impl {
  /// One fewer than a port holds, so that the visible one always finds its place.
  static constexpr std::size_t kOvertaken = SamplePort::kPending - 1;

  struct Channel {
    const ChannelEntry* entry = nullptr;
    ChannelDescription description;
    std::unique_ptr<SamplePool> pool;
    SamplePort port;
    std::array<std::optional<Samples>, 2> sides;  ///< of what is no pair the first alone
    std::size_t side = 0;                         ///< from which the last visible sample came
    PortStatus status = PortStatus::never;
    std::uint64_t sequence = 0;
  };
  struct Out {
    const SinkEntry* entry = nullptr;
    std::unique_ptr<ReplaySink> sink;
    std::unique_ptr<CommandPort> port;
  };

  Impl(std::unique_ptr<record::McapReader> file, const RigConfig& rig_in, const RecordedRun& run_in)
      : reader(std::move(file)),
        rig(rig_in),
        run(run_in),
        visibility(*reader, "/rigor/visibility"),
        told(*reader, "/rigor/commands") {}

  std::unique_ptr<record::McapReader> reader;
  const RigConfig& rig;
  RecordedRun run;
  std::vector<std::unique_ptr<Channel>> channels;
  std::vector<Out> sinks;
  ApplicationPorts ports;
  Messages<msg::PortVisibility> visibility;
  Messages<msg::Command> told;
  std::vector<Given> given;
  std::uint64_t next_cycle = 0, last_known = 0, ran = 0, skipped = 0, missing = 0;
  BenchTime t;

  [[nodiscard]] bool has_topic(const std::string& topic) const {
    return std::ranges::any_of(reader->channels(), [&](const auto& c) { return c.second.topic == topic; });
  }

  Status add(const ChannelEntry& entry) {
    auto channel = std::make_unique<Channel>();
    Channel& c = *channel;
    c.entry = &entry;
    c.description.kind = entry.kind;
    c.pool = make_sample_pool(kOvertaken + 5, 0);  // beside these: the visible one, one ahead of each side
    c.port.configure(entry.timing, run.t0);
    const std::string kind(record::topic_of(entry.kind));
    bool any = false;
    for (std::size_t side = 0; side < 2; ++side) {
      const std::string topic = "/" + entry.name +
                                (!entry.is_pair ? "/"
                                 : side == 0    ? "/real/"
                                                : "/simulated/") +
                                kind;
      if ((side == 1 && !entry.is_pair) || !has_topic(topic)) continue;
      any = true;
      c.sides[side].emplace(*reader, topic, *c.pool);
      if (entry.kind != SampleKind::register_block || !c.description.names.empty()) continue;
      Messages<msg::RegisterBlock> blocks(*reader, topic.c_str());
      const auto first = blocks.peek();
      if (!first) return tl::unexpected<Error>(first.error());
      if (*first) c.description.names = (*first)->names, c.description.units = (*first)->units;
    }
    if (!any) return {};  // it is not in this recording
    ports.inputs[entry.name] = {entry.name, &c.description, &c.port};
    channels.push_back(std::move(channel));
    return {};
  }

  Status add(const SinkEntry& entry) {
    Out out;
    out.entry = &entry;
    out.sink = std::make_unique<ReplaySink>(entry.sink.params);
    ChannelConfig config;
    config.name = entry.name;
    if (auto s = out.sink->configure(config); !s) return s;
    out.port = std::make_unique<CommandPort>(entry.name, *out.sink, entry.latency);
    ports.outputs[entry.name] = out.port.get();
    sinks.push_back(std::move(out));
    return {};
  }

  Status show(Channel& c, const msg::PortEntry& entry) {
    if (entry.status > static_cast<std::uint8_t>(PortStatus::disconnected))
      return fail(ErrorCode::protocol, reader->name(),
                  "a port's status is unknown; the recording is of a newer version");
    c.status = static_cast<PortStatus>(entry.status);
    c.sequence = entry.sequence;
    if (c.status != PortStatus::fresh) return {};
    const std::size_t before = std::exchange(c.side, entry.channel.ends_with("/simulated") ? 1 : 0);
    std::deque<SampleLease> come;  // what was overtaken, and the visible one
    std::optional<Samples>& samples = c.sides[c.side];
    bool found = false;
    while (samples && !found) {
      const auto ahead = samples->peek();
      if (!ahead) return tl::unexpected<Error>(ahead.error());
      if (!**ahead || (**ahead)->stamp.sequence > entry.sequence) break;
      SampleLease sample = samples->take();
      found = sample->stamp.sequence == entry.sequence;
      // What came before the run was not shown, nor what a pair's other side gave meanwhile.
      const bool shown = found || (before == c.side && sample->stamp.t_capture >= run.t0 - c.entry->period);
      if (shown) come.push_back(std::move(sample));
      if (come.size() > kOvertaken + 1) come.pop_front();
    }
    if (!found) {
      ++missing;
      SampleSlot stamp_alone = c.pool->try_acquire();
      if (!stamp_alone) return fail(ErrorCode::internal, "recording", "more samples wait than a port holds");
      Sample& sample = *stamp_alone;
      sample.info = std::monostate{};
      sample.size_bytes = 0;
      sample.stamp = {.sequence = entry.sequence,
                      .t_capture = BenchTime(entry.t_capture_ns),
                      .t_release = BenchTime(entry.t_release_ns),
                      .t_arrival = BenchTime(entry.t_arrival_ns)};
      if (come.size() > kOvertaken) come.pop_front();
      come.push_back(std::move(stamp_alone));
    }
    for (SampleLease& sample : come) c.port.push(std::move(sample));
    return {};
  }

  /// What the recording says of this cycle. `next_cycle` goes past what the loop skipped.
  Status take_visibility() {
    while (true) {
      const auto message = visibility.peek();
      if (!message) return tl::unexpected<Error>(message.error());
      if (!*message || (*message)->cycle > next_cycle) return {};
      const msg::PortVisibility& m = **message;
      last_known = std::max(last_known, m.cycle);
      for (const msg::PortEntry& entry : m.entries) {
        if (entry.status == kVisibilitySkipped && entry.channel.empty()) {
          skipped += entry.sequence;
          next_cycle = std::max(next_cycle, m.cycle + entry.sequence);
          continue;
        }
        const std::string_view name = std::string_view(entry.channel).substr(0, entry.channel.find('/'));
        for (auto& c : channels)
          if (c->entry->name == name)
            if (auto s = show(*c, entry); !s) return s;
      }
      visibility.drop();
    }
  }

  Status take_commands() {
    given.clear();
    while (true) {
      const auto message = told.peek();
      if (!message) return tl::unexpected<Error>(message.error());
      if (!*message) return {};
      const msg::Command& m = **message;
      Command command;
      command.t_issue = run.epoch.to_bench(
          RealtimeTime(std::int64_t{m.header.stamp.sec} * 1'000'000'000 + m.header.stamp.nanosec));
      if (command.t_issue > t) return {};
      command.sequence = m.sequence;
      command.t_effect = BenchTime(m.t_effect_ns);
      command.count = static_cast<std::uint32_t>(std::min(m.values.size(), command.value.size()));
      std::copy_n(m.values.begin(), command.count, command.value.begin());
      for (const Out& sink : sinks)
        if (sink.entry->name == m.channel) given.push_back({sink.port.get(), command});
      told.drop();
    }
  }

  Result<bool> next() {
    for (auto& c : channels)
      if (c->status == PortStatus::fresh) c->status = PortStatus::held;
    if (auto s = take_visibility(); !s) return tl::unexpected<Error>(s.error());
    const auto message = visibility.peek();
    if (!message) return tl::unexpected<Error>(message.error());
    // How many there were is said at the end of the file; of one that was cut short, what changed last.
    const bool over = run.cycles > 0 ? next_cycle >= run.cycles : !*message && next_cycle > last_known;
    if (over) return false;
    t = run.t0 + rig.loop.period * static_cast<std::int64_t>(next_cycle);
    for (auto& c : channels) c->port.obey(c->status, c->sequence, t);
    if (auto s = take_commands(); !s) return tl::unexpected<Error>(s.error());
    ++next_cycle;
    ++ran;
    return true;
  }
};

RecordedPorts::RecordedPorts(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RecordedPorts::~RecordedPorts() = default;

Result<std::unique_ptr<RecordedPorts>> RecordedPorts::open(const std::filesystem::path& file,
                                                           const RigConfig& rig, const RecordedRun& run) {
  auto reader = record::McapReader::open(file.string());
  if (!reader) return tl::unexpected<Error>(reader.error());
  if (run.cycles > static_cast<std::uint64_t>(kLongestRun / rig.loop.period))
    return fail(ErrorCode::protocol, file.string(),
                fmt::format("expected a run of at most {:g} s, got one of {} cycles", kLongestRun.seconds(),
                            run.cycles));
  auto impl = std::make_unique<Impl>(std::move(*reader), rig, run);
  for (const ChannelEntry& c : rig.channels)
    if (auto s = impl->add(c); !s) return tl::unexpected<Error>(s.error());
  for (const SinkEntry& s : rig.sinks)
    if (auto added = impl->add(s); !added) return tl::unexpected<Error>(added.error());
  return std::unique_ptr<RecordedPorts>(new RecordedPorts(std::move(impl)));
}

const ApplicationPorts& RecordedPorts::ports() const { return impl_->ports; }
Result<bool> RecordedPorts::next() { return impl_->next(); }
BenchTime RecordedPorts::now() const { return impl_->t; }
std::span<const RecordedPorts::Given> RecordedPorts::commands() const { return impl_->given; }
std::uint64_t RecordedPorts::cycles() const { return impl_->ran; }
std::uint64_t RecordedPorts::skipped() const { return impl_->skipped; }
std::uint64_t RecordedPorts::missing_samples() const { return impl_->missing; }

}  // namespace rigor
