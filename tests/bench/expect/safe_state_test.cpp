// From something that went wrong to safe commands: what is in time, late, never, left again, too short, or
// not there.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "bench/expect/expectations.h"
#include "sensor-hal/record/replay_sink.h"

namespace rigor {
namespace {

using ::testing::AllOf;
using ::testing::EndsWith;
using ::testing::HasSubstr;

/// A loop of 1 kHz around the expectations of a rig, in which faults, commands and statuses come as a test
/// says. Times in ms.
class SafeStateTest : public ::testing::Test {
 protected:
  void expect(const std::string& more, const std::string& latency_ms = "10") {
    const auto root = ConfigDocument::parse(
        "channels:\n"
        "  scan: { kind: imu, backend: simulated, rate_hz: 100, latency_ms: 1 }\n"
        "  left: { kind: imu, pair: { real: { backend: can }, simulated: { backend: simulated } }, rate_hz: "
        "100 }\n"
        "sinks:\n"
        "  drive: { backend: modbus, latency_ms: " +
            latency_ms +
            ", signals: [v, w, lamp], safe: { v: 0, w: 0 } }\n"
            "  other: { backend: log, signals: [x] }\n"
            "expect:\n" +
            more,
        "rig.yaml");
    ASSERT_TRUE(root) << root.error().text();
    auto parsed = parse_rig(*root, "rig.yaml");
    ASSERT_TRUE(parsed) << parsed.error().text();
    rig = std::move(*parsed);
    auto read = Expectations::read(rig);
    ASSERT_TRUE(read) << read.error().text();
    expectations = std::move(*read);
    for (std::size_t i = 0; i < 2; ++i) {
      sinks[i] = std::make_unique<ReplaySink>(rig.sinks[i].sink.params);
      ChannelConfig config;
      config.name = rig.sinks[i].name;
      ASSERT_TRUE(sinks[i]->configure(config));
      out[i] = std::make_unique<CommandPort>(config.name, *sinks[i], rig.sinks[i].latency);
      ports.outputs[config.name] = out[i].get();
    }
    for (const char* name : {"scan", "left"}) ports.inputs[name] = {name, &description, &port};
    const auto bound = expectations->bind(ports);
    ASSERT_TRUE(bound) << bound.error().text();
    expectations->begin(at(0));
  }
  static BenchTime at(std::int64_t ms) { return BenchTime(1'000'000'000) + milliseconds(ms); }
  void command(std::int64_t ms, double v, double w = 0, double lamp = 1) {
    todo[ms].push_back([=, this] {
      Command c;
      c.t_issue = at(ms);
      c.t_effect = at(ms) + rig.sinks[0].latency;
      c.count = 3;
      c.value = {v, w, lamp};
      expectations->command(*out[0], c);
    });
  }
  void fault(std::int64_t ms, const char* of, FaultKind kind, bool begins) {
    todo[ms].push_back([=, this] { expectations->fault(of, kind, begins); });
  }
  void made_safe(std::int64_t ms) {
    todo[ms].push_back([=, this] { expectations->made_safe(*out[0], at(ms)); });
  }
  void status(std::int64_t ms, PortStatus status) {
    todo[ms].push_back([=, this] { port.obey(status, 0, at(ms)); });
  }
  /// Runs until then; what came of it.
  Expected run(std::int64_t until_ms = 1000) {
    for (std::int64_t ms = 0; ms < until_ms; ++ms) {
      for (const auto& what : todo[ms]) what();
      expectations->cycle(at(ms));
    }
    RunEnd end;
    end.extent = RunEnd::Extent::recording;
    return expectations->finish(end).front();
  }
  /// The robot drives until then, and again.
  void drives(std::int64_t safe_ms, std::int64_t again_ms = 0) {
    command(5, 1);
    command(safe_ms, 0, 0);
    if (again_ms > 0) command(again_ms, 0.5);
  }

  RigConfig rig;
  std::unique_ptr<Expectations> expectations;
  std::array<std::unique_ptr<ReplaySink>, 2> sinks;
  std::array<std::unique_ptr<CommandPort>, 2> out;
  ChannelDescription description;
  SamplePort port;
  ApplicationPorts ports;
  std::map<std::int64_t, std::vector<std::function<void()>>> todo;
};

constexpr const char* kWithin200 = "  - { of: drive, safe_after_ms: { max: 200 }, when: { fault: scan } }\n";

TEST_F(SafeStateTest, InTimeIsTheTimeUntilTheCommandTakesEffect) {
  expect(kWithin200);
  drives(390);
  fault(300, "scan", FaultKind::drop, true);
  fault(900, "scan", FaultKind::drop, false);
  command(905, 1);
  const Expected e = run();
  EXPECT_TRUE(e.holds) << e.sentence();
  EXPECT_EQ(e.looked_at, 1U);
  EXPECT_DOUBLE_EQ(e.maximum, 100) << "90 ms, and the latency of the sink";
  EXPECT_EQ(e.sentence(), "drive: expected safe_after_ms of at most 200 after a fault of scan, got 100");
}

TEST_F(SafeStateTest, TheLatencyOfTheSinkMayBeWhatIsTooLong) {
  expect(kWithin200, "100");
  drives(405);
  fault(300, "scan", FaultKind::drop, true);
  const Expected e = run();
  EXPECT_FALSE(e.holds);
  EXPECT_DOUBLE_EQ(e.maximum, 205);
  EXPECT_EQ(e.first_s, 0.5);
}

TEST_F(SafeStateTest, LateSaysByHowMuchAndSinceWhen) {
  expect(kWithin200);
  drives(631);
  fault(300, "scan", FaultKind::drop, true);
  const Expected e = run();
  EXPECT_FALSE(e.holds);
  EXPECT_EQ(
      e.sentence(),
      "drive: expected safe_after_ms of at most 200 after a fault of scan, got 341, first at 0.500 s (it "
      "began at 0.300 s; safe after 341 ms)");
}

TEST_F(SafeStateTest, NeverHasTheLengthOfTheFault) {
  expect(kWithin200);
  command(5, 1);
  fault(300, "scan", FaultKind::drop, true);
  fault(900, "scan", FaultKind::drop, false);
  command(950, 0);  // for another reason
  const Expected e = run();
  EXPECT_FALSE(e.holds);
  EXPECT_DOUBLE_EQ(e.maximum, 600);
  EXPECT_THAT(e.sentence(), EndsWith("first at 0.500 s (it began at 0.300 s; not safe before it ended)"));
}

TEST_F(SafeStateTest, OfARunThatEndsMeanwhile) {
  expect(kWithin200);
  command(5, 1);
  fault(300, "scan", FaultKind::drop, true);
  EXPECT_EQ(run(499).looked_at, 0U) << "its time was not over yet";
  const Expected e = run();
  EXPECT_FALSE(e.holds);
  EXPECT_DOUBLE_EQ(e.maximum, 699);
}

TEST_F(SafeStateTest, LeftAgainWhileTheFaultIsOnDoesNotHold) {
  expect(kWithin200);
  drives(340, 700);
  fault(300, "scan", FaultKind::drop, true);
  const Expected e = run();
  EXPECT_FALSE(e.holds);
  EXPECT_THAT(
      e.sentence(),
      EndsWith("got 50, first at 0.710 s (it began at 0.300 s; safe after 50 ms, but not from 0.710 s on)"));
}

TEST_F(SafeStateTest, WhatIsLeftAndTakenAgainInTimeCountsFromTheLastTime) {
  expect(kWithin200);
  drives(310, 350);
  command(400, 0);
  fault(300, "scan", FaultKind::drop, true);
  const Expected e = run();
  EXPECT_TRUE(e.holds) << e.sentence();
  EXPECT_DOUBLE_EQ(e.maximum, 110);
}

TEST_F(SafeStateTest, ASafeCommandHasEveryValueOfSafeAndNoOther) {
  expect(kWithin200);
  command(5, 1, 1);
  command(320, 0, 1);
  command(380, 0, 0, 7);  // the lamp is not among them
  fault(300, "scan", FaultKind::drop, true);
  EXPECT_DOUBLE_EQ(run().maximum, 90);
}

TEST_F(SafeStateTest, IsSafeBeforeTheFirstCommandAndWhereItWasSafeAlready) {
  expect(kWithin200);
  fault(300, "scan", FaultKind::drop, true);
  const Expected e = run();
  EXPECT_TRUE(e.holds);
  EXPECT_DOUBLE_EQ(e.maximum, 0);
}

TEST_F(SafeStateTest, ThatNobodyCommandsCountsToo) {
  expect(kWithin200);
  command(5, 1);
  fault(300, "scan", FaultKind::drop, true);
  made_safe(420);
  const Expected e = run();
  EXPECT_TRUE(e.holds) << e.sentence();
  EXPECT_DOUBLE_EQ(e.maximum, 120);
}

TEST_F(SafeStateTest, NoFaultIsNoTest) {
  expect(kWithin200);
  drives(400);
  fault(300, "left.real", FaultKind::drop, true);
  const Expected e = run();
  EXPECT_FALSE(e.holds);
  EXPECT_THAT(e.sentence(), EndsWith("no such fault came: nothing was tested"));
}

TEST_F(SafeStateTest, OneThatIsOverSoonerAsksForNothing) {
  expect(kWithin200);
  command(5, 1);
  for (std::int64_t ms : {300, 400, 500}) {
    fault(ms, "scan", FaultKind::drop, true);
    fault(ms + 50, "scan", FaultKind::drop, false);
  }
  const Expected e = run();
  EXPECT_FALSE(e.holds);
  EXPECT_THAT(e.sentence(), EndsWith("what came (3 times) was over before that: nothing was tested"));
  // But one in which the commands became safe is judged, and one in which they were.
  expect(kWithin200);
  command(410, 0);
  EXPECT_EQ(run().looked_at, 2U);
}

TEST_F(SafeStateTest, EachFaultIsJudgedAndThoseThatOverlapAsOne) {
  expect(kWithin200);
  command(5, 1);
  fault(100, "scan", FaultKind::drop, true);
  command(120, 0);
  fault(150, "scan", FaultKind::delay, true);  // overlaps
  fault(400, "scan", FaultKind::drop, false);
  fault(500, "scan", FaultKind::delay, false);
  command(510, 1);
  fault(600, "scan", FaultKind::drop, true);
  const Expected e = run();
  EXPECT_EQ(e.looked_at, 2U);
  EXPECT_EQ(e.outside, 1U);
  EXPECT_DOUBLE_EQ(e.minimum, 30);
  EXPECT_DOUBLE_EQ(e.maximum, 399);
  EXPECT_EQ(e.first_s, 0.8);
}

TEST_F(SafeStateTest, AKindASideAndAWindowAreTakenAlone) {
  expect(
      "  - { of: drive, safe_after_ms: { max: 100 }, when: { fault: left.real, kind: disconnect }, from_s: "
      "0.2, until_s: 0.6 }\n");
  command(5, 1);
  fault(10, "left.real", FaultKind::disconnect, true);  // before the window
  fault(190, "left.real", FaultKind::disconnect, false);
  fault(210, "left.real", FaultKind::drop, true);             // another kind
  fault(220, "left.simulated", FaultKind::disconnect, true);  // another side
  fault(400, "left.real", FaultKind::disconnect, true);
  command(450, 0);
  fault(700, "left.real", FaultKind::disconnect, false);
  command(720, 1);
  fault(750, "left.real", FaultKind::disconnect, true);  // after it
  const Expected e = run();
  EXPECT_TRUE(e.holds) << e.sentence();
  EXPECT_EQ(e.looked_at, 1U);
  EXPECT_DOUBLE_EQ(e.maximum, 60);
  EXPECT_EQ(e.bounds, "of at most 100 after disconnect of left.real from 0.2 to 0.6 s");
}

TEST_F(SafeStateTest, OfAPairEitherSidesFaults) {
  expect("  - { of: drive, safe_after_ms: { max: 100 }, when: { fault: left } }\n");
  drives(330);
  fault(300, "left.real", FaultKind::drop, true);
  EXPECT_DOUBLE_EQ(run().maximum, 40);
}

TEST_F(SafeStateTest, WhenAChannelIsOverdueOrDisconnected) {
  for (const auto& [is, expected_ms] : {std::pair("overdue", 60.0), std::pair("disconnected", 30.0)}) {
    todo.clear();
    port = {};
    expect("  - { of: drive, safe_after_ms: { max: 100 }, when: { channel: scan, is: " + std::string(is) +
           " } }\n");
    drives(350);
    status(300, PortStatus::overdue);
    status(330, PortStatus::disconnected);
    const Expected e = run();
    EXPECT_TRUE(e.holds) << e.sentence();
    EXPECT_DOUBLE_EQ(e.maximum, expected_ms) << is;
  }
  todo.clear();
  port = {};
  expect("  - { of: drive, safe_after_ms: { max: 100 }, when: { channel: scan, is: disconnected } }\n");
  EXPECT_THAT(run().sentence(), AllOf(HasSubstr("when scan is disconnected"),
                                      EndsWith("it never was disconnected: nothing was tested")));
}

TEST_F(SafeStateTest, WhileTheRunGoesOnItIsOpenUntilItsTimeIsOver) {
  expect(kWithin200);
  drives(700);
  fault(300, "scan", FaultKind::drop, true);
  RunEnd known;
  known.extent = RunEnd::Extent::so_far;
  const auto at_ms = [&](std::int64_t ms) {
    expectations->begin(at(0));
    (void)run(ms);
    expectations->show();
    return expectations->so_far(known).front();
  };
  EXPECT_STREQ(at_ms(250).state(), "undecided");
  EXPECT_EQ(at_ms(250).outcome(), "no such fault so far");
  EXPECT_STREQ(at_ms(450).state(), "undecided");
  EXPECT_EQ(at_ms(450).outcome(), "nothing so far");
  EXPECT_STREQ(at_ms(600).state(), "violated");
  EXPECT_EQ(at_ms(600).outcome(), "got 299, first at 0.500 s (it began at 0.300 s; not safe yet)");
  EXPECT_EQ(at_ms(800).outcome(), "got 410, first at 0.500 s (it began at 0.300 s; safe after 410 ms)");
}

TEST_F(SafeStateTest, WhatCannotBeJudgedIsRefused) {
  const auto refused = [&](const std::string& entry, const char* what) {
    expect("  - { of: other.x, value: { max: 1 } }\n");  // a rig
    const auto node = ConfigDocument::parse("expect: [" + entry + "]", "rig.yaml");
    ASSERT_TRUE(node);
    rig.expect = node->list("expect");
    const auto read = Expectations::read(rig);
    ASSERT_FALSE(read) << entry;
    EXPECT_THAT(read.error().text(), AllOf(HasSubstr("rig.yaml:1:"), HasSubstr(what)));
  };
  refused("{ of: drive, safe_after_ms: { max: 1 } }", "expected `when:` beside it");
  refused("{ of: drive, when: { fault: scan } }", "safe_after_ms");
  refused("{ of: drive, safe_after_ms: { min: 1 }, when: { fault: scan } }", "{ max: MILLISECONDS } alone");
  refused("{ of: scan, safe_after_ms: { max: 1 }, when: { fault: scan } }", "expected a sink");
  refused("{ of: other, safe_after_ms: { max: 1 }, when: { fault: scan } }", "`safe:` values");
  refused("{ of: drive, safe_after_ms: { max: 1 }, when: { fault: scam } }", "did you mean scan?");
  refused("{ of: drive, safe_after_ms: { max: 1 }, when: { fault: scan, kind: dropp } }", "drop");
  refused("{ of: drive, safe_after_ms: { max: 1 }, when: { channel: scan, is: lost } }",
          "overdue, disconnected, got lost; now called disconnected");
  refused("{ of: drive, safe_after_ms: { max: 1 }, when: { channel: left.real, is: overdue } }", "left.real");
  refused("{ of: drive, safe_after_ms: { max: 1 }, when: { fault: scan, is: overdue } }", "is");
}

}  // namespace
}  // namespace rigor
