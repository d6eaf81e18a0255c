// `rigor calibrate latency`, and what `rigor calibrate delay` says of a latency: on recordings whose arrivals
// are known, and on one of a device on loopback in wall-clock time.
#include <algorithm>
#include <cmath>
#include <functional>
#include <random>

#include "sensor-hal/record/mcap_writer.h"
#include "tests/cli/calibrate_fixture.h"
#include "tests/cli/written_recording.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;
using ::testing::Not;

class CalibrateLatency : public Calibrate {
 protected:
  /// `n` captures of channel 0, a millisecond apart, with the latencies that `draw` gives, ns. Those that are
  /// recorded.
  std::vector<std::int64_t> record(const std::string& name, std::size_t n,
                                   const std::function<double()>& draw,
                                   WrittenRecording::Of of = {.latency_ns = 2 * kMs, .sigma_ns = 10'000},
                                   const WrittenRecording::Options& options = {}) const {
    WrittenRecording file(dir / name, options);
    std::vector<std::int64_t> latencies;
    for (std::size_t k = 0; k < n; ++k) {
      of.capture_ns = static_cast<std::int64_t>(k) * kMs;
      latencies.push_back(std::llround(draw()));
      of.arrival_ns = of.capture_ns + latencies.back();
      file.sample(0, of);
    }
    return latencies;
  }
  [[nodiscard]] std::function<double()> tail() {
    return
        [this] { return 1.5 * kMs + std::exponential_distribution<>(5 / static_cast<double>(kMs))(random_); };
  }
  json only_channel(const json& answer) const {
    EXPECT_EQ(answer["channels"].size(), 1u) << answer.dump();
    return answer["channels"].empty() ? json() : answer["channels"][0];
  }
  static std::size_t above(const std::vector<std::int64_t>& latencies, double ms) {
    return static_cast<std::size_t>(
        std::ranges::count_if(latencies, [&](std::int64_t l) { return static_cast<double>(l) > ms * kMs; }));
  }
  static std::string warnings(const json& answer) { return answer["warnings"].dump(); }
  std::mt19937_64 random_{5};
};

TEST_F(CalibrateLatency, RecommendsABoundOfTheQuantileAndSaysHowManyAreLateWithIt) {
  auto latencies = record("run.mcap", 5000, tail());
  const json answer = this->answer({"latency", "run.mcap"});
  const json c = only_channel(answer);
  EXPECT_EQ(c["channel"], "scan");
  const std::size_t n = c["samples"];
  EXPECT_EQ(n + c["left_out"]["near_the_end"].get<std::size_t>(), 5000u);
  EXPECT_GT(n, 4980u);
  latencies.resize(n);  // the last are left out
  std::vector<std::int64_t> sorted = latencies;
  std::sort(sorted.begin(), sorted.end());
  // P(Bin(n, 0.999) < r) ≥ 0.95 for 5 expected above: the second largest's binomial tail is e^-5 (1 + 5) =
  // 0.040.
  const std::int64_t bound = sorted[n - 2];
  EXPECT_EQ(c["bound"]["method"], "order statistic");
  EXPECT_DOUBLE_EQ(c["bound"]["ms"].get<double>(), static_cast<double>(bound) / 1e6);
  const double put = std::ceil((static_cast<double>(bound) * 1e-6 + 2 * 0.01) * 10) / 10;
  EXPECT_NEAR(c["recommended"]["latency_ms"].get<double>(), put, 1e-9);
  EXPECT_EQ(c["recommended"]["late"], above(latencies, put));
  EXPECT_EQ(c["present"]["late"], above(latencies, 2));
  EXPECT_GT(above(latencies, 2), 300u);  // e^-2.5 of them
  EXPECT_EQ(c["present"]["latency_ms"], 2.0);
  EXPECT_EQ(c["p50_ms"].get<double>(), static_cast<double>(sorted[(n + 1) / 2 - 1]) / 1e6);
  EXPECT_EQ(c["max_ms"].get<double>(), static_cast<double>(sorted.back()) / 1e6);
  EXPECT_NEAR(c["sigma_capture_ms"].get<double>(), 0.01, 1e-12);
  EXPECT_TRUE(c["stationary"].get<bool>());
  EXPECT_TRUE(answer["warnings"].empty()) << warnings(answer);
  EXPECT_EQ(answer["set"][0], "channels.scan.latency_ms=" + c["recommended"]["latency_ms"].dump());
  EXPECT_EQ(answer["inputs"][0]["sha256"].get<std::string>().size(), 64u);

  const Said said = run({"latency", "run.mcap"});
  EXPECT_EQ(said.status, 0) << said.err;
  EXPECT_THAT(said.out,
              HasSubstr("channels.scan.latency_ms: " + c["recommended"]["latency_ms"].dump() + "\n"));
  EXPECT_THAT(said.out, HasSubstr("try it: rigor run my-rig.yaml --set channels.scan.latency_ms="));
  for (const std::string& text : {said.out, answer.dump()}) {
    EXPECT_THAT(text, Not(HasSubstr("nan")));
    EXPECT_THAT(text, Not(HasSubstr("inf")));
  }
}

TEST_F(CalibrateLatency, TooFewSamplesAreExtrapolatedAndItSaysHowManyAreNeeded) {
  record("run.mcap", 120, tail());
  const json answer = this->answer({"latency", "run.mcap"});
  const json c = only_channel(answer);
  EXPECT_EQ(c["bound"]["method"], "exponential tail");
  EXPECT_EQ(c["bound"]["samples_needed"], 2995);
  EXPECT_GE(c["recommended"]["latency_ms"].get<double>(), c["max_ms"].get<double>());
  EXPECT_TRUE(c["p999_ms"].is_null());
  EXPECT_THAT(warnings(answer), HasSubstr("of the 2995 samples that the quantile 0.999 needs (3 s)"));
  // A share that they do tell.
  const json less = only_channel(this->answer({"latency", "run.mcap", "--quantile", "0.9"}));
  EXPECT_EQ(less["bound"]["method"], "order statistic");
  EXPECT_TRUE(less["warnings"].empty()) << less["warnings"].dump();
  EXPECT_LT(less["recommended"]["latency_ms"], c["recommended"]["latency_ms"]);

  record("few.mcap", 15, tail());
  expect_refused({"latency", "few.mcap"}, {"scan", "expected at least 20 samples, got 1"});
}

TEST_F(CalibrateLatency, StampsThatDoNotKnowTheCaptureAreRefusedWithWhatToDo) {
  record("unsure.mcap", 100, [] { return 40.0 * kMs; }, {.latency_ns = 40 * kMs, .validity = kClockUnsure});
  expect_refused({"latency", "unsure.mcap"},
                 {"scan", "do not know the capture", "kClockUnsure", "--trigger",
                  "rigor calibrate delay unsure.mcap --first CHANNEL --second scan"});
  // The same, of a driver that does not say so.
  record("made.mcap", 100, [] { return 40.0 * kMs; }, {.latency_ns = 40 * kMs});
  expect_refused({"latency", "made.mcap"}, {"scan", "do not know the capture", "to the nanosecond"});
  record("ahead.mcap", 100, [] { return -1.0 * kMs; }, {.latency_ns = 40 * kMs});
  expect_refused({"latency", "ahead.mcap"}, {"scan", "of 100 samples arrive before their capture"});
}

TEST_F(CalibrateLatency, SamplesThatAreNotTheDevicesDoNotCount) {
  {
    WrittenRecording file(dir / "run.mcap", {});
    for (std::int64_t k = 0; k < 3300; ++k) {
      WrittenRecording::Of s{.capture_ns = k * kMs, .latency_ns = 5 * kMs};
      s.arrival_ns = s.capture_ns + 1'230'000;
      // Of each a kind that would change everything if it counted.
      if (k < 30) s.validity = kClockUnsure, s.arrival_ns = s.capture_ns + 50 * kMs;
      if (k >= 1000 && k < 1040) s.validity = kSubstituted, s.arrival_ns = s.capture_ns + 60 * kMs;
      file.sample(0, s);
    }
    file.fault(0);
  }
  const json answer = this->answer({"latency", "run.mcap"});
  const json c = only_channel(answer);
  EXPECT_EQ(c["recommended"]["latency_ms"], 1.3);
  EXPECT_EQ(c["left_out"]["clock_unsure"], 30);
  EXPECT_EQ(c["left_out"]["of_faults"], 40);
  EXPECT_THAT(warnings(answer), HasSubstr("30 samples are left out"));
  EXPECT_THAT(warnings(answer), HasSubstr("1 faults acted on it"));
}

TEST_F(CalibrateLatency, WhatCameQuicklyJustBeforeTheEndDoesNotCount) {
  {
    // The run ends at 4000 ms. Every second sample takes 500 ms: of the last half second only the others are
    // there.
    WrittenRecording file(dir / "run.mcap", {});
    for (std::int64_t k = 0; k < 4000; ++k) {
      const std::int64_t latency = k % 2 == 0 ? kMs : 500 * kMs;
      if (k * kMs + latency < 4000 * kMs)
        file.sample(0, {.capture_ns = k * kMs, .arrival_ns = k * kMs + latency, .latency_ns = kMs / 2});
    }
  }
  const json c = only_channel(answer({"latency", "run.mcap"}));
  EXPECT_EQ(c["left_out"]["near_the_end"], 250);
  // Half of them, without one of the kinds being in the majority.
  EXPECT_EQ(c["samples"], 3500);
  EXPECT_EQ(c["p50_ms"], 1.0);
  EXPECT_GT(c["p50_interval_ms"][1], 499.0);
}

TEST_F(CalibrateLatency, RecordingsAndHalvesThatContradictEachOtherAreNamed) {
  record("cold.mcap", 2000, tail());
  const auto slow = [draw = tail()] { return draw() + 4.0 * kMs; };
  record("warm.mcap", 2000, slow);
  const json both = answer({"latency", "cold.mcap", "warm.mcap"});
  const json c = only_channel(both);
  EXPECT_FALSE(c["stationary"].get<bool>());
  EXPECT_EQ(c["parts"][1]["part"], "warm.mcap");
  EXPECT_THAT(warnings(both), HasSubstr("NOT STATIONARY"));
  EXPECT_THAT(warnings(both), HasSubstr("warm.mcap 6."));
  EXPECT_EQ(both["inputs"].size(), 2u);
  EXPECT_TRUE(only_channel(answer({"latency", "cold.mcap"}))["stationary"].get<bool>());

  std::size_t k = 0;
  record("warming.mcap", 4000, [&, draw = tail()] { return draw() + (k++ < 2000 ? 0.0 : 4.0 * kMs); });
  EXPECT_THAT(warnings(answer({"latency", "warming.mcap"})), HasSubstr("second half 6."));
}

TEST_F(CalibrateLatency, OfAPairTheDevicesLatencyGoesIntoTheRig) {
  {
    WrittenRecording file(
        dir / "run.mcap",
        {.channels = {"left", "right"},
         .pair = "left",
         .rig =
             "channels:\n  left: { pair: { real: { backend: aravis }, simulated: { backend: simulated } } }\n"
             "  right: { backend: simulated }\n"});
    for (std::int64_t k = 0; k < 4000; ++k) {
      const auto sample = [&](std::int64_t latency_us) {
        return WrittenRecording::Of{
            .capture_ns = k * kMs, .arrival_ns = k * kMs + latency_us * 1000, .latency_ns = 90 * kMs};
      };
      file.sample(0, sample(12'000), PairSide::real);
      file.sample(0, sample(30'000), PairSide::simulated);
      file.sample(1, sample(20'000));
    }
  }
  const json answer = this->answer({"latency", "run.mcap"});
  EXPECT_EQ(answer["set"], json({"channels.left.latency_ms=12.0", "channels.right.latency_ms=20.0"}));
  ASSERT_EQ(answer["channels"].size(), 3u);
  EXPECT_EQ(answer["channels"][0]["channel"], "left/real");
  EXPECT_FALSE(answer["channels"][0]["simulated"].get<bool>());
  EXPECT_TRUE(answer["channels"][1]["simulated"].get<bool>());
  EXPECT_TRUE(answer["channels"][2]["simulated"].get<bool>());
  EXPECT_THAT(warnings(answer),
              HasSubstr("left: 12 ms is the device's latency; the simulated side needs 30 ms"));
  EXPECT_THAT(run({"latency", "run.mcap"}).out, HasSubstr("channels.right.latency_ms: 20.0    # simulated"));
  EXPECT_EQ(this->answer({"latency", "run.mcap", "--channel", "left"})["channels"].size(), 2u);
  EXPECT_EQ(this->answer({"latency", "run.mcap", "--channel", "left/simulated"})["set"],
            json({"channels.left.latency_ms=30.0"}));
}

/// A device without a clock, whose samples come 30 ms (and up to 2 more) after each trigger.
struct Triggered {
  std::int64_t trigger_ns, arrival_ns;
};
std::vector<Triggered> triggered(std::mt19937_64& random) {
  std::vector<Triggered> all;
  for (std::int64_t k = 0; k < 400; ++k)
    all.push_back({k * 100 * kMs, k * 100 * kMs + 30 * kMs +
                                      std::uniform_int_distribution<std::int64_t>(0, 2 * kMs)(random)});
  return all;
}

TEST_F(CalibrateLatency, ADeviceWithoutAClockIsMeasuredAgainstItsTrigger) {
  {
    WrittenRecording file(dir / "run.mcap", {.channels = {"scan", "sync"}});
    for (const Triggered& t : triggered(random_)) {
      file.sample(1, {.capture_ns = t.trigger_ns, .arrival_ns = t.trigger_ns + 5000, .latency_ns = kMs});
      // As drivers stamp it: the arrival less the rig's latency.
      file.sample(0, {.capture_ns = t.arrival_ns - 50 * kMs,
                      .arrival_ns = t.arrival_ns,
                      .latency_ns = 50 * kMs,
                      .validity = kClockUnsure});
    }
  }
  const json answer = this->answer({"latency", "run.mcap", "--channel", "scan", "--trigger", "sync"});
  const json c = only_channel(answer);
  EXPECT_EQ(c["samples"], 400);
  EXPECT_EQ(c["recommended"]["by"], "median");
  EXPECT_NEAR(c["recommended"]["latency_ms"].get<double>(), 31, 0.21);
  EXPECT_NEAR(c["stamps_after_trigger_ms"].get<double>(), 31 - 50, 0.2);
  const json after = only_channel(this->answer(
      {"latency", "run.mcap", "--channel", "scan", "--trigger", "sync", "--trigger-to-capture", "5"}));
  EXPECT_NEAR(after["recommended"]["latency_ms"].get<double>(), 26, 0.21);
  EXPECT_THAT(run({"latency", "run.mcap", "--channel", "scan", "--trigger", "sync"}).out,
              HasSubstr("no device clock; its stamps are the arrival less latency_ms"));

  expect_refused({"latency", "run.mcap", "--trigger", "sync"}, {"--channel", "that --trigger triggers"});
  expect_refused({"latency", "run.mcap", "--channel", "scan", "--trigger", "sink"},
                 {"expected a channel sink or SINK:VALUE", "channels: scan, sync"});
  expect_refused({"latency", "run.mcap", "--channel", "sync", "--trigger", "scan"},
                 {"scan", "cannot be the trigger"});
  expect_refused({"latency", "run.mcap", "--channel", "scan", "--trigger", "motor:rate"},
                 {"expected commands to a sink motor"});
}

TEST_F(CalibrateLatency, ACommandOfTheBenchIsATriggerWhenItsValueLeavesZero) {
  {
    WrittenRecording file(dir / "run.mcap", {});
    for (const Triggered& t : triggered(random_)) {
      file.command(t.trigger_ns - 10 * kMs, t.trigger_ns, 1, 0);
      file.command(t.trigger_ns, t.trigger_ns + 10 * kMs, 1, 0);
      file.command(t.trigger_ns + 10 * kMs, t.trigger_ns + 20 * kMs, 0, 0);
      // Of a device with a clock, whose stamps are half a millisecond late.
      file.sample(0,
                  {.capture_ns = t.trigger_ns + kMs / 2, .arrival_ns = t.arrival_ns, .latency_ns = 50 * kMs});
    }
  }
  const json c = only_channel(answer(
      {"latency", "run.mcap", "--channel", "scan", "--trigger", "motor:enable", "--quantile", "0.99"}));
  EXPECT_EQ(c["samples"], 400);
  EXPECT_EQ(c["recommended"]["by"], "bound");
  EXPECT_NEAR(c["recommended"]["latency_ms"].get<double>(), 32, 0.11);
  EXPECT_EQ(c["stamps_after_trigger_ms"], 0.5);
  expect_refused({"latency", "run.mcap", "--channel", "scan", "--trigger", "motor:enabel"},
                 {"expected a value enabel of the sink motor", "did you mean enable?"});
  expect_refused({"latency", "run.mcap", "--channel", "scan", "--trigger", "motor:rate"},
                 {"none of its samples comes after a trigger"});
}

TEST_F(CalibrateLatency, ASourceOfSamplesOfItsOwnIsNotTriggered) {
  {
    WrittenRecording file(dir / "run.mcap", {.channels = {"scan", "sync"}});
    for (std::int64_t k = 0; k < 400; ++k) {
      if (k % 4 == 0)
        file.sample(1, {.capture_ns = k * 25 * kMs, .arrival_ns = k * 25 * kMs, .latency_ns = kMs});
      file.sample(0, {.capture_ns = k * 25 * kMs, .arrival_ns = k * 25 * kMs + 3 * kMs, .latency_ns = kMs});
    }
  }
  expect_refused({"latency", "run.mcap", "--channel", "scan", "--trigger", "sync"},
                 {"scan", "expected a sample for each trigger, got 300 samples more than the 100"});
}

TEST_F(CalibrateLatency, TriggersFasterThanTheLatencyAreWarnedOf) {
  {
    WrittenRecording file(dir / "run.mcap", {.channels = {"scan", "sync"}});
    for (std::int64_t k = 0; k < 400; ++k) {
      file.sample(1, {.capture_ns = k * 10 * kMs, .arrival_ns = k * 10 * kMs, .latency_ns = kMs});
      file.sample(0, {.capture_ns = k * 10 * kMs, .arrival_ns = k * 10 * kMs + 7 * kMs, .latency_ns = kMs});
    }
  }
  EXPECT_THAT(warnings(answer({"latency", "run.mcap", "--channel", "scan", "--trigger", "sync"})),
              HasSubstr("two triggers are 10.000 ms apart"));
}

TEST_F(CalibrateLatency, WrongInputIsRefused) {
  record("run.mcap", 100, tail());
  expect_refused({"latency", "nothing.mcap"}, {"nothing.mcap", "got nothing of that name"});
  expect_refused({"latency", "run.mcap", "--channel", "scn"},
                 {"run.mcap", "expected a channel scn", "channels: scan", "did you mean scan?"});
  for (const char* bad : {"1", "1.5"})
    expect_refused({"latency", "run.mcap", "--quantile", bad}, {"--quantile", "expected a share below 1"});
  expect_refused({"latency", "run.mcap", "--quantile", "0"}, {"--quantile"});
  expect_refused({"latency", "run.mcap", "--confidence", "nan"}, {"--confidence"});
  write_file(dir / "text.mcap", "this is no recording");
  expect_refused({"latency", "text.mcap"}, {"text.mcap"});
  record("virtual.mcap", 100, tail(), {.latency_ns = 2 * kMs}, {.clock = "virtual"});
  expect_refused({"latency", "virtual.mcap"}, {"virtual.mcap", "wall-clock time", "--clock wall"});
  {
    WrittenRecording file(dir / "sink.mcap", {});
    for (std::int64_t k = 0; k < 100; ++k) {
      file.sample(0, {.capture_ns = k * kMs, .arrival_ns = k * kMs + 7, .latency_ns = kMs});
      file.command(k * kMs, k * kMs + 10, 1, 2);
    }
  }
  expect_refused({"latency", "sink.mcap", "--channel", "motor"},
                 {"motor is a sink", "rigor calibrate delay sink.mcap --first motor:VALUE", "enable, rate"});
  {
    auto sink = record::open_file_sink((dir / "foreign.mcap").string());
    ASSERT_TRUE(sink) << sink.error().text();
    auto writer = record::McapWriter::open(std::move(*sink));
    ASSERT_TRUE(writer);
    const auto schema = (*writer)->add_schema("sensor_msgs/msg/Imu", "ros2msg", "float64 x");
    ASSERT_TRUE(schema);
    ASSERT_TRUE((*writer)->add_channel({.schema = *schema, .topic = "/imu"}));
    ASSERT_TRUE((*writer)->close());
  }
  expect_refused({"latency", "foreign.mcap"}, {"foreign.mcap", "whose samples have stamps"});
  const Said said = run({"latency", "run.mcap", "--channel", "scn", "--json"});
  EXPECT_EQ(said.status, 2);
  EXPECT_TRUE(json::parse(said.out, nullptr, false).contains("error")) << said.out;
}

// ------------------------------------------------------------------ what the delay fit says of a latency

double swing(std::int64_t t_ns) {
  const double t = static_cast<double>(t_ns) * 1e-9;
  return std::sin(2.1 * t) + 0.4 * std::sin(5.3 * t + 1);
}

TEST_F(CalibrateLatency, TheDelayOfADeviceWithoutAClockGivesItsLatency) {
  {
    // The device takes 37 ms; the rig says 50.
    WrittenRecording file(dir / "run.mcap", {.channels = {"scan", "table"}});
    for (std::int64_t k = 0; k < 2000; ++k)
      file.sample(1, {.capture_ns = k * 5 * kMs,
                      .arrival_ns = k * 5 * kMs + 1,
                      .latency_ns = kMs,
                      .value = swing(k * 5 * kMs)});
    for (std::int64_t k = 0; k < 300; ++k) {
      const std::int64_t capture = 100 * kMs + k * 30 * kMs, arrival = capture + 37 * kMs;
      file.sample(0, {.capture_ns = arrival - 50 * kMs,
                      .arrival_ns = arrival,
                      .latency_ns = 50 * kMs,
                      .validity = kClockUnsure,
                      .value = 3 + 2 * swing(capture)});
    }
  }
  const std::vector<std::string> words{"delay", "run.mcap", "--first", "table", "--second", "scan"};
  EXPECT_NEAR(answer(words)["parameters"]["delay_s"]["value"].get<double>(), 0.013, 1e-5);
  EXPECT_THAT(run(words).out, HasSubstr("are the arrival less latency_ms 50: latency_ms 37.0 corrects them"));
  // Of one whose clock is known it says nothing.
  EXPECT_THAT(run({"delay", "run.mcap", "--first", "table", "--second", "table"}).out,
              Not(HasSubstr("latency_ms")));
}

/// A command each 20 ms, held until the next one, to a device that follows 7 ms after it got it; samples of
/// it.
void record_effects(const std::filesystem::path& name, std::int64_t sample_ns) {
  WrittenRecording file(name, {});
  const auto commanded = [](std::int64_t t_ns) { return swing(t_ns / (20 * kMs) * (20 * kMs)); };
  for (std::int64_t k = 0; k < 500; ++k)
    file.command(k * 20 * kMs - 10 * kMs, k * 20 * kMs, 1, commanded(k * 20 * kMs));
  for (std::int64_t t = 500 * kMs; t < 9500 * kMs; t += sample_ns)
    file.sample(
        0, {.capture_ns = t, .arrival_ns = t + 1, .latency_ns = kMs, .value = 5 * commanded(t - 7 * kMs)});
}

TEST_F(CalibrateLatency, TheDelayOfAnEffectAfterItsCommandIsThatFromCommandToEffect) {
  record_effects(dir / "run.mcap", 3'071'000);
  const std::vector<std::string> words{"delay", "run.mcap", "--first", "motor:rate", "--second", "scan"};
  const json j = answer(words);
  EXPECT_NEAR(j["parameters"]["delay_s"]["value"].get<double>(), -0.007, 2e-4);
  EXPECT_NEAR(j["parameters"]["gain"]["value"].get<double>(), 5, 0.01);
  EXPECT_TRUE(j["warnings"].empty()) << j["warnings"].dump();
  const std::string said = run(words).out;
  EXPECT_THAT(said, HasSubstr("from command to effect 1"));
  EXPECT_THAT(said, HasSubstr("ms: latency_ms 10 of the sink, and "));
  expect_refused({"delay", "run.mcap", "--first", "motor:rte", "--second", "scan"},
                 {"expected a value rte of the sink motor", "did you mean rate?"});
  expect_refused({"delay", "run.mcap", "--first", "moter:rate", "--second", "scan"},
                 {"expected commands to a sink moter", "did you mean motor?"});
}

// At 0 and 10 ms after each command anything between 0 and 10 ms looks alike: without a word it would be 5
// ms.
TEST_F(CalibrateLatency, SamplesAtTheSamePhasesOfTheCommandsDoNotTellTheDelay) {
  record_effects(dir / "run.mcap", 10 * kMs);
  const json j = answer({"delay", "run.mcap", "--first", "motor:rate", "--second", "scan"});
  const json& delay = j["parameters"]["delay_s"];
  EXPECT_GT(std::abs(delay["value"].get<double>() + 0.007), 10 * delay["sigma"].get<double>());
  EXPECT_THAT(warnings(j), HasSubstr("on the same instants after each command, 9.5 ms apart"));
}

// ------------------------------------------------------------------ a device

constexpr const char* kMeterRig = R"(
name: meter
loop: { rate_hz: 500 }
channels:
  meter:
    kind: registers
    backend: modbus
    emulated_by: meter
    rate_hz: 200
    latency_ms: 0
    address: 127.0.0.1
    port: 5047
    registers:
      - { name: voltage, table: input_registers, address: 0, type: f32, unit: V }
emulators:
  meter:
    backend: modbus
    address: 127.0.0.1
    port: 5047
    registers:
      - { name: voltage, table: input_registers, address: 0, type: f32, value: 230, wave: { amplitude: 4, period_s: 2 } }
)";

TEST_F(CalibrateLatency, ADeviceOnLoopbackIsInTimeWithWhatWasMeasured) {
  write_file(dir / "rig.yaml", kMeterRig);
  const auto late_in = [&](const std::string& name, const std::vector<std::string>& more) {
    std::vector<std::string> words{"run", "rig.yaml", "--duration", "3", "--record", name, "--json"};
    words.insert(words.end(), more.begin(), more.end());
    const Said said = rigor(words, dir.path());
    EXPECT_EQ(said.status, 0) << said.err;
    return json::parse(said.out, nullptr, false)["channels"][0]["late_samples"].get<int>();
  };
  EXPECT_GT(late_in("before.mcap", {}), 550);  // of 600: with no latency each of them is late
  const json answer = this->answer({"latency", "before.mcap", "--quantile", "0.99"});
  const json c = only_channel(answer);
  EXPECT_EQ(c["bound"]["method"], "order statistic");
  EXPECT_EQ(c["present"]["late"], c["samples"]);
  EXPECT_GT(c["p50_ms"].get<double>(), 0.005);
  EXPECT_GT(c["sigma_capture_ms"].get<double>(), 0);
  EXPECT_LE(c["recommended"]["late_share"].get<double>(), 0.01);
  const int late = late_in("after.mcap", {"--set", answer["set"][0].get<std::string>()});
  EXPECT_LE(late, 24);  // 1 % are to be expected; four times that
}

}  // namespace
}  // namespace rigor::test
