// FMUs as devices: on the grid of the bench, in this process and in one of their own, and when they fail.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <cstdlib>
#include <thread>

#include "bench/plant/plant.h"
#include "tests/sim/fmu/made_fmu.h"

namespace rigor::plant {
namespace {

using test::Folder;
using testing::HasSubstr;

/// A plant of tests/sim/fmu/faulty.c: y' = u, 10 ms.
class Plants : public testing::Test {
 protected:
  std::shared_ptr<Plant> make(const std::string& keys, int version = 3) {
    auto plant = try_make(keys, version);
    if (!plant) throw std::runtime_error(plant.error().text());
    return *plant;
  }
  Result<std::shared_ptr<Plant>> try_make(const std::string& keys, int version = 3) {
    const std::string file = test::make_faulty_fmu(folder_, version).string();
    auto root = ConfigDocument::parse("plants:\n  p: { fmu: " + file + ", " + keys + " }\n", "rig.yaml");
    if (!root) return tl::unexpected<Error>(root.error());
    root_ = *root;
    return Plant::make({"p", root_.map("plants").map("p")});
  }
  std::string refusal(const std::string& keys) {
    const auto plant = try_make(keys);
    return plant ? "accepted" : plant.error().text();
  }
  Folder folder_;
  ConfigNode root_;
};

std::size_t index_of(const Plant& plant, const std::string& name) {
  for (std::size_t i = 0; i < plant.signals().size(); ++i)
    if (plant.signals()[i].name == name) return i;
  throw std::runtime_error("no signal " + name);
}
constexpr BenchTime kT0(1'000'000'000);
BenchTime at_ms(double ms) { return kT0 + Duration(std::llround(ms * 1e6)); }

TEST_F(Plants, HaveEveryNumericInputAndOutputByItsName) {
  const auto plant = make("sandbox: false");
  std::vector<std::string> names;
  for (const auto& s : plant->signals()) names.push_back(s.name + (s.commanded ? "=" : "") + " " + s.unit);
  EXPECT_THAT(names,
              testing::ElementsAre("u= m/s", "y m", "count ", "on= ", "v[1]= ", "v[2]= ", "w[1] ", "w[2] "));
  EXPECT_EQ(plant->settings().step, milliseconds(10));
}

TEST_F(Plants, StepFromCommandToCommandOnTheirGrid) {
  for (const char* sandbox : {"sandbox: true", "sandbox: false"}) {
    SCOPED_TRACE(sandbox);
    const auto plant = make(sandbox);
    const std::size_t u = index_of(*plant, "u"), y = index_of(*plant, "y"), count = index_of(*plant, "count");
    ASSERT_TRUE(plant->arm(true));
    EXPECT_EQ(plant->read(y, kT0), 0);  // before the start
    plant->start(kT0);
    ASSERT_TRUE(plant->write(u, 2, kT0));
    EXPECT_EQ(plant->read(u, kT0), 2);
    EXPECT_EQ(plant->read(y, kT0), 0);
    EXPECT_NEAR(plant->read(y, at_ms(10)), 0.02, 1e-12);
    EXPECT_NEAR(plant->read(y, at_ms(19.999)), 0.02, 1e-12);
    EXPECT_EQ(plant->read(count, at_ms(19.999)), 1);
    // From the first instant of the grid at or after its own: 30 ms.
    ASSERT_TRUE(plant->write(u, -4, at_ms(20.001)));
    EXPECT_NEAR(plant->read(y, at_ms(30)), 0.06, 1e-12);
    EXPECT_NEAR(plant->read(y, at_ms(40)), 0.02, 1e-12);
    EXPECT_NEAR(plant->read(y, at_ms(35)), 0.06, 1e-12);  // what has been is known
    EXPECT_EQ(plant->facts().steps, 4u);
    plant->stop();
  }
}

/// A channel with a latency asks for what was, when another one has had the plant go on.
TEST_F(Plants, KnowValuesForAsLongAsAChannelHasThemComing) {
  for (const bool asked_for : {true, false}) {
    const auto plant = make("sandbox: false");
    if (asked_for) plant->keep(seconds(5));
    const std::size_t u = index_of(*plant, "u"), y = index_of(*plant, "y");
    ASSERT_TRUE(plant->arm(true));
    plant->start(kT0);
    ASSERT_TRUE(plant->write(u, 1, kT0));
    EXPECT_NEAR(plant->read(y, at_ms(5020)), 5.02, 1e-9);
    if (asked_for)
      EXPECT_NEAR(plant->read(y, at_ms(20)), 0.02, 1e-12);
    else
      EXPECT_TRUE(std::isnan(plant->read(y, at_ms(20))));
  }
}

TEST_F(Plants, RefuseValuesThatAVariableCannotHold) {
  const auto plant = make("sandbox: false");
  ASSERT_TRUE(plant->arm(true));
  plant->start(kT0);
  EXPECT_FALSE(plant->write(index_of(*plant, "y"), 1, kT0));
  EXPECT_FALSE(plant->write(index_of(*plant, "u"), std::nan(""), kT0));
  EXPECT_TRUE(plant->write(index_of(*plant, "on"), 1, kT0));
}

TEST_F(Plants, ConvertUnits) {
  const auto plant = make(
      "sandbox: false, signals: { place: { variable: y, unit: mm }, speed: { variable: u, unit: km/h } }");
  ASSERT_TRUE(plant->arm(true));
  plant->start(kT0);
  ASSERT_TRUE(plant->write(1, 3.6, kT0));
  EXPECT_NEAR(plant->read(0, at_ms(10)), 10, 1e-9);
  EXPECT_NEAR(plant->read(1, at_ms(10)), 3.6, 1e-12);
}

TEST_F(Plants, TakeTunableParametersTerminalsAndArraysByName) {
  const auto plant = make(
      "sandbox: false, start_values: { n: 3, gain: 5 }, signals: { gain: { variable: gain, commanded: true "
      "}, "
      "place: axis.place, speed: axis.speed, w: w, one: \"v[2]\" }");
  const std::size_t gain = index_of(*plant, "gain"), place = index_of(*plant, "place"),
                    speed = index_of(*plant, "speed");
  ASSERT_TRUE(plant->arm(true));
  plant->start(kT0);
  ASSERT_TRUE(plant->write(speed, 1, kT0));
  ASSERT_TRUE(plant->write(index_of(*plant, "one"), 7, kT0));
  EXPECT_NEAR(plant->read(place, at_ms(10)), 0.05, 1e-12);
  EXPECT_EQ(plant->read(index_of(*plant, "w[2]"), at_ms(10)), 14);
  EXPECT_EQ(plant->read(index_of(*plant, "w[3]"), at_ms(10)), 0);
  ASSERT_TRUE(plant->write(gain, 10, at_ms(10)));
  EXPECT_NEAR(plant->read(place, at_ms(20)), 0.2, 1e-12);
}

TEST_F(Plants, SayWhatTheRigAsksForAndTheFmuHasNot) {
  EXPECT_THAT(refusal("signals: { a: cuont }"),
              HasSubstr("expected a variable of the FMU, got \"cuont\"; did you mean count?; its outputs "
                        "are: y, count, w; its "
                        "inputs are: u, on, v; `rigor inspect faulty3.fmu` lists all"));
  EXPECT_THAT(
      refusal("signals: { a: { variable: y, unit: kg } }"),
      HasSubstr(
          "plants.p.signals.a.unit: expected m, the unit of y, or one that it can be converted to, got kg: m "
          "and kg measure different quantities"));
  EXPECT_THAT(refusal("signals: { a: { variable: y, type: Int32 } }"),
              HasSubstr("expected Float64, which is the type of y, got Int32"));
  EXPECT_THAT(refusal("signals: { a: { variable: y, causality: input } }"),
              HasSubstr("expected output, which is the causality of y, got input"));
  EXPECT_THAT(refusal("signals: { a: { variable: count, variability: continuous } }"),
              HasSubstr("expected discrete, which is the variability of count, got continuous"));
  EXPECT_THAT(refusal("signals: { a: { variable: y, commanded: true } }"),
              HasSubstr("expected an input or a tunable parameter, got y"));
  EXPECT_THAT(refusal("signals: { a: { varible: y } }"), HasSubstr("a"));
  EXPECT_THAT(refusal("start_values: { gian: 1 }"), HasSubstr("plants.p.start_values.gian"));
  EXPECT_THAT(refusal("step_ms: 0"), HasSubstr("step_ms"));
  EXPECT_THAT(refusal("setp_ms: 1"), HasSubstr("did you mean step_ms?"));
}

class FailingPlants : public Plants, public testing::WithParamInterface<const char*> {};

/// Mode, what is said of it. The step from 20 to 30 ms fails.
TEST_P(FailingPlants, HaveNoValuesFromTheNextInstantOn) {
  const bool sandbox = std::string(GetParam()) == "sandbox: true";
  std::vector<std::pair<int, std::string>> cases{
      {3, "the FMU gave nan for y at t = 0.03 s"},
      {4, "fmi3DoStep returned fmi3Error at t = 0.02 s: the valve is stuck"}};
  if (sandbox) {
    cases.emplace_back(1, "the FMU gave no answer to the step from t = 0.02 s within 0.2 s, and was killed");
    cases.emplace_back(2, "the process of the FMU ended: signal 11, Segmentation fault");
  }
  for (const auto& [mode, says] : cases) {
    SCOPED_TRACE(mode);
    const auto plant =
        make(std::string(GetParam()) +
             ", answer_timeout_s: 0.2, start_values: { at: 0.03, mode: " + std::to_string(mode) + " }");
    const std::size_t u = index_of(*plant, "u"), y = index_of(*plant, "y");
    const auto armed = plant->arm(true);
    ASSERT_TRUE(armed) << armed.error().text();
    plant->start(kT0);
    ASSERT_TRUE(plant->write(u, 1, kT0));
    EXPECT_NEAR(plant->read(y, at_ms(20)), 0.02, 1e-12);
    EXPECT_FALSE(plant->facts().faulty);
    EXPECT_TRUE(std::isnan(plant->read(y, at_ms(30))));
    EXPECT_TRUE(std::isnan(plant->read(y, at_ms(100))));
    EXPECT_NEAR(plant->read(y, at_ms(20)), 0.02, 1e-12);  // what has been was good
    const PlantFacts f = plant->facts();
    EXPECT_TRUE(f.faulty);
    EXPECT_EQ(f.faults, 1u);
    EXPECT_EQ(f.steps, 2u);
    EXPECT_THAT(f.fault, HasSubstr(says));
    EXPECT_FALSE(plant->write(u, 1, at_ms(100)));
    ASSERT_EQ(plant->warnings().size(), 1u);
    EXPECT_THAT(plant->warnings()[0], HasSubstr("plant p: " + says));
  }
}

/// A new instance from the start values, at its instant, with the commands that were given; the same each
/// time.
TEST_P(FailingPlants, BeginAnewWhereTheRigSaysSo) {
  std::vector<std::vector<double>> runs;
  for (int run = 0; run < 2; ++run) {
    const auto plant = make(std::string(GetParam()) +
                            ", on_fault: restart, restart_after_ms: 20, start_values: { at: 0.03, mode: 4 }");
    const std::size_t u = index_of(*plant, "u"), y = index_of(*plant, "y");
    ASSERT_TRUE(plant->arm(true));
    plant->start(kT0);
    ASSERT_TRUE(plant->write(u, 1, kT0));
    std::vector<double> values;
    for (int k = 0; k < 12; ++k) values.push_back(plant->read(y, at_ms(10 * k)));
    // It fails from 30 ms on; begun anew at 50 and 80 ms, whose steps fail again.
    EXPECT_EQ(values[2], 0.02);
    EXPECT_EQ(plant->facts().faults, 3u);
    runs.push_back(values);
  }
  for (std::size_t i = 0; i < runs[0].size(); ++i)
    EXPECT_TRUE(runs[0][i] == runs[1][i] || (std::isnan(runs[0][i]) && std::isnan(runs[1][i]))) << i;
}

INSTANTIATE_TEST_SUITE_P(Processes, FailingPlants, testing::Values("sandbox: true", "sandbox: false"),
                         [](const auto& of) {
                           return of.param == std::string("sandbox: true") ? "OfTheirOwn" : "Shared";
                         });

/// In this process the FMU fails once, and its next instance works.
TEST_F(Plants, WorkAgainAfterARestart) {
  unsetenv("RIGOR_FAULTY_FMU");
  const auto plant =
      make("sandbox: false, on_fault: restart, restart_after_ms: 20, start_values: { at: 0.03, mode: 10 }");
  const std::size_t u = index_of(*plant, "u"), y = index_of(*plant, "y");
  ASSERT_TRUE(plant->arm(true));
  plant->start(kT0);
  ASSERT_TRUE(plant->write(u, 1, kT0));
  EXPECT_TRUE(std::isnan(plant->read(y, at_ms(30))));
  ASSERT_TRUE(plant->write(u, 2, at_ms(35)));
  EXPECT_TRUE(std::isnan(plant->read(y, at_ms(50))));
  EXPECT_NEAR(plant->read(y, at_ms(60)), 0.02, 1e-12);
  EXPECT_NEAR(plant->read(y, at_ms(70)), 0.04, 1e-12);
  EXPECT_EQ(plant->facts().restarts, 1u);
  EXPECT_FALSE(plant->facts().faulty);
}

TEST_F(Plants, SayWhyTheyCannotBegin) {
  const auto plant = make("start_values: { n: 9 }");
  const auto armed = plant->arm(true);
  ASSERT_FALSE(armed);
  EXPECT_EQ(armed.error().where, "plants.p");
  EXPECT_THAT(armed.error().message, HasSubstr("fmi3Set… of n returned fmi3Error"));
}

/// Both ways over the socket and in this process: the same bits.
TEST_F(Plants, GiveTheSameInAProcessOfTheirOwnAsInThisOne) {
  if (!test::reference_fmus()) GTEST_SKIP() << "test data: no reference_fmus";
  const auto file = test::make_reference_fmu(folder_, "VanDerPol", 3);
  std::vector<std::vector<double>> runs;
  for (const char* sandbox : {"true", "false"}) {
    auto root =
        ConfigDocument::parse("p: { fmu: " + file->string() + ", sandbox: " + sandbox + " }", "rig.yaml");
    const auto plant = Plant::make({"p", root->map("p")});
    ASSERT_TRUE(plant) << plant.error().text();
    ASSERT_TRUE((*plant)->arm(true));
    (*plant)->start(kT0);
    std::vector<double> values;
    for (int k = 0; k < 500; ++k)
      for (std::size_t i = 0; i < 2; ++i) values.push_back((*plant)->read(i, at_ms(10 * k)));
    runs.push_back(values);
  }
  EXPECT_EQ(runs[0], runs[1]);
  EXPECT_GT(*std::max_element(runs[0].begin(), runs[0].end()), 1.9);
}

/// Counts the instants of which it is told.
class Counter final : public PlantListener {
 public:
  void plant_reached(BenchTime) noexcept override { ++reached; }
  std::atomic<int> reached{0};
};

/// Ends when a condition holds, or fails after 20 s.
template <class F>
bool wait_for(F&& holds) {
  for (int i = 0; i < 20'000 && !holds(); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  return holds();
}

TEST_F(Plants, StepByThemselvesOnTheWallClock) {
  const auto plant = make("deadline_ms: 10000");
  const std::size_t u = index_of(*plant, "u"), y = index_of(*plant, "y");
  ASSERT_TRUE(plant->arm(false));
  Counter counter;
  plant->subscribe(&counter);
  const BenchTime t0 = bench_now() + milliseconds(20);
  plant->start(t0);
  ASSERT_TRUE(plant->write(u, 1, t0));
  ASSERT_TRUE(wait_for([&] { return counter.reached > 30; }));
  plant->unsubscribe(&counter);
  EXPECT_NEAR(plant->read(y, t0 + milliseconds(200)), 0.2, 1e-9);
  EXPECT_GE(plant->facts().steps, 30u);
  EXPECT_EQ(plant->facts().late, 0u);
  plant->stop();
}

/// Each step takes 30 ms of its 10: it is late, it says so, and whoever reads or commands does not wait for
/// it.
TEST_F(Plants, CountStepsThatMissTheirDeadlineAndKeepNobodyWaiting) {
  const auto plant = make("deadline_ms: 5, start_values: { mode: 7 }");
  const std::size_t u = index_of(*plant, "u"), y = index_of(*plant, "y");
  ASSERT_TRUE(plant->arm(false));
  plant->start(bench_now());
  Duration longest;
  int reads = 0;
  ASSERT_TRUE(wait_for([&] {
    const MonotonicTime before = monotonic_now();
    (void)plant->read(y, bench_now());
    (void)plant->write(u, 1, bench_now());
    longest = std::max(longest, monotonic_now() - before);
    ++reads;
    return plant->facts().late > 10;
  }));
  // 11 steps of 30 ms; had every read waited for one, there would be as few.
  EXPECT_GT(reads, 40);
  EXPECT_THAT(plant->warnings()[0], HasSubstr("steps missed their deadline of 5 ms"));
  plant->stop();
}

/// A run that ends does not wait for a step.
TEST_F(Plants, EndWhileTheyHang) {
  const auto plant = make("answer_timeout_s: 60, start_values: { mode: 1, at: 0.03 }");
  ASSERT_TRUE(plant->arm(false));
  plant->start(bench_now());
  ASSERT_TRUE(wait_for([&] { return plant->facts().steps == 2; }));
  const MonotonicTime before = monotonic_now();
  plant->stop();
  EXPECT_LT((monotonic_now() - before).seconds(), 30);
  EXPECT_EQ(plant->facts().faults, 0u);
}

/// An FMU that hangs keeps its own thread for `answer_timeout_s`, and nobody else.
TEST_F(Plants, KeepNobodyWaitingWhenTheyHang) {
  const auto plant = make("answer_timeout_s: 1, start_values: { mode: 1, at: 0.03 }");
  const std::size_t y = index_of(*plant, "y");
  ASSERT_TRUE(plant->arm(false));
  plant->start(bench_now());
  int reads = 0;
  ASSERT_TRUE(wait_for([&] {
    (void)plant->read(y, bench_now());
    ++reads;
    return plant->facts().faulty;
  }));
  EXPECT_GT(reads, 100);  // in a second, a millisecond each
  EXPECT_THAT(plant->facts().fault, HasSubstr("within 1 s, and was killed"));
  EXPECT_TRUE(std::isnan(plant->read(y, bench_now())));
  plant->stop();
}

}  // namespace
}  // namespace rigor::plant
