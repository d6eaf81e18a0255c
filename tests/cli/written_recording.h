// A recording whose stamps a test chooses, written as a run in wall-clock time writes it.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "sensor-hal/channel/fault_spec.h"
#include "sensor-hal/record/recorder.h"

namespace rigor::test {

inline constexpr std::int64_t kMs = 1'000'000;

/// Register channels and one sink, `motor`; closed at its end.
class WrittenRecording {
 public:
  struct Options {
    std::vector<std::string> channels{"scan"};
    std::string pair{};  ///< one of them
    std::string clock = "wall", rig = "channels: {}";
  };
  WrittenRecording(const std::filesystem::path& file, const Options& o) : pool_(make_sample_pool(64, 0)) {
    RecorderOptions options;
    options.virtual_time = true;  // of the recorder: no sample is skipped
    std::vector<RecordedChannel> channels;
    for (const auto& name : o.channels) {
      RecordedChannel c;
      c.name = name, c.is_pair = name == o.pair;
      c.description.kind = SampleKind::register_block;
      c.description.names = {"value"}, c.description.units = {""};
      channels.push_back(c);
    }
    auto recorder = Recorder::create(file.string(), options, channels, {{"motor", {"enable", "rate"}}},
                                     {{"clock", o.clock}, {"rig_file", "my-rig.yaml"}, {"rig", o.rig}});
    EXPECT_TRUE(recorder) << recorder.error().text();
    recorder_ = std::move(*recorder);
    recorder_->begin(BenchTime(0));
  }
  ~WrittenRecording() {
    recorder_->end_cycle(cycle_, BenchTime(1'000'000 * kMs));
    EXPECT_TRUE(recorder_->stop());
  }
  struct Of {
    std::int64_t capture_ns = 0, arrival_ns = 0, latency_ns = 0, sigma_ns = 0;
    std::uint32_t validity = kValid;
    double value = 0;
  };
  void sample(std::uint32_t channel, const Of& s, std::optional<PairSide> side = std::nullopt) {
    SampleSlot slot = take();
    Sample& sample = *slot;
    sample.stamp = {.sequence = sequence_[channel]++,
                    .t_capture = BenchTime(s.capture_ns),
                    .t_release = BenchTime(s.capture_ns + s.latency_ns),
                    .t_arrival = BenchTime(s.arrival_ns),
                    .sigma_capture = Duration(s.sigma_ns),
                    .validity = s.validity};
    RegisterBlock block;
    block.count = 1, block.value[0] = s.value;
    sample.info = block;
    const SampleLease lease = std::move(slot);
    if (side)
      recorder_->record_side(channel, *side, lease);
    else
      recorder_->record(channel, lease);
    end_cycle();
  }
  void command(std::int64_t issue_ns, std::int64_t effect_ns, double enable, double rate) {
    rigor::Command c;
    c.sequence = commands_++, c.t_issue = BenchTime(issue_ns), c.t_effect = BenchTime(effect_ns);
    c.count = 2, c.value[0] = enable, c.value[1] = rate;
    recorder_->record_command(0, c);
    end_cycle();
  }
  void fault(std::uint32_t channel) {
    SampleSlot slot = take();
    slot->stamp = {};
    slot->info = EventInfo{.code = kEventFaultBegin};
    recorder_->record_event(channel, std::move(slot));
    end_cycle();
  }

 private:
  SampleSlot take() {
    SampleSlot slot = pool_->try_acquire();
    EXPECT_TRUE(slot);
    return slot;
  }
  /// At one instant, which nothing is released by before the end.
  void end_cycle() { recorder_->end_cycle(cycle_++, BenchTime(-kMs)); }

  std::unique_ptr<SamplePool> pool_;
  std::unique_ptr<Recorder> recorder_;
  std::map<std::uint32_t, std::uint64_t> sequence_;
  std::uint64_t cycle_ = 0, commands_ = 0;
};

}  // namespace rigor::test
