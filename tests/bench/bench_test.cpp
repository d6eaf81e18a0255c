// The bench as a library: what may be called when, cycle by cycle, several at once.
#include "bench/bench.h"

#include <gmock/gmock.h>

#include <thread>

#include "bench/run/replay_assembly.h"
#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using ::testing::HasSubstr;

/// Four values a second of a formula, by the rig's own clock.
class Counting final : public Source {
 public:
  void complete_until(BenchTime now) override {
    for (; t_next_ <= now; t_next_ = t_next_ + milliseconds(10)) waiting_ = true;
  }
  SampleLease poll(BenchTime now) noexcept override {
    if (!waiting_) return {};
    waiting_ = false;
    SampleSlot slot = pool_.try_acquire();
    if (!slot) return {};
    Sample& s = *slot;
    s.stamp = {};
    s.stamp.sequence = n_;
    s.stamp.t_capture = s.stamp.t_release = s.stamp.t_arrival = now;
    RegisterBlock block;
    block.count = 1;
    block.value[0] = static_cast<double>(n_++);
    s.info = block;
    return slot;
  }

 private:
  Status do_configure(const ChannelConfig&) override {
    description_.kind = SampleKind::register_block;
    description_.names = {"n"};
    description_.units = {""};
    return {};
  }
  Status do_arm(const ArmContext&) override { return {}; }
  Status do_start(BenchTime t0) override {
    t_next_ = t0;
    n_ = 0;
    health_.connected = true;
    return {};
  }
  Status do_stop() override { return {}; }
  SamplePool pool_{16};
  BenchTime t_next_;
  bool waiting_ = false;
  std::uint64_t n_ = 0;
};

struct BenchTest : ::testing::Test {
  TempDir dir;

  Result<std::unique_ptr<Bench>> create(const std::string& more = "", BenchOptions options = {}) {
    const std::filesystem::path file = dir / "rig.yaml";
    write_file(file,
               "name: counted\nclock: virtual\nduration_s: 1\nloop: { rate_hz: 100 }\n"
               "channels:\n  count: { kind: registers, backend: counting, rate_hz: 100, latency_ms: 0 }\n" +
                   more);
    auto rig = load_rig(file, {});
    if (!rig) return tl::unexpected<Error>(rig.error());
    Registry registry = make_registry();
    Backend backend;
    backend.name = "counting";
    backend.reads_recording = [](const ConfigNode&) { return true; };  // serves in virtual time itself
    backend.make_source = [] { return std::make_unique<Counting>(); };
    registry.add(std::move(backend));
    return Bench::create(std::move(*rig), registry, std::move(options));
  }
  static ErrorCode code_of(const auto& result) { return result ? ErrorCode::internal : result.error().code; }
};

TEST_F(BenchTest, RunsWhatItIsPreparedForOnce) {
  const auto bench = create("expect: [{ of: count.n, value: { min: 0, max: 99 } }]\n");
  ASSERT_TRUE(bench) << bench.error().text();
  EXPECT_EQ(code_of((*bench)->run()), ErrorCode::wrong_state) << "not prepared";
  ASSERT_TRUE((*bench)->prepare());
  EXPECT_EQ(code_of((*bench)->prepare()), ErrorCode::wrong_state);
  const auto report = (*bench)->run();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_TRUE(report->passed()) << report->text();
  EXPECT_EQ(report->facts.channels.at(0).delivered, 100u);
  EXPECT_EQ(report->expected.at(0).looked_at, 100u);
  EXPECT_THAT(report->json(), HasSubstr(report->outcome.input_sha256));
  EXPECT_EQ(code_of((*bench)->run()), ErrorCode::wrong_state);
  EXPECT_EQ(code_of((*bench)->step()), ErrorCode::wrong_state);
  EXPECT_EQ(code_of((*bench)->finish()), ErrorCode::wrong_state);
}

TEST_F(BenchTest, IsSteppedToTheSameEndAsARunInOne) {
  const auto whole = create();
  ASSERT_TRUE(whole && (*whole)->prepare());
  const auto expected = (*whole)->run();
  ASSERT_TRUE(expected) << expected.error().text();

  const auto bench = create();
  ASSERT_TRUE(bench);
  EXPECT_EQ(code_of((*bench)->start()), ErrorCode::wrong_state) << "not prepared";
  ASSERT_TRUE((*bench)->prepare());
  EXPECT_EQ(code_of((*bench)->step()), ErrorCode::wrong_state) << "not started";
  ASSERT_TRUE((*bench)->start());
  const SamplePort& port = *(*bench)->ports().inputs.at("count").port;
  for (int i = 1; i < 100; ++i) {
    const auto more = (*bench)->step();
    ASSERT_TRUE(more && *more) << i;
    ASSERT_TRUE(port.sample());
    EXPECT_EQ(port.sample()->as<RegisterBlock>()->value[0], i - 1);
  }
  const auto more = (*bench)->step(1000);
  ASSERT_TRUE(more);
  EXPECT_FALSE(*more) << "the hundredth cycle was the last";
  const auto report = (*bench)->finish();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_EQ(report->outcome.loop.reason, StopReason::finished);
  EXPECT_EQ(report->outcome.loop.cycles_run, 100u);
  EXPECT_EQ(report->outcome.input_sha256, expected->outcome.input_sha256);
}

TEST_F(BenchTest, ThatIsFinishedEarlyOrDroppedSaysHowFarItCame) {
  BenchOptions options;
  auto bench = create("record: { file: run.mcap }\n");
  ASSERT_FALSE(std::filesystem::exists("run.mcap"));
  bench = create();
  ASSERT_TRUE(bench && (*bench)->prepare() && (*bench)->start());
  ASSERT_TRUE((*bench)->step(30));
  const auto report = (*bench)->finish();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_EQ(report->outcome.loop.cycles_run, 30u);
  EXPECT_EQ(report->outcome.loop.reason, StopReason::requested);

  StopSource stop;
  stop.request();
  bench = create();
  ASSERT_TRUE(bench);
  EXPECT_EQ(code_of((*bench)->prepare(stop.token())), ErrorCode::unavailable);
  bench = create();
  ASSERT_TRUE(bench && (*bench)->prepare() && (*bench)->start());
  const auto more = (*bench)->step(30, stop.token());
  ASSERT_TRUE(more);
  EXPECT_FALSE(*more);
}  // dropped in the middle of its run

TEST_F(BenchTest, SeveralAtOnceInVirtualTimeDoNotDisturbEachOther) {
  std::array<std::string, 3> seen;
  std::vector<std::unique_ptr<Bench>> benches;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    auto bench = create();
    ASSERT_TRUE(bench && (*bench)->prepare());
    benches.push_back(std::move(*bench));
  }
  {
    std::vector<std::jthread> threads;
    for (std::size_t i = 0; i < seen.size(); ++i)
      threads.emplace_back([&, i] {
        const auto report = benches[i]->run();
        if (report) seen[i] = report->outcome.input_sha256;
      });
  }
  EXPECT_EQ(seen[0].size(), 64u);
  EXPECT_EQ(seen[1], seen[0]);
  EXPECT_EQ(seen[2], seen[0]);
}

TEST_F(BenchTest, FaultsAreInjectedBetweenSteps) {
  const auto bench = create();
  ASSERT_TRUE(bench);
  EXPECT_EQ(code_of((*bench)->inject_fault("count", "{ kind: drop }")), ErrorCode::wrong_state);
  ASSERT_TRUE((*bench)->prepare() && (*bench)->start() && (*bench)->step(10));
  const Status unknown = (*bench)->inject_fault("cuont", "{ kind: drop }");
  ASSERT_FALSE(unknown);
  EXPECT_THAT(unknown.error().text(), HasSubstr("count"));
  EXPECT_FALSE((*bench)->inject_fault("count", "{ kind: no_such_kind }"));
  const Status injected = (*bench)->inject_fault("count", "{ kind: bias, value: n, amount: 1000 }");
  ASSERT_TRUE(injected) << injected.error().text();
  ASSERT_TRUE((*bench)->step(2));
  const SamplePort& port = *(*bench)->ports().inputs.at("count").port;
  EXPECT_GT(port.sample()->as<RegisterBlock>()->value[0], 1000);
  ASSERT_TRUE((*bench)->clear_faults());
  ASSERT_TRUE((*bench)->step(2));
  EXPECT_LT(port.sample()->as<RegisterBlock>()->value[0], 1000);
}

TEST_F(BenchTest, SinksAreCommandedBetweenSteps) {
  const auto bench =
      create("sinks: { told: { backend: log, signals: [a, b] } }\nrecord: { file: told.mcap }\n");
  ASSERT_TRUE(bench) << bench.error().text();
  const std::array<double, 2> values{3, 4};
  EXPECT_EQ(code_of((*bench)->command("told", values)), ErrorCode::wrong_state);
  ASSERT_TRUE((*bench)->prepare() && (*bench)->start() && (*bench)->step(10));
  EXPECT_EQ((*bench)->cycle(), 10u);
  const Status unknown = (*bench)->command("tlod", values);
  ASSERT_FALSE(unknown);
  EXPECT_THAT(unknown.error().text(), HasSubstr("did you mean 'told'"));
  const Status few = (*bench)->command("told", std::span(values).first(1));
  ASSERT_FALSE(few);
  EXPECT_THAT(few.error().text(), HasSubstr("expected 2 values (a, b), got 1"));
  ASSERT_TRUE((*bench)->command("told", values));
  ASSERT_TRUE((*bench)->step(2));
  const auto report = (*bench)->finish();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_EQ(report->facts.sinks.at(0).accepted, 1u);
  std::filesystem::remove("told.mcap");
}

TEST_F(BenchTest, ExpectationsAreToldBetweenSteps) {
  const auto bench = create("expect: [{ of: count.n, value: { max: 49 } }]\n");
  ASSERT_TRUE(bench) << bench.error().text();
  EXPECT_TRUE((*bench)->expected().empty()) << "not started";
  ASSERT_TRUE((*bench)->prepare() && (*bench)->start() && (*bench)->step(40));
  ASSERT_EQ((*bench)->expected().size(), 1u);
  EXPECT_FALSE((*bench)->expected()[0].decided);
  EXPECT_EQ((*bench)->expected()[0].looked_at, 40u);
  ASSERT_TRUE((*bench)->step(20));
  EXPECT_TRUE((*bench)->expected()[0].fails());
  EXPECT_NEAR((*bench)->expected()[0].first_s.value_or(0), 0.5, 1e-9);
}

TEST_F(BenchTest, OnlyPairsAreSwitched) {
  const auto bench = create();
  ASSERT_TRUE(bench && (*bench)->prepare() && (*bench)->start() && (*bench)->step(1));
  const Status refused = (*bench)->switch_pair("count", "real");
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().text(), HasSubstr("expected a pair of this rig"));
}

TEST_F(BenchTest, AnalysesThatCannotBeAreRefusedAtTheirPlace) {
  auto bench = create("analyses: { localisation: {} }\n");
  ASSERT_FALSE(bench);
  EXPECT_THAT(bench.error().text(), HasSubstr("rig.yaml:7:"));
  EXPECT_THAT(bench.error().text(), HasSubstr("localization"));
  bench = create("analyses: { localization: { truth: cuont } }\n");
  ASSERT_FALSE(bench);
  EXPECT_THAT(bench.error().text(), HasSubstr("did you mean"));
}

TEST(RecordedRig, WithAnApplicationOfAPluginSaysWhatAReplayNeeds) {
  ReplayInput input;
  input.file = "run.mcap";
  input.run.rig_file = "rig.yaml";
  input.run.rig_text =
      "name: r\nduration_s: 1\nloop: { rate_hz: 100 }\nplugins: [libmine.so]\n"
      "application: { name: mine }\nchannels: {}\n";
  const auto refused = recorded_rig(input, {}, make_registry(), false);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().text(),
              HasSubstr("run.mcap: the application mine is not one that Rigor comes with"));
  EXPECT_THAT(refused.error().text(), HasSubstr("libmine.so); with --run-program it does"));
  const auto allowed = recorded_rig(input, {}, make_registry(), true);
  ASSERT_TRUE(allowed) << allowed.error().text();
  EXPECT_EQ(allowed->plugins.size(), 1u);
}

}  // namespace
}  // namespace rigor::test
