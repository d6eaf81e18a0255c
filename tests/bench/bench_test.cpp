// The bench as a library: what may be called when, cycle by cycle, several at once.
#include "bench/bench.h"

#include <gmock/gmock.h>

#include <deque>
#include <thread>

#include "bench/run/replay_assembly.h"
#include "builtin/registry.h"
#include "sensor-hal/channel/follower_source.h"
#include "tests/cli/command.h"
#include "tests/cli/recorded_messages.h"

namespace rigor::test {
namespace {

using ::testing::HasSubstr;

/// Four values a second of a formula, by the rig's own clock.
class Counting final : public Source {
 public:
  explicit Counting(std::uint64_t breaks_after) : breaks_after_(breaks_after) {}
  void complete_until(BenchTime now) override {
    if (n_ >= breaks_after_) throw std::runtime_error("the counter broke");
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
    s.stamp.t_capture = s.stamp.t_arrival = now;
    s.stamp.t_release = now + config().latency;
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
  std::uint64_t n_ = 0, breaks_after_;
};

/// A simulator of one's own: its value is the index that it is asked for.
class Following final : public FollowerSource {
 public:
  bool request_at(std::uint64_t index, BenchTime t_capture) noexcept override {
    SampleSlot slot = pool_.try_acquire();
    if (!slot) return false;
    slot->stamp = {};
    slot->stamp.sequence = index;
    slot->stamp.t_capture = t_capture;
    slot->stamp.t_release = slot->stamp.t_arrival = t_capture + config().latency;
    RegisterBlock block;
    block.count = 1;
    block.value[0] = static_cast<double>(index);
    slot->info = block;
    if (measured_.size() == kOutstanding) return false;
    measured_.push_back(std::move(slot));
    return true;
  }
  SampleLease poll(BenchTime) noexcept override {
    if (measured_.empty()) return {};
    SampleLease oldest = std::move(measured_.front());
    measured_.pop_front();
    return oldest;
  }

 private:
  Status do_configure(const ChannelConfig&) override {
    description_.kind = SampleKind::register_block;
    description_.names = {"n"};
    description_.units = {""};
    return {};
  }
  Status do_arm(const ArmContext&) override { return {}; }
  Status do_stop() override { return {}; }
  static constexpr std::size_t kOutstanding = 8;
  SamplePool pool_{64};
  std::deque<SampleLease> measured_;
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
    backend.same_in_virtual_time = true;
    backend.make_source = [this] { return std::make_unique<Counting>(breaks_after); };
    registry.add(std::move(backend));
    Backend simulator;
    simulator.name = "following";
    simulator.same_in_virtual_time = true;
    simulator.make_source = [] { return std::make_unique<Following>(); };
    registry.add(std::move(simulator));
    return Bench::create(std::move(*rig), registry, std::move(options));
  }
  std::uint64_t breaks_after = 1000;  ///< samples: then the source throws
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
  EXPECT_EQ(unknown.error().code, ErrorCode::bad_input);
  EXPECT_THAT(unknown.error().text(), HasSubstr("count"));
  EXPECT_FALSE((*bench)->inject_fault("count", "{ kind: no_such_kind }"));
  const FaultSpec bias{.kind = FaultKind::bias, .value = "n", .amount = 1000};
  const Status injected = (*bench)->inject_fault("count", bias);
  ASSERT_TRUE(injected) << injected.error().text();
  ASSERT_TRUE((*bench)->step(2));
  const SamplePort& port = *(*bench)->ports().inputs.at("count").port;
  EXPECT_GT(port.sample()->as<RegisterBlock>()->value[0], 1000);
  ASSERT_TRUE((*bench)->clear_faults());
  ASSERT_TRUE((*bench)->step(2));
  EXPECT_LT(port.sample()->as<RegisterBlock>()->value[0], 1000);
  // A fault of a schedule is none that begins at once, and a value of another channel is not this one's.
  EXPECT_EQ(code_of((*bench)->inject_fault("count", {.kind = FaultKind::drop, .from = seconds(1)})),
            ErrorCode::bad_input);
  EXPECT_EQ(
      code_of((*bench)->inject_fault("count", {.kind = FaultKind::bias, .value = "position", .amount = 1})),
      ErrorCode::bad_input);
  for (int i = 0; i < 40; ++i)
    if (const Status s = (*bench)->inject_fault("count", bias); !s) {
      EXPECT_EQ(s.error().code, ErrorCode::unavailable) << s.error().text();
      ASSERT_GT(i, 10);
      break;
    } else {
      ASSERT_LT(i, 30) << "as many as one likes";
    }
  ASSERT_TRUE((*bench)->finish());
  EXPECT_EQ(code_of((*bench)->inject_fault("count", bias)), ErrorCode::wrong_state);
}

TEST_F(BenchTest, FaultsAreInjectedByAnotherThreadUpToTheEndOfTheRun) {
  const auto bench = create();
  ASSERT_TRUE(bench && (*bench)->prepare());
  std::atomic<bool> begun{false};
  std::jthread injects([&, b = bench->get()] {
    for (Status s; s || s.error().code != ErrorCode::wrong_state; begun = true)
      s = b->inject_fault("count", {.kind = FaultKind::drop, .on_for = milliseconds(10)});
  });
  while (!begun) std::this_thread::yield();
  const auto report = (*bench)->run();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_EQ(report->outcome.loop.cycles_run, 100u);
  ASSERT_FALSE(report->faults.empty());
}

TEST_F(BenchTest, CommandsBetweenStepsAreThoseOfTheNextCycle) {
  const std::string file = (dir / "run.mcap").string();
  const auto bench = create("record: { file: " + file +
                            " }\nsinks: { said: { backend: log, signals: [n], latency_ms: 20 } }\n");
  ASSERT_TRUE(bench) << bench.error().text();
  EXPECT_EQ(code_of((*bench)->command("said", std::array{1.0})), ErrorCode::wrong_state);
  ASSERT_TRUE((*bench)->prepare() && (*bench)->start() && (*bench)->step(10));
  EXPECT_TRUE((*bench)->command("said", std::array{1.0}));
  EXPECT_EQ(code_of((*bench)->command("siad", std::array{1.0})), ErrorCode::bad_input);
  EXPECT_EQ(code_of((*bench)->command("said", std::array{1.0, 2.0})), ErrorCode::bad_input);
  ASSERT_TRUE((*bench)->step(10));
  const auto report = (*bench)->finish();
  ASSERT_TRUE(report);
  EXPECT_EQ(report->facts.sinks.at(0).accepted, 1u);
  const auto commands = messages_on<record::msg::Command>(file, "/rigor/commands");
  ASSERT_EQ(commands.size(), 1u);
  EXPECT_EQ(commands[0].t_effect_ns % 1'000'000'000, 120'000'000) << "cycle 10 and the latency";
}

TEST_F(BenchTest, OfASourceThatThrowsTheRunBreaksOffAndItsRecordingStays) {
  const std::string file = (dir / "run.mcap").string();
  for (const bool stepped : {false, true}) {
    breaks_after = 30;
    std::filesystem::remove(file);
    const auto bench = create("record: { file: " + file + " }\n");
    ASSERT_TRUE(bench && (*bench)->prepare());
    ErrorCode code = ErrorCode::internal;
    std::string said;
    if (stepped) {
      ASSERT_TRUE((*bench)->start() && (*bench)->step(10));
      const auto more = (*bench)->step(50);
      ASSERT_FALSE(more);
      code = more.error().code, said = more.error().text();
      EXPECT_EQ(code_of((*bench)->finish()), ErrorCode::wrong_state);
    } else {
      const auto report = (*bench)->run();
      ASSERT_FALSE(report);
      code = report.error().code, said = report.error().text();
    }
    EXPECT_EQ(code, ErrorCode::internal);
    EXPECT_THAT(said, HasSubstr("the counter broke"));
    EXPECT_EQ(messages_on<record::msg::RegisterBlock>(file, "/count/registers").size(), 30u);
  }
}

/// Counts what it sees.
class Watching final : public Application {
 public:
  explicit Watching(int& fresh) : fresh_(fresh) {}
  Status configure(ConfigNode, const ApplicationPorts& ports, Period) override {
    port_ = ports.inputs.at("count").port;
    return {};
  }
  void step(std::uint64_t, BenchTime) noexcept override { fresh_ += port_->status() == PortStatus::fresh; }

 private:
  const SamplePort* port_ = nullptr;
  int& fresh_;
};

TEST_F(BenchTest, ARecordingIsReplayedToAnApplicationOfOnesOwn) {
  const std::string file = (dir / "run.mcap").string();
  {
    const auto bench = create("record: { file: " + file + " }\n");
    ASSERT_TRUE(bench && (*bench)->prepare() && (*bench)->run());
  }
  int fresh = 0;
  Registry registry = make_registry();
  registry.add(NamedApplication{"watching", [&] { return std::make_unique<Watching>(fresh); }});
  const auto replay =
      Bench::create_replay(file, registry, {}, {*ConfigOverride::parse("application={name: watching}")});
  ASSERT_TRUE(replay) << replay.error().text();
  ASSERT_TRUE((*replay)->prepare());
  EXPECT_EQ(code_of((*replay)->inject_fault("count", {.kind = FaultKind::drop})), ErrorCode::wrong_state);
  const auto report = (*replay)->run();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_TRUE(report->passed()) << report->text();
  EXPECT_EQ(fresh, 100);
  EXPECT_EQ(code_of(Bench::create_replay(dir / "none.mcap", registry)), ErrorCode::not_found);
}

TEST_F(BenchTest, OfAPairTheSimulatedSideMeasuresWhenItIsAsked) {
  const std::string pair =
      "  two:\n    kind: registers\n    rate_hz: 100\n    latency_ms: 0\n"
      "    pair: { real: { backend: counting }, simulated: { backend: ";
  const auto refused = create(pair + "counting } }\n");
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().text(), HasSubstr("rig.yaml:11:"));
  EXPECT_THAT(refused.error().text(), HasSubstr("another backend that measures at given instants"));

  const auto bench = create(pair + "following } }\n");
  ASSERT_TRUE(bench) << bench.error().text();
  ASSERT_TRUE((*bench)->prepare());
  const auto report = (*bench)->run();
  ASSERT_TRUE(report) << report.error().text();
  ASSERT_TRUE(report->channels.at(1).pair);
  EXPECT_GT(report->channels.at(1).pair->compared, 90u) << report->text();
  EXPECT_EQ(report->channels.at(1).pair->bias, 0);
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
  EXPECT_THAT(unknown.error().text(), HasSubstr("did you mean told?"));
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
  EXPECT_TRUE((*bench)->expected()[0].holds) << "so far";
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
  bench = create("analyses: { localization: { truth: cuont, estimate: said } }\n");
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
