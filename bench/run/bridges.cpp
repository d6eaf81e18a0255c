#include "bench/run/bridges.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "bench/run/recording.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor {
namespace {

/// Of each channel's samples held at a time, beside those that the transport holds: what is more is dropped.
constexpr std::size_t kLeaseBudget = 2;

class PairObservers final : public PairObserver {
 public:
  explicit PairObservers(std::vector<PairObserver*> all) : all_(std::move(all)) {}
  void on_side_sample(PairSide side, const SampleLease& sample) noexcept override {
    for (PairObserver* o : all_) o->on_side_sample(side, sample);
  }
  void on_window(const SampleLease& window) noexcept override {
    for (PairObserver* o : all_) o->on_window(window);
  }

 private:
  std::vector<PairObserver*> all_;
};

BridgeRig rig_of(const RunParts& parts) {
  BridgeRig rig;
  rig.name = parts.rig.name;
  for (const auto& c : parts.channels) rig.channels.push_back(c->entry->name);
  for (const auto& s : parts.sinks) rig.sinks.push_back({s->entry->name, s->sink->describe().names});
  return rig;
}

}  // namespace

std::uint64_t RunBridgeReport::messages() const {
  std::uint64_t n = 0;
  for (const auto& t : traffic.topics) n += t.messages;
  return n;
}
std::uint64_t RunBridgeReport::messages_dropped() const {
  std::uint64_t n = 0;
  for (const auto& t : traffic.topics) n += t.dropped;
  return n;
}

Status add_bridges(RunParts& parts, const Registry& registry) {
  const BridgeRig rig = rig_of(parts);
  for (const BridgeEntry& entry : parts.rig.bridges) {
    const NamedBridge* known = registry.find_bridge(entry.name);
    if (!known) {
      const auto names = registry.bridge_names();
      return tl::unexpected<Error>(
          entry.node
              .error("", fmt::format("expected one of {}, got \"{}\"{}", fmt::join(names, ", "), entry.name,
                                     did_you_mean(entry.name, names)))
              .error());
    }
    auto bridge = std::make_shared<RunBridge>();
    bridge->name = entry.name;
    bridge->node = entry.node;
    bridge->bridge = known->make();
    if (auto s = bridge->bridge->configure(entry.node, rig); !s) return s;
    entry.node.finish();
    parts.bridges.push_back(std::move(bridge));
  }
  return {};
}

Status open_bridges(RunParts& parts, const EpochPair& epoch) {
  for (const auto& b : parts.bridges) {
    RecorderOptions options;
    options.virtual_time = parts.rig.clock == ClockKind::virtual_time;
    options.live = true;
    options.epoch = epoch;
    options.loop_period = parts.rig.loop.period;
    auto frames = frame_source(parts, epoch);
    if (!frames) return tl::unexpected<Error>(frames.error());
    options.frames = std::move(*frames);
    options.frames_period = parts.rig.frames.period;
    options.root_frame = parts.rig.frames.root;
    options.clock = options.virtual_time && parts.rig.frames.publish;
    auto channels = recorded_channels(parts);
    if (!channels) return tl::unexpected<Error>(channels.error());
    for (RecordedChannel& c : *channels) {
      c.wanted = b->bridge->wants_channel(c.name);
      c.lease_budget = kLeaseBudget;
    }
    std::vector<RecordedSink> sinks;
    for (const auto& s : parts.sinks) sinks.push_back({s->entry->name, s->sink->describe().names});
    auto writer = b->bridge->open(options.virtual_time);
    if (!writer) return tl::unexpected<Error>(writer.error());
    auto recorder =
        Recorder::create(std::move(*writer), std::move(options), std::move(*channels), std::move(sinks), {});
    if (!recorder) return tl::unexpected<Error>(recorder.error());
    b->recorder = std::move(*recorder);
  }
  return {};
}

Status wait_for_peers(RunParts& parts, StopToken stop) {
  for (const auto& b : parts.bridges)
    if (auto s = b->bridge->wait_for_peers(stop); !s) return s;
  return {};
}

std::vector<std::unique_ptr<PairObserver>> observe_for_bridges(RunParts& parts,
                                                               const std::vector<PairObserver*>& first) {
  std::vector<std::unique_ptr<PairObserver>> made;
  if (parts.bridges.empty()) return made;
  for (std::size_t i = 0; i < parts.channels.size(); ++i) {
    PairSource* pair = parts.channels[i]->pair;
    if (!pair) continue;
    std::vector<PairObserver*> all;
    if (first[i]) all.push_back(first[i]);
    for (const auto& b : parts.bridges) all.push_back(b->recorder->observer(static_cast<std::uint32_t>(i)));
    made.push_back(std::make_unique<PairObservers>(std::move(all)));
    pair->observe(made.back().get());
  }
  return made;
}

void close_bridges(RunParts& parts, std::vector<Error>& errors) {
  for (const auto& b : parts.bridges) {
    if (b->recorder)
      if (auto s = b->recorder->stop(); !s) errors.push_back(s.error());
    b->bridge->close();
  }
}

std::vector<RunBridgeReport> bridge_reports(const RunParts& parts) {
  std::vector<RunBridgeReport> all;
  for (const auto& b : parts.bridges) {
    RunBridgeReport r;
    r.name = b->name;
    r.traffic = b->bridge->report();
    if (b->recorder) {
      const Recorder::Statistics s = b->recorder->statistics();
      r.dropped = s.dropped;
      r.samples = s.samples;
      r.after_end = s.after_end;
      r.cpu_s = s.cpu_s;
      for (std::size_t i = 0; i < parts.channels.size(); ++i)
        if (s.dropped_by_channel[i] > 0 || s.samples_by_channel[i] > 0)
          r.channels.push_back(
              {parts.channels[i]->entry->name, s.samples_by_channel[i], s.dropped_by_channel[i]});
    }
    all.push_back(std::move(r));
  }
  return all;
}

}  // namespace rigor
