// Parts of sweeps, without a run: which runs there are, what a row holds, what the table and the statistics
// say.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <csignal>
#include <nlohmann/json.hpp>
#include <set>

#include "bench/sweep/slurm.h"
#include "bench/sweep/statistics.h"
#include "bench/sweep/sweep.h"
#include "bench/sweep/sweep_table.h"
#include "rt-core/numbers.h"
#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using namespace sweep;
using nlohmann::json;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr const char* kRig = R"(
seed: 7
duration_s: 1
clock: virtual
loop: { rate_hz: 100 }
channels:
  wave: { kind: registers, backend: simulated, rate_hz: 50, signals: { x: { sine: { amplitude: 2, period_s: 0.7 } } } }
)";

class SweepPlans : public ::testing::Test {
 protected:
  SweepPlans() { write_file(dir / "rig.yaml", kRig); }
  [[nodiscard]] Result<SweepPlan> plan(const std::vector<std::string>& vary, std::uint64_t seeds = 0,
                                       std::uint64_t samples = 0, std::uint64_t draw_seed = 1) const {
    SweepOptions o;
    o.rig = dir / "rig.yaml";
    for (const std::string& text : vary) {
      auto p = SweepParameter::parse(text);
      if (!p) return tl::unexpected<Error>(p.error());
      o.vary.push_back(*p);
    }
    o.seeds = seeds;
    o.samples = samples;
    o.draw_seed = draw_seed;
    return SweepPlan::create(o);
  }
  TempDir dir;
};

TEST_F(SweepPlans, HaveAllCombinationsTheLastKeyAndTheSeedChangeFastest) {
  const auto p = plan({"loop.rate_hz=100..200:3", "channels.wave.rate_hz=10,50"}, 2);
  ASSERT_TRUE(p) << p.error().text();
  ASSERT_EQ(p->size(), 12U);
  EXPECT_THAT(p->run(0).values, ElementsAre("100", "10"));
  EXPECT_EQ(p->run(0).seed, 7U) << "the rig's own";
  EXPECT_THAT(p->run(1).values, ElementsAre("100", "10"));
  EXPECT_EQ(p->run(1).seed, 8U);
  EXPECT_THAT(p->run(2).values, ElementsAre("100", "50"));
  EXPECT_THAT(p->run(11).values, ElementsAre("200", "50"));
  std::set<std::vector<std::string>> different;
  for (std::uint64_t i = 0; i < p->size(); ++i) different.insert(p->run(i).values);
  EXPECT_EQ(different.size(), 6U);
}

TEST_F(SweepPlans, OfASingleRunAreTheRigAsItIs) {
  const auto p = plan({});
  ASSERT_TRUE(p) << p.error().text();
  EXPECT_EQ(p->size(), 1U);
  EXPECT_EQ(p->run(0).seed, 7U);
}

TEST_F(SweepPlans, OfSamplesHaveOneInEachOfNEqualParts) {
  constexpr std::uint64_t kSamples = 50;
  const auto p =
      plan({"loop.rate_hz=100..200", "channels.wave.signals.x.sine.amplitude=log:1..1000"}, 0, kSamples);
  ASSERT_TRUE(p) << p.error().text();
  ASSERT_EQ(p->size(), kSamples);
  std::set<int> evenly, logarithmically;
  for (std::uint64_t i = 0; i < kSamples; ++i) {
    const SweepRun run = p->run(i);
    evenly.insert(static_cast<int>(std::floor((std::stod(run.values[0]) - 100) / 100 * kSamples)));
    logarithmically.insert(static_cast<int>(std::floor(std::log10(std::stod(run.values[1])) / 3 * kSamples)));
  }
  EXPECT_EQ(evenly.size(), kSamples);
  EXPECT_EQ(logarithmically.size(), kSamples);
  EXPECT_EQ(p->run(9).values,
            plan({"loop.rate_hz=100..200", "channels.wave.signals.x.sine.amplitude=log:1..1000"}, 0, kSamples)
                ->run(9)
                .values);
  EXPECT_NE(
      p->run(9).values,
      plan({"loop.rate_hz=100..200", "channels.wave.signals.x.sine.amplitude=log:1..1000"}, 0, kSamples, 2)
          ->run(9)
          .values);
}

TEST_F(SweepPlans, ComeBackFromTheirManifests) {
  const auto p = plan({"loop.rate_hz=100..200"}, 3, 5, 9);
  ASSERT_TRUE(p) << p.error().text();
  const auto again = SweepPlan::from_manifest(json::parse(p->manifest().dump()), "sweep.json");
  ASSERT_TRUE(again) << again.error().text();
  ASSERT_EQ(again->size(), p->size());
  for (std::uint64_t i = 0; i < p->size(); ++i) {
    EXPECT_EQ(again->run(i).values, p->run(i).values);
    EXPECT_EQ(again->child_command(again->run(i)), p->child_command(p->run(i)));
  }
  EXPECT_EQ(again->manifest(), p->manifest());
  for (const char* key : {"format", "vary", "runs", "rig"}) {
    json broken = p->manifest();
    broken[key] = 3;
    EXPECT_FALSE(SweepPlan::from_manifest(broken, "sweep.json")) << key;
    broken.erase(key);
    EXPECT_FALSE(SweepPlan::from_manifest(broken, "sweep.json")) << key;
  }
}

TEST(SweepParameters, TakeListsStepsAndPaths) {
  const auto words = [](const std::string& text) {
    const auto p = SweepParameter::parse(text);
    EXPECT_TRUE(p) << text;
    return p ? p->listed() : std::vector<std::string>{};
  };
  EXPECT_THAT(words("a.b=1000..8000:8"),
              ElementsAre("1000", "2000", "3000", "4000", "5000", "6000", "7000", "8000"));
  EXPECT_THAT(words("a=0..1:6"), ElementsAre("0", "0.2", "0.4", "0.6", "0.8", "1"));
  EXPECT_THAT(words("a=log:1..1000:4"), ElementsAre("1", "10", "100", "1000"));
  EXPECT_THAT(words("a=../x.yaml,../y.yaml"), ElementsAre("../x.yaml", "../y.yaml"));
  EXPECT_THAT(words("a=[1, 2],{x: 1, y: 2}"), ElementsAre("[1, 2]", "{x: 1, y: 2}"));
  for (const char* text :
       {"a", "a=", "=1", "a..b=1", "a=1..2:1", "a=1..2:x", "a=1..2:2.5", "a=2..1:3", "a=1,1", "seed=1,2"})
    EXPECT_FALSE(SweepParameter::parse(text)) << text;
}

ChildEnd ended(int status, const std::string& out, const std::string& err = "") {
  ChildEnd end;
  end.status = status;
  end.out = out;
  end.err = err;
  return end;
}

constexpr const char* kReport = R"({
  "verdict": {"state": "good"}, "loop": {"reason": "finished"}, "input_sha256": "abc",
  "channels": [{"name": "wave", "rate_hz": 49.5, "delivered": 49, "missing": 1, "age": {"count": 3, "p50_ns": 10000000,
                "p99_ns": 11000000, "max_ns": 12000000}}],
  "sinks": [], "analyses": {"localization": {"median_m": 0.5, "median_yaw_deg": null, "text": "left out", "list": [1]}},
  "expect": [{"of": "wave.x", "quantity": "value", "bounds": "of at most 3", "state": "holds", "looked_at": 4,
              "outside": 0, "minimum": -2, "maximum": 2}]})";

TEST(SweepRows, HoldTheNumbersOfAReport) {
  const auto row = row_of(3, ended(0, kReport));
  ASSERT_TRUE(row) << row.error().text();
  EXPECT_EQ(row->status, "passed");
  EXPECT_EQ(row->metrics.at("wave rate_hz"), 49.5);
  EXPECT_EQ(row->metrics.at("wave age_p99_ms"), 11);
  EXPECT_EQ(row->metrics.at("localization median_m"), 0.5);
  EXPECT_TRUE(std::isnan(row->metrics.at("localization median_yaw_deg")));
  EXPECT_EQ(row->metrics.at("wave.x value of at most 3: most"), 2);
  EXPECT_FALSE(row->metrics.contains("localization text"));
  const auto again = row_from_json(json::parse(to_json(*row).dump()));
  ASSERT_TRUE(again);
  EXPECT_EQ(to_json(*again), to_json(*row));
  EXPECT_TRUE(std::isnan(again->metrics.at("localization median_yaw_deg")));
}

TEST(SweepRows, SayWhyARunDidNotPass) {
  json report = json::parse(kReport);
  report["expect"][0]["state"] = "violated";
  const auto failed = row_of(
      0, ended(1, report.dump(), "rigor: warning: slow\nrigor: not as expected: wave.x: too much\nelse\n"));
  ASSERT_TRUE(failed);
  EXPECT_EQ(failed->status, "failed");
  EXPECT_EQ(failed->reason, "not as expected: wave.x: too much");

  const auto refused =
      row_of(0, ended(2, R"({"error": "no", "exit_status": 2})", "rigor: rig.yaml:3:1: no\n"));
  ASSERT_TRUE(refused);
  EXPECT_EQ(refused->status, "error");
  EXPECT_EQ(refused->reason, "rig.yaml:3:1: no");

  ChildEnd crash;
  crash.how = ChildEnd::How::killed;
  crash.status = SIGSEGV;
  EXPECT_EQ(row_of(0, crash)->reason, "signal 11, Segmentation fault");
  EXPECT_EQ(row_of(0, ended(127, ""))->reason, "exit status 127, without a report");
}

TEST(SweepRows, AreNotMadeOfWhatTheMachineBrokeOff) {
  EXPECT_EQ(row_of(0, ended(1, "", "rigor: x: no space is left to write this file\n")).error().code,
            ErrorCode::disk_full);
  json report = json::parse(kReport);
  report["loop"]["reason"] = "interrupted by a signal";
  EXPECT_EQ(row_of(0, ended(0, report.dump())).error().code, ErrorCode::unavailable);
  ChildEnd stopped;
  stopped.how = ChildEnd::How::stopped;
  EXPECT_EQ(row_of(0, stopped).error().code, ErrorCode::unavailable);
}

TEST_F(SweepPlans, MakeATableWithEmptyCellsAndNaN) {
  write_file(dir / "rig.yaml", kRig);
  const auto p = plan({R"(loop.rate_hz=100,200,250)"}, 0);
  ASSERT_TRUE(p) << p.error().text();
  std::vector<std::optional<Row>> rows(3);
  rows[0] = Row{0, "passed", "", "good", "ab", {{"x holds", "holds", 0, 0}}, {{"m", 0.1}, {"n", kNaN}}, 1.5};
  rows[1] = Row{1, "crashed", "signal 11, \"Segmentation fault\"", "", "", {}, {}, 2.5};
  EXPECT_EQ(table_text(*p, rows),
            "run,loop.rate_hz,seed,status,reason,verdict,input_sha256,expect x holds,m,n\r\n"
            "0,100,7,passed,,good,ab,holds,0.1,nan\r\n"
            "1,200,7,crashed,\"signal 11, \"\"Segmentation fault\"\"\",,,,,\r\n"
            "2,250,7,not run,,,,,,\r\n");
  const std::string page = report_page(*p, rows);
  EXPECT_THAT(page, HasSubstr("1 of 3 runs passed, 1 crashed, 1 not run"));
  EXPECT_THAT(page, HasSubstr("--set loop.rate_hz=200"));
}

// Reference values: R 4.2, t.test and quantile(type = 7).
TEST(SweepStatistics, AreThoseOfTextbooks) {
  const Summary s = summarize({1, 2, kNaN, 3, 4, 5});
  EXPECT_EQ(s.count, 5U);
  EXPECT_DOUBLE_EQ(s.mean, 3);
  EXPECT_NEAR(s.sd, 1.58113883, 1e-8);
  EXPECT_NEAR(s.mean95.from, 1.03675684, 1e-7);
  EXPECT_NEAR(s.mean95.to, 4.96324316, 1e-7);
  EXPECT_DOUBLE_EQ(s.p05, 1.2);
  EXPECT_DOUBLE_EQ(s.p50, 3);
  const Summary one = summarize({4});
  EXPECT_EQ(one.mean, 4);
  EXPECT_TRUE(std::isnan(one.sd) && std::isnan(one.mean95.from));
  EXPECT_TRUE(std::isnan(summarize({kNaN}).mean));
}

// Wilson's interval of 8 of 10, and of 0 of 10, as Newcombe (1998) computes it.
TEST(SweepStatistics, GiveSharesTheirIntervals) {
  EXPECT_NEAR(wilson95(8, 10).from, 0.4901625, 1e-6);
  EXPECT_NEAR(wilson95(8, 10).to, 0.9433178, 1e-6);
  EXPECT_NEAR(wilson95(0, 10).from, 0, 1e-12);
  EXPECT_NEAR(wilson95(0, 10).to, 0.2775328, 1e-6);
  EXPECT_NEAR(wilson95(10, 10).to, 1, 1e-12);
}

TEST(SweepStatistics, SayWhatAParameterExplains) {
  EXPECT_DOUBLE_EQ(explained_share({{1, 2}, {3, 4}}), 0.7);  // 1 − (1/2) / (5/3)
  EXPECT_DOUBLE_EQ(explained_share({{1, 1}, {2, 2}}), 1);
  EXPECT_DOUBLE_EQ(explained_share({{1, 2}, {1, 2}}), 0);
  EXPECT_TRUE(std::isnan(explained_share({{1, 2}})));
  EXPECT_TRUE(std::isnan(explained_share({{1}, {2}})));
  EXPECT_TRUE(std::isnan(explained_share({{1, 1}, {1, 1}})));
}

TEST(SweepArrays, NameIndicesInRanges) {
  EXPECT_EQ(index_ranges({}), "");
  EXPECT_EQ(index_ranges({0, 1, 2, 4, 7, 8}), "0-2,4,7-8");
}

}  // namespace
}  // namespace rigor::test
