// Channels, sinks and nodes on the bus of virtual time.
#include <gmock/gmock.h>

#include <fstream>

#include "drivers/can/can_backend.h"
#include "drivers/can/signal_codec.h"
#include "rt-core/heartbeat.h"
#include "tests/drivers/can/can_test_tools.h"

namespace rigor::can {
namespace {

using test::config_of;
using test::entries_of;
using test::node_of;
using testing::HasSubstr;

class CanVirtual : public testing::Test {
 protected:
  std::shared_ptr<NodeOnBus> node(const std::string& more) {
    DeviceParts parts;
    parts.signals = model;
    auto made = buses.node(parts, node_of("{interface: vcan0, dbc: " + folder.dbc() + ", " + more + "}"));
    EXPECT_TRUE(made) << (made ? "" : made.error().text());
    return made ? *made : nullptr;
  }
  std::unique_ptr<Source> source(std::shared_ptr<NodeOnBus> n, const ChannelConfig& c) {
    auto s = make_virtual_source(std::move(n));
    auto status = s->configure(c);
    EXPECT_TRUE(status) << status.error().text();
    EXPECT_TRUE(s->arm({.virtual_time = true}));
    EXPECT_TRUE(s->start(BenchTime(0)));
    return s;
  }
  std::vector<SampleLease> run(Source& s, BenchTime from, BenchTime to) {
    std::vector<SampleLease> out;
    for (BenchTime t = from; t <= to; t = t + milliseconds(1)) {
      s.complete_until(t);
      while (auto sample = s.poll(t)) out.push_back(sample);
    }
    return out;
  }
  static BenchTime ms(std::int64_t n) { return BenchTime(n * 1'000'000); }

  test::Folder folder;
  std::shared_ptr<test::CountingModel> model = std::make_shared<test::CountingModel>();
  VirtualBuses buses;
};

TEST_F(CanVirtual, RawFramesComeAtTheEndOfTheirBits) {
  const auto n = node("node: Device");
  const auto s = source(
      n, config_of(SampleKind::can_frame, "{interface: vcan0, filters: [{id: 0x100}]}", {}, milliseconds(2)));
  const auto samples = run(*s, ms(0), ms(100));
  ASSERT_EQ(samples.size(),
            10u);  // captured at 0, 10 … 90 ms and a frame; that of 100 ms is not released yet
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const auto* f = samples[i]->as<CanFrame>();
    ASSERT_NE(f, nullptr);
    EXPECT_EQ(f->id, 0x100u);
    EXPECT_EQ(samples[i]->stamp.sequence, i);
    // Clock has the smallest identifier, so nothing is in front of it at its instants.
    EXPECT_EQ(samples[i]->stamp.t_capture, ms(10 * static_cast<std::int64_t>(i)) + frame_duration(*f, {}));
    EXPECT_EQ(f->data[0], 10 * i);
  }
  EXPECT_TRUE(s->stop());
}

TEST_F(CanVirtual, SignalsAreSampledOnTheGridAndUnknownBeforeTheFirst) {
  const auto n = node("node: Device");
  const auto s =
      source(n, config_of(SampleKind::register_block,
                          "{interface: vcan0, dbc: " + folder.dbc() +
                              ", signals: [{message: Clock, signal: clock_ms}, {message: State, signal: "
                              "state, name: mode}, {message: Cyclic, signal: level}]}",
                          milliseconds(5)));
  EXPECT_EQ(s->describe().names, (std::vector<std::string>{"clock_ms", "mode", "level"}));
  EXPECT_EQ(s->describe().units[0], "ms");
  const auto samples = run(*s, ms(0), ms(50));
  ASSERT_EQ(samples.size(), 11u);
  const auto value = [&](std::size_t i, std::size_t k) { return samples[i]->as<RegisterBlock>()->value[k]; };
  EXPECT_TRUE(std::isnan(value(0, 0))) << "at 0 ms the first frame is still on the bus";
  EXPECT_EQ(value(1, 0), 0);
  EXPECT_EQ(value(4, 0), 10) << "at 20 ms the frame of 20 ms is on the bus, that of 10 ms is known";
  EXPECT_EQ(value(5, 0), 20);
  EXPECT_EQ(value(1, 1), 3);
  EXPECT_TRUE(std::isnan(value(10, 2))) << "nobody sends Cyclic";
  EXPECT_EQ(samples[10]->stamp.validity, kIncomplete);
  EXPECT_EQ(samples[3]->stamp.t_capture, ms(15));
  EXPECT_EQ(samples[3]->stamp.sequence, 3u);
}

TEST_F(CanVirtual, AValueThatIsNoLongerSentIsUnknownAfterThreeCycles) {
  std::ofstream(folder.file("short.log"))
      << "(1.000000) vcan0 100#0700000000000000\n(1.020000) vcan0 100#0800000000000000\n";
  const auto n = node("replay: " + folder.file("short.log"));
  const auto s = source(n, config_of(SampleKind::register_block,
                                     "{interface: vcan0, dbc: " + folder.dbc() +
                                         ", signals: [{message: Clock, signal: clock_ms}]}",
                                     milliseconds(1)));
  const auto samples = run(*s, ms(0), ms(60));
  const auto value = [&](std::size_t i) { return samples[i]->as<RegisterBlock>()->value[0]; };
  ASSERT_EQ(samples.size(), 61u);
  EXPECT_EQ(value(10), 7);
  EXPECT_EQ(value(50), 8);
  EXPECT_TRUE(std::isnan(value(51))) << "30 ms after the frame's end at 20.2 ms";
}

/// Its lines are read as they are due, so they cannot be sorted: a log of several interfaces is a little out
/// of order.
TEST_F(CanVirtual, ALogIsSentInTheOrderOfItsLinesAndAgainFromTheStart) {
  std::ofstream(folder.file("log")) << "(1.000000) a 101#\n(1.020000) a 102#\n(1.019000) b 103#\n";
  const auto n = node("replay: " + folder.file("log") + ", repeat: true");
  const auto s = source(n, config_of(SampleKind::can_frame, "{interface: vcan0}"));
  const auto samples = run(*s, ms(0), ms(42));  // when the third round begins
  ASSERT_EQ(samples.size(), 6u);
  for (std::size_t i = 0; i < 6; ++i) EXPECT_EQ(samples[i]->as<CanFrame>()->id, 0x101 + i % 3) << i;
  const auto began = [&](std::size_t i) {
    const CanFrame& f = *samples[i]->as<CanFrame>();
    return samples[i]->stamp.t_capture - frame_duration(f, {});
  };
  EXPECT_EQ(began(0), ms(0));
  EXPECT_EQ(began(1), ms(20));
  EXPECT_EQ(began(2), samples[1]->stamp.t_capture);  // due with the one before, behind it on the bus
  EXPECT_EQ(began(3), ms(21));
  EXPECT_EQ(began(4), ms(41));
}

TEST_F(CanVirtual, ALogThatGoesBackIsRefused) {
  std::ofstream(folder.file("log")) << "(5.000000) a 101#\n(3.900000) a 102#\n";
  auto settings = NodeSettings{};
  settings.replay = folder.file("log");
  const auto n = EmulatedNode::make(settings, nullptr);
  ASSERT_FALSE(n);
  EXPECT_THAT(n.error().text(), HasSubstr("goes back by more than a second: (0000000003.900000) a 102#"));
}

TEST_F(CanVirtual, SignalsOnArrivalAreSamplesOfEachFrame) {
  const auto n = node("node: Device");
  const auto s = source(
      n, config_of(SampleKind::register_block,
                   "{interface: vcan0, dbc: " + folder.dbc() +
                       ", signals: [{message: Clock, signal: clock_ms}, {message: State, signal: state}]}"));
  auto samples = run(*s, ms(0), ms(25));
  ASSERT_EQ(samples.size(), 4u) << "Clock three times, State once: it does not change";
  EXPECT_TRUE(std::isnan(samples[0]->as<RegisterBlock>()->value[1]));
  EXPECT_EQ(samples[1]->as<RegisterBlock>()->value[1], 3);
  model->set_state(9);
  samples = run(*s, ms(26), ms(41));
  ASSERT_EQ(samples.size(), 3u);
  EXPECT_EQ(samples.back()->as<RegisterBlock>()->value[1], 9);
}

TEST_F(CanVirtual, AMultiplexorThatNobodyGivesTakesItsValuesInTurn) {
  const auto n = node("messages: [{name: Turns, period_ms: 10}, Clock]");
  const auto s = source(n, config_of(SampleKind::can_frame, "{interface: vcan0, filters: [{id: 258}]}"));
  const auto samples = run(*s, ms(0), ms(45));
  ASSERT_EQ(samples.size(), 5u);
  for (std::size_t i = 0; i < 5; ++i) EXPECT_EQ(samples[i]->as<CanFrame>()->data[0], 1 + i % 2);
}

TEST_F(CanVirtual, CommandsReachTheModelAtTheirInstantAndUnsafeValuesAreRefused) {
  const auto n = node("node: Device");
  const auto ear =
      source(n, config_of(SampleKind::can_frame, "{interface: vcan0, filters: [{id: 0x200}, {id: 0x201}]}"));
  auto sink = make_virtual_sink(n);
  const auto params =
      "{interface: vcan0, dbc: " + folder.dbc() +
      ", signals: [{message: Command, signal: enable}, {message: Command, signal: target, name: rate}, "
      "{message: Cyclic, signal: level}], constants: [{message: Command, signal: fixed, value: 77}], "
      "safe: {enable: 0, rate: 0, level: 1}}";
  auto status = sink->configure(config_of(SampleKind::none, params));
  ASSERT_TRUE(status) << status.error().text();
  Heartbeat heartbeat;
  heartbeat.restart(true);
  sink->watch(&heartbeat, milliseconds(100));
  ASSERT_TRUE(sink->arm({.virtual_time = true}));
  ASSERT_TRUE(sink->start(BenchTime(0)));
  Command c;
  c.count = 3;
  c.value = {1, -12.3, 500};
  c.t_effect = ms(35);
  ASSERT_TRUE(sink->command(c));
  c.value[1] = 900;  // outside of [-500|500]
  c.t_effect = ms(50);
  ASSERT_TRUE(sink->command(c));
  auto samples = run(*ear, ms(0), ms(70));
  EXPECT_EQ(sink->counters().applied, 1u);
  EXPECT_EQ(sink->counters().failed, 1u);
  std::vector<std::pair<std::int64_t, std::uint32_t>> seen;
  for (const auto& s : samples) seen.emplace_back(s->stamp.t_capture.ns() / 1'000'000, s->as<CanFrame>()->id);
  // At 0 the node's three messages win against Command and Cyclic. Command once safe and once commanded;
  // Cyclic every 20 ms, and at once with the command.
  EXPECT_EQ(seen,
            (std::vector<std::pair<std::int64_t, std::uint32_t>>{
                {0, 0x200}, {1, 0x201}, {20, 0x201}, {35, 0x200}, {35, 0x201}, {40, 0x201}, {60, 0x201}}));
  const auto& sent = *samples[3]->as<CanFrame>();
  EXPECT_EQ(sent.data[0], 1);
  EXPECT_EQ(sent.data[1], 0xff);  // -123 as Motorola
  EXPECT_EQ(sent.data[2], 0x85);
  EXPECT_EQ(sent.data[3], 77);
  const auto writes = model->writes();
  ASSERT_EQ(writes.size(), 4u);
  EXPECT_EQ(writes[0].value, 0);
  EXPECT_EQ(writes[2].name, "enable");
  EXPECT_EQ(writes[2].value, 1);
  EXPECT_NEAR(writes[3].value, -12.3, 1e-12);
  EXPECT_EQ(writes[3].t, samples[3]->stamp.t_capture);
  ASSERT_TRUE(sink->stop());
  ASSERT_TRUE(ear->stop());
}

TEST_F(CanVirtual, WhatTheLoopWantedLastDoesNotCountAfterItsEnd) {
  const auto n = node("node: Device");
  auto sink = make_virtual_sink(n);
  ASSERT_TRUE(sink->configure(config_of(
      SampleKind::none, "{interface: vcan0, dbc: " + folder.dbc() +
                            ", signals: [{message: Command, signal: enable}], safe: {enable: 0}}")));
  Heartbeat heartbeat;
  heartbeat.restart(true);
  sink->watch(&heartbeat, milliseconds(100));
  ASSERT_TRUE(sink->arm({.virtual_time = true}));
  ASSERT_TRUE(sink->start(BenchTime(0)));
  Command c;
  c.count = 1;
  c.value = {1};
  c.t_effect = ms(5);
  ASSERT_TRUE(sink->command(c));
  heartbeat.declare_stopped(StopReason::requested);
  sink->complete_until(ms(10));
  EXPECT_EQ(sink->counters().applied, 0u);
  EXPECT_EQ(sink->counters().dropped, 1u);
  for (const auto& w : model->writes()) EXPECT_EQ(w.value, 0);
}

TEST_F(CanVirtual, LogsAreWrittenAndReplayedByteForByte) {
  const std::string log = folder.file("out.log");
  {
    const auto n = node("node: Device, log: " + log);
    const auto s = source(
        n, config_of(SampleKind::can_frame, "{interface: vcan0, log: " + folder.file("ear.log") + "}"));
    (void)run(*s, ms(0), ms(100));
    ASSERT_TRUE(s->stop());
  }
  const auto first = entries_of(folder.file("ear.log"));
  ASSERT_GE(first.size(), 11u);
  EXPECT_EQ(first[0].t.ns() / 1'000'000'000, 1'577'836'800) << "virtual time begins at 2020-01-01";
  {
    const auto n = node("replay: " + folder.file("ear.log"));
    const auto s = source(
        n, config_of(SampleKind::can_frame, "{interface: vcan0, log: " + folder.file("again.log") + "}"));
    (void)run(*s, ms(0), ms(101));
    ASSERT_TRUE(s->stop());
  }
  const auto second = entries_of(folder.file("again.log"));
  ASSERT_EQ(second.size(), first.size());
  for (std::size_t i = 0; i < first.size(); ++i) {
    EXPECT_EQ(first[i].frame.id, second[i].frame.id);
    EXPECT_EQ(first[i].frame.data, second[i].frame.data);
  }
}

TEST_F(CanVirtual, ConfigurationsThatMakeNoSenseAreRefusedWithTheirPlace) {
  const auto n = node("node: Device");
  const auto refused = [&](SampleKind kind, const std::string& params, Duration period = {}) {
    const auto s = make_virtual_source(n)->configure(config_of(kind, params, period));
    return s ? std::string("was accepted") : s.error().text();
  };
  const std::string dbc = "dbc: " + folder.dbc();
  EXPECT_THAT(refused(SampleKind::can_frame, "{}"), HasSubstr("interface"));
  EXPECT_THAT(refused(SampleKind::can_frame, "{interface: vcan0, dbc: x.dbc}"),
              HasSubstr("dbc: unknown key"));
  EXPECT_THAT(refused(SampleKind::can_frame, "{interface: vcan0, filters: [{id: 0x800}]}"),
              HasSubstr("filters"));
  EXPECT_THAT(refused(SampleKind::register_block,
                      "{interface: vcan0, " + dbc + ", signals: [{message: Clok, signal: clock_ms}]}"),
              HasSubstr("did you mean Clock?"));
  EXPECT_THAT(refused(SampleKind::register_block,
                      "{interface: vcan0, " + dbc + ", signals: [{message: Clock, signal: clock}]}"),
              HasSubstr("did you mean clock_ms?"));
  EXPECT_THAT(refused(SampleKind::register_block, "{interface: vcan0, dbc: /no/such.dbc, signals: []}"),
              HasSubstr("/no/such.dbc"));
  const auto sink_refused = [&](const std::string& more) {
    const auto s = make_virtual_sink(n)->configure(
        config_of(SampleKind::none, "{interface: vcan0, " + dbc + ", " + more + "}"));
    return s ? std::string("was accepted") : s.error().text();
  };
  EXPECT_THAT(sink_refused("signals: [{message: Command, signal: enable}], safe: {enable: 5}"),
              HasSubstr("safe.enable"));
  EXPECT_THAT(sink_refused("signals: [{message: Command, signal: enable}], safe: {}"),
              HasSubstr("needs a safe state"));
  EXPECT_THAT(
      sink_refused("signals: [{message: Turns, signal: one}, {message: Turns, signal: two}], safe: {one: 0}"),
      HasSubstr("use a second sink"));
  EXPECT_EQ(sink_refused("signals: [{message: Turns, signal: two}], safe: {two: 0}"), "was accepted");
  DeviceParts parts;
  parts.signals = model;
  const auto node_refused = [&](const std::string& text) {
    const auto made = buses.node(parts, node_of(text));
    return made ? std::string("was accepted") : made.error().text();
  };
  EXPECT_THAT(node_refused("{interface: vcan0, " + dbc + ", node: Devise}"),
              HasSubstr("did you mean Device?"));
  EXPECT_THAT(node_refused("{interface: vcan0}"), HasSubstr("candump log"));
  EXPECT_THAT(node_refused("{interface: vcan0, " + dbc + ", node: Device, bitrate: 250000, x: 1}"),
              HasSubstr("x: unknown key"));
  EXPECT_THAT(node_refused("\n{interface: vcan0, " + dbc + ", node: Device, bitrate: 250000}"),
              HasSubstr("the other nodes of vcan0"));
}

}  // namespace
}  // namespace rigor::can
