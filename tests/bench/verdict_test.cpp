// The verdict on runs that are described here and not run.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "bench/result/verdict_forms.h"

namespace rigor {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

ChannelFacts channel(const std::string& name, double rate_hz, double duration_s, double latency_s = 0.06) {
  ChannelFacts c;
  c.name = name;
  c.period = seconds_from(1 / rate_hz);
  c.latency = seconds_from(latency_s);
  c.due = samples_due(seconds_from(duration_s) - milliseconds(1), c.period, c.latency);
  c.delivered = *c.due;
  c.last_s = duration_s - latency_s;
  return c;
}
RunFacts run_of(std::vector<ChannelFacts> channels) {
  RunFacts run;
  run.cycles = 10000;
  run.channels = std::move(channels);
  return run;
}
/// The only finding.
Finding only(const Verdict& v) {
  EXPECT_EQ(v.findings.size(), 1u) << verdict_text(verdict_json(v));
  return v.findings.empty() ? Finding{} : v.findings.front();
}

TEST(SamplesDue, AreThoseWhoseReleaseLiesInTheRun) {
  EXPECT_EQ(samples_due(milliseconds(14999), milliseconds(20), milliseconds(0)), 750u);
  EXPECT_EQ(samples_due(milliseconds(14999), milliseconds(20), milliseconds(20)), 749u);
  EXPECT_EQ(samples_due(milliseconds(59), milliseconds(40), milliseconds(60)), 0u);
  EXPECT_EQ(samples_due(milliseconds(60), milliseconds(40), milliseconds(60)), 1u);
  EXPECT_EQ(samples_due(milliseconds(60), Duration(0), milliseconds(60)), std::nullopt);
}

TEST(Verdict, OfARunThatGotWhatWasDueIsGood) {
  ChannelFacts free_running = channel("left", 25, 10);
  free_running.delivered -= 2;  // its first and last lie outside
  RunFacts run = run_of({channel("right", 25, 10), free_running});
  run.misses = 3;
  const Verdict v = judge(run);
  EXPECT_EQ(v.worst(), Severity::note);
  EXPECT_THAT(only(v).text(), HasSubstr("3 of 10000 cycles"));
  EXPECT_EQ(verdict_json(v)["state"], "good");
  EXPECT_THAT(verdict_text(verdict_json(v)), testing::StartsWith("verdict   good"));
}

TEST(Verdict, OfADeviceThatDiedSaysHowManyOfThoseDueCameAndSinceWhen) {
  ChannelFacts c = channel("scan", 50, 15, 0);
  c.delivered = 224;
  c.silent = true;
  c.last_s = 4.48;
  EXPECT_NEAR(c.rate_hz(), 14.93, 0.01);
  EXPECT_EQ(c.missing(), 526u) << "although its sequence has no gap";
  const Finding f = only(judge(run_of({c})));
  EXPECT_EQ(f.severity, Severity::bad);
  EXPECT_THAT(f.text(), AllOf(HasSubstr("scan: 224 of 750 samples"), HasSubstr("silent since 4.5 s")));
  EXPECT_THAT(f.kinds.names(), ElementsAre("lost", "silent"));
}

TEST(Verdict, OfADeviceThatNeverCameSaysSo) {
  ChannelFacts c = channel("scan", 10, 15);
  c.delivered = 0, c.silent = true, c.last_s = std::nullopt;
  EXPECT_THAT(only(judge(run_of({c}))).text(), HasSubstr("scan: none of 150 samples came"));
}

TEST(Verdict, OfADeviceThatWasAwayForAWhileSaysForHowLong) {
  ChannelFacts c = channel("left", 25, 10);
  c.delivered -= 40, c.lost = 40, c.gone_s = 1.6;
  const Finding f = only(judge(run_of({c})));
  EXPECT_THAT(f.text(), HasSubstr("disconnected or silent for 1.6 s"));
  EXPECT_EQ(f.severity, Severity::bad);
}

TEST(Verdict, OfPicturesThatTakeLongerThanTheirPeriodNamesARateThatCanBeKept) {
  ChannelFacts c = channel("right", 25, 10);
  c.noun = "pictures", c.capture = milliseconds(64);
  c.delivered = 109, c.late = 97, c.lost = 140;
  const Finding f = only(judge(run_of({c})));
  EXPECT_THAT(f.sentence, AllOf(HasSubstr("right: 109 of 249 pictures, 97 of them late"),
                                HasSubstr("a picture takes 64.0 ms of its 40.0 ms period")));
  EXPECT_THAT(f.cure, HasSubstr("`--clock virtual` or `--set channels.right.rate_hz=10`"));
  EXPECT_THAT(f.kinds.names(), ElementsAre("lost", "late"));

  // Two of them share one worker: neither keeps 10 Hz.
  ChannelFacts other = c;
  other.name = "top";
  EXPECT_THAT(judge(run_of({c, other})).findings[0].cure, HasSubstr("channels.right.rate_hz=5`"));
  RunFacts two = run_of({c, other});
  two.workers = 2;
  EXPECT_THAT(judge(two).findings[0].cure, HasSubstr("channels.right.rate_hz=10`"));
}

TEST(Verdict, OfPicturesThatAreReadyAfterTheirReleaseNamesALatencyThatWouldDo) {
  ChannelFacts c = channel("right", 5, 10);
  c.noun = "pictures", c.capture = milliseconds(70), c.late = 40;
  EXPECT_THAT(only(judge(run_of({c}))).text(),
              AllOf(HasSubstr("a picture takes 70.0 ms and is due after 60.0 ms"),
                    HasSubstr("channels.right.latency_ms=110")));
}

TEST(Verdict, DoesNotBlameTheMachineForWhatInjectedFaultsTook) {
  ChannelFacts c = channel("right", 25, 10);
  c.capture = milliseconds(64), c.lost = 50, c.delivered -= 50, c.by_faults = 50;
  EXPECT_THAT(only(judge(run_of({c}))).text(),
              AllOf(HasSubstr("injected faults took 50 of them"), Not(HasSubstr("period"))));
}

TEST(Verdict, OfAPairOfWhichNothingWasComparedSaysSo) {
  ChannelFacts c = channel("left", 25, 10);
  c.pair = PairFacts{.compared = 0, .real_missing = 3, .simulated_missing = 249};
  const Finding none = only(judge(run_of({c})));
  EXPECT_EQ(none.severity, Severity::bad);
  EXPECT_THAT(none.text(),
              AllOf(HasSubstr("left: not one of 249 pairs was compared"), HasSubstr("249 of the simulated")));
  c.pair->compared = 67;
  EXPECT_THAT(only(judge(run_of({c}))).text(), HasSubstr("67 of 249 pairs compared"));
  c.pair->compared = 240;
  EXPECT_TRUE(judge(run_of({c})).findings.empty());
}

TEST(Verdict, HasTheWorstFirstAndAnAlarmWithItsInstant) {
  ChannelFacts late = channel("right", 25, 10), alarmed = channel("left", 25, 10);
  late.late = 1;
  alarmed.pair = PairFacts{.compared = *alarmed.due, .alarm_s = 5.4, .alarm_text = "gain has changed"};
  const Verdict v = judge(run_of({late, alarmed}));
  ASSERT_EQ(v.findings.size(), 2u);
  EXPECT_THAT(v.findings[0].text(), HasSubstr("left: alarm at 5.4 s: gain has changed"));
  EXPECT_EQ(v.findings[1].severity, Severity::note);
  EXPECT_EQ(verdict_json(v)["state"], "bad");
}

TEST(Verdict, NamesTheDeathOfTheRunsOwnEmulatorsFirstAndGivesNoOtherCure) {
  ChannelFacts c = channel("scan", 50, 15);
  c.delivered = 224, c.silent = true, c.last_s = 4.5;
  RunFacts run = run_of({c});
  run.emulators = "emulators: their process 42 died 4.5 s into the run (signal 9, Killed)";
  const Verdict v = judge(run);
  ASSERT_EQ(v.findings.size(), 2u);
  EXPECT_THAT(v.findings[0].kinds.names(), ElementsAre("emulator"));
  EXPECT_EQ(v.findings[1].cure, "");
}

TEST(Verdict, CountsCommandsThatFailedAndCyclesThatWereSkipped) {
  RunFacts run = run_of({});
  run.skipped = 900;
  run.sinks = {{"table", 200, 0, 12, 3}};
  const Verdict v = judge(run);
  ASSERT_EQ(v.findings.size(), 2u);
  EXPECT_THAT(v.findings[0].text(), HasSubstr("table: of 203 commands 12 failed, 3 found no place"));
  EXPECT_THAT(v.findings[1].text(), HasSubstr("900 of 10900 cycles were skipped"));
}

TEST(FailOn, FindsWhatWasAskedForAndNothingElse) {
  ChannelFacts c = channel("scan", 50, 15);
  c.delivered = 224, c.silent = true;
  const Verdict v = judge(run_of({c}));
  EXPECT_THAT(v.found(*findings_named({"late", "lost", "alarm"})).names(), ElementsAre("lost"));
  EXPECT_TRUE(v.found(*findings_named({"late", "alarm"})).empty());
}

TEST(FailOn, RefusesAnUnknownNameWithTheListOfThoseThatThereAre) {
  const auto set = findings_named({"lost", "lats"});
  ASSERT_FALSE(set);
  EXPECT_EQ(set.error().exit_status(), 2);
  EXPECT_THAT(set.error().text(), AllOf(HasSubstr("--fail-on"), HasSubstr("lost, late, silent, emulator"),
                                        HasSubstr("got \"lats\""), HasSubstr("did you mean late?")));
  EXPECT_FALSE(findings_named({""}));
  for (std::size_t i = 0; i < kFindingKinds; ++i)
    EXPECT_TRUE(findings_named({name_of(static_cast<FindingKind>(i))})) << i;
}

TEST(Verdict, NamesWhatABridgeLostAndWhomItCouldNotMatch) {
  RunFacts run = run_of({});
  BridgeFacts& bridge = run.bridges.emplace_back();
  bridge.name = "ros2";
  bridge.messages = 1000;
  bridge.dropped = 5;
  Verdict v = judge(run);
  EXPECT_EQ(v.worst(), Severity::note);
  EXPECT_THAT(v.findings.at(0).sentence, HasSubstr("bridge ros2: of 1000 messages 5 were dropped"));
  bridge.dropped = 10;
  bridge.commands = 40;
  bridge.rejected = 2;
  bridge.last_rejection = "/cmd_vel: expected v from -1 to 1, got 7";
  bridge.problems = {"/imu/imu: 1 of 1 subscribers asked for another RELIABILITY"};
  v = judge(run);
  ASSERT_EQ(v.findings.size(), 3u);
  for (const Finding& f : v.findings) EXPECT_EQ(f.severity, Severity::warning) << f.sentence;
  EXPECT_THAT(
      v.findings[1].sentence,
      HasSubstr("2 of 40 commands were rejected, the last: /cmd_vel: expected v from -1 to 1, got 7"));
  EXPECT_THAT(v.findings[2].sentence, HasSubstr("another RELIABILITY"));
  EXPECT_FALSE(v.found(*findings_named({"bridge"})).empty());
}

TEST(Verdict, InAReportMarksWhatIsToBeTypedAndEscapesTheRest) {
  RunFacts run = run_of({});
  run.warnings = {"clock <b> did not settle; use `rigor doctor`"};
  const std::string html = verdict_section(verdict_json(judge(run)));
  EXPECT_THAT(html, HasSubstr("clock &lt;b&gt; did not settle; use <code>rigor doctor</code>"));
  EXPECT_THAT(html, HasSubstr("class=\"verdict warning\""));
}

}  // namespace
}  // namespace rigor
