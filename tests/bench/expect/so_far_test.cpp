// How expectations stand while a run goes on, as the live view asks for it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "bench/expect/expectations.h"
#include "bench/expect/expected_forms.h"
#include "sensor-hal/record/replay_sink.h"

namespace rigor {
namespace {

/// A channel of 100 Hz in a loop of 1 kHz whose value is the sequence.
class SoFarTest : public ::testing::Test {
 protected:
  void expect(const std::string& entries) {
    const auto root = ConfigDocument::parse(
        "application: { name: script }\n"
        "channels:\n"
        "  table: { kind: registers, backend: modbus, rate_hz: 100, latency_ms: 1 }\n"
        "  left: { kind: imu, pair: { real: { backend: can }, simulated: { backend: simulated } }, rate_hz: "
        "100 }\n"
        "sinks:\n"
        "  drive: { backend: log, signals: [v] }\n"
        "expect:\n" +
            entries,
        "rig.yaml");
    ASSERT_TRUE(root) << root.error().text();
    auto parsed = parse_rig(*root, "rig.yaml");
    ASSERT_TRUE(parsed) << parsed.error().text();
    rig = std::move(*parsed);
    auto read = Expectations::read(rig);
    ASSERT_TRUE(read) << read.error().text();
    expectations = std::move(*read);
    description.kind = SampleKind::register_block;
    description.names = {"position"};
    sink = std::make_unique<ReplaySink>(rig.sinks[0].sink.params);
    ChannelConfig config;
    config.name = "drive";
    ASSERT_TRUE(sink->configure(config));
    out = std::make_unique<CommandPort>("drive", *sink, Duration(0));
    ports.outputs["drive"] = out.get();
    ports.inputs["table"] = {"table", &description, &port};
    ports.inputs["left"] = {"left", &description, &silent};
    const auto bound = expectations->bind(ports);
    ASSERT_TRUE(bound) << bound.error().text();
    port.configure(rig.channels[0].timing, at(0));
    expectations->begin(at(0));
    known.extent = RunEnd::Extent::so_far;
    known.sinks = {{"drive", 0, 0, 0}};
    known.skipped = known.misses = 0;
  }
  static BenchTime at(std::int64_t ms) { return BenchTime(5'000'000'000) + milliseconds(ms); }
  void run(std::int64_t until_ms, bool silent_channel = false) {
    for (; ms < until_ms; ++ms) {
      if (ms % 10 == 0 && !silent_channel) {
        SampleSlot slot = pool->try_acquire();
        Sample& s = *slot;
        s.stamp = {.sequence = static_cast<std::uint64_t>(ms / 10),
                   .t_capture = at(ms),
                   .t_release = at(ms + 1),
                   .t_arrival = at(ms + 1)};
        RegisterBlock block;
        block.count = 1;
        block.value[0] = static_cast<double>(ms / 10);
        s.info = block;
        port.push(std::move(slot));
      }
      port.advance(at(ms), true);
      expectations->cycle(at(ms));
    }
  }
  /// "holds", "violated" …, after the loop was asked and went round once.
  std::vector<std::string> states() {
    expectations->ask();
    run(ms + 1);
    std::vector<std::string> all;
    for (const Expected& e : expectations->so_far(known)) all.emplace_back(e.state());
    return all;
  }

  RigConfig rig;
  std::unique_ptr<Expectations> expectations;
  std::unique_ptr<SamplePool> pool = make_sample_pool(80, 0);
  std::unique_ptr<ReplaySink> sink;
  std::unique_ptr<CommandPort> out;
  ChannelDescription description;
  SamplePort port, silent;
  ApplicationPorts ports;
  RunEnd known;
  std::int64_t ms = 0;
};

TEST_F(SoFarTest, WhatIsNotDecidedYetBecomesWhatHoldsOrIsViolated) {
  expect(
      "  - { of: table.position, value: { max: 20 } }\n"
      "  - { of: table, missing: { max: 5 }, rate_hz: { min: 99 } }\n"
      "  - { of: table, missing: { min: 7 } }\n"
      "  - { of: table.position, value: { max: 1000 }, from_s: 0.3 }\n"
      "  - { of: drive.v, value: { max: 1 } }\n"
      "  - { of: drive, failed: { max: 0 } }\n"
      "  - { of: loop, skipped: { max: 0 }, wake_p99_us: { max: 1000000 } }\n"
      "  - { of: application, late: { max: 0 } }\n"
      "  - { of: left, alarm: true }\n"
      "  - { of: left, alarm: false }\n");
  using S = std::vector<std::string>;
  run(100);
  for (const Expected& e : expectations->so_far(known))
    EXPECT_FALSE(e.decided && e.of.starts_with("table")) << "the loop was not asked: " << e.sentence();
  const std::string holds = "holds", open = "undecided", violated = "violated";
  //         value  rate   missing min    from   v     failed wake  skipped app   alarms
  EXPECT_EQ(states(), (S{holds, holds, holds, open, open, open, holds, open, holds, open, open, holds}));
  run(310);
  EXPECT_EQ(states(), (S{violated, holds, holds, open, holds, open, holds, open, holds, open, open, holds}));
  const Expected e = expectations->so_far(known).front();
  EXPECT_NEAR(*e.first_s, 0.211, 1e-9);
  EXPECT_EQ(e.sentence(),
            "table.position: expected value of at most 20, got 0 to 30; 10 of 31, first at 0.211 s");
  run(410, true);  // ten do not come
  run(500);
  known.skipped = 3;
  known.sinks[0].failed = 1;
  known.alarms.push_back({"left", 0.45});
  EXPECT_EQ(states(), (S{violated, violated, violated, holds, holds, open, violated, open, violated, open,
                         holds, violated}));
  const std::vector<Expected> all = expectations->so_far(known);
  const nlohmann::json list = to_json(all);
  for (std::size_t i = 0; i < all.size(); ++i) {
    EXPECT_EQ(list[i]["state"], all[i].state());
    EXPECT_EQ(list[i]["holds"].is_null(), all[i].state() == open) << list[i].dump();
  }
  EXPECT_THAT(expectations->so_far(known)[7].outcome(), "known when the run has ended");
}

TEST_F(SoFarTest, ASampleMoreOrLessAtTheStartIsNoRateYet) {
  expect("  - { of: table, rate_hz: { min: 99 } }\n");
  run(12, true);
  EXPECT_EQ(states(), std::vector<std::string>{"undecided"}) << "one was due and is not there";
  run(300, true);
  EXPECT_EQ(states(), std::vector<std::string>{"violated"});
}

TEST_F(SoFarTest, AtTheEndAllIsShownUnasked) {
  expect("  - { of: table.position, value: { max: 20 } }\n");
  run(100);
  EXPECT_FALSE(expectations->so_far(known)[0].decided);
  expectations->show();
  EXPECT_TRUE(expectations->so_far(known)[0].holds);
  EXPECT_EQ(expectations->so_far(known)[0].looked_at, 10U);
}

}  // namespace
}  // namespace rigor
