#include "sensor-hal/channel/pair_watch/change_watch.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>

#include "tests/sensor-hal/pair_watch/noise_for_tests.h"

namespace rigor::pair_watch {
namespace {

using testing::Random;

std::vector<Parameter> named(std::size_t n) {
  std::vector<Parameter> p;
  for (std::size_t i = 0; i < n; ++i) p.push_back({"p" + std::to_string(i), "1", 0});
  return p;
}

/// Windows of first-order processes with unit variance.
class Process {
 public:
  Process(std::size_t n, double phi, std::uint64_t seed) : random_(seed), phi_(phi), x_(n) {
    for (double& x : x_) x = random_.normal();
  }
  Estimate next() {
    Estimate e;
    for (std::size_t i = 0; i < x_.size(); ++i) {
      x_[i] = phi_ * x_[i] + std::sqrt(1 - phi_ * phi_) * random_.normal();
      e.value[i] = 5 + x_[i], e.sigma[i] = 0.1;  // a window sees less than what changes between windows
    }
    return e;
  }

 private:
  Random random_;
  double phi_;
  std::vector<double> x_;
};

/// False alarms of many watches, each with a baseline of its own, over what the stated rate allows.
double false_alarms_over_stated(double phi, std::uint32_t baseline) {
  WatchOptions o;
  o.window_s = 3.6, o.baseline_windows = baseline;
  o.false_alarms_per_h = 2;  // one in 500 windows of all three parameters
  double alarms = 0, allowed = 0;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    ChangeWatch watch = ChangeWatch::make(named(3), o).value();
    Process process(3, phi, seed);
    for (std::uint32_t i = 0; i < baseline; ++i) watch.add(process.next());
    for (int i = 0; i < 2000; ++i) {
      watch.add(process.next());
      if (watch.state() == WatchState::alarm) ++alarms, watch.acknowledge();
    }
    allowed += 2000.0 / 500;
  }
  return alarms / allowed;
}

TEST(ChangeWatch, FalseAlarmsStayBelowTheStatedRate) {
  // 400 are allowed. That it is not far below, too: the run length of a perfectly known baseline would
  // give 1.
  const double share = false_alarms_over_stated(0, 1000);
  RecordProperty("share_of_stated_rate", std::to_string(share));
  std::printf("  %.2f of the stated rate\n", share);
  EXPECT_LT(share, 1);
  EXPECT_GT(share, 0.02);
  EXPECT_LT(false_alarms_over_stated(0, 50), 1);
}

TEST(ChangeWatch, LimitsOfTheBaselineHoldAsOftenAsStated) {
  // Of 200 watches with three parameters at most 1 % may have one whose deviation is taken too small, or
  // whose mean is farther off than the sums allow for: up to 8 by chance (binomial, 0.001).
  WatchOptions o;
  o.baseline_windows = 50;
  int missed = 0;
  double sigmas = 0;
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    ChangeWatch watch = ChangeWatch::make(named(3), o).value();
    Process process(3, 0, seed + 500);
    for (int i = 0; i < 50; ++i) watch.add(process.next());
    bool miss = false;
    for (std::size_t i = 0; i < 3; ++i) {
      const ParameterState p = watch.parameter_state(i);
      miss = miss || p.sigma < 1 || std::abs(p.mean - 5) > (p.k - o.reference) * p.sigma;
      sigmas += p.sigma / 600;
      EXPECT_LT(p.k, 1.3);
    }
    missed += miss;
  }
  EXPECT_LE(missed, 8);
  EXPECT_LT(sigmas, 1.6);  // nor by far too large
}

TEST(ChangeWatch, TakingAShortBaselineForTrueWouldExceedTheRate) {
  // Why there are confidence limits: the same sums, with mean and deviation of 50 windows as they are.
  WatchOptions o;
  o.window_s = 3.6, o.baseline_windows = 50, o.false_alarms_per_h = 2;
  const double run_length = ChangeWatch::make(named(3), o).value().run_length();
  EXPECT_DOUBLE_EQ(run_length, 1500);
  double alarms = 0;
  for (std::uint64_t seed = 0; seed < 300; ++seed) {
    Random random(seed + 1000);
    double mean = 0, squares = 0;
    for (int i = 0; i < 50; ++i) {
      const double x = random.normal();
      mean += x / 50, squares += x * x;
    }
    const double sigma = std::sqrt((squares - 50 * mean * mean) / 49);
    Cusum sum(0.5, threshold_for(0.5, run_length));
    for (std::uint64_t i = 0; i < 2000; ++i) {
      sum.add((random.normal() - mean) / sigma, i);
      if (sum.alarm()) ++alarms, sum.restart(i);
    }
  }
  const double over = alarms / (300 * 2000 / run_length);
  std::printf("  %.1f times the stated rate\n", over);
  EXPECT_GT(over, 1.5);
}

TEST(ChangeWatch, WindowsThatHangTogetherRaiseNoMoreAlarms) {
  EXPECT_LT(false_alarms_over_stated(0.5, 200), 1);
  EXPECT_LT(false_alarms_over_stated(0.8, 400), 1);
}

TEST(ChangeWatch, NamesTheParameterThatExplainsTheChange) {
  // p1 follows p0 with correlation 0.95: a change of p0 alone breaks that, a change of both by what the
  // correlation says is better explained by p0 than by p1.
  WatchOptions o;
  o.baseline_windows = 400;
  for (std::size_t planted = 0; planted < 4; ++planted) {
    ChangeWatch watch = ChangeWatch::make(named(4), o).value();
    Random random(planted + 1);
    const auto next = [&](double change) {
      Estimate e;
      const double common = random.normal();
      for (std::size_t i = 0; i < 4; ++i) {
        e.value[i] = random.normal();
        if (i < 2) e.value[i] = std::sqrt(0.95) * common + std::sqrt(0.05) * e.value[i];
        e.sigma[i] = 1;
      }
      e.value[planted] += change;
      return e;
    };
    for (int i = 0; i < 600; ++i) watch.add(next(0));
    ASSERT_EQ(watch.state(), WatchState::watching);
    int windows = 0;
    while (watch.state() == WatchState::watching && windows < 100) watch.add(next(2)), ++windows;
    ASSERT_EQ(watch.state(), WatchState::alarm) << planted;
    const Alarm& a = watch.alarm();
    EXPECT_EQ(a.parameter, planted);
    EXPECT_NE(a.runner_up, a.parameter);
    EXPECT_GT(a.log_ratio, a.runner_up_log_ratio);
    EXPECT_NEAR(a.change, 2, 4 * a.sigma);
    EXPECT_NEAR(static_cast<double>(a.since), 600, 8);
    // What hangs together with it says how much of the scatter is not its own: a tenth of the variance is
    // left.
    const double n = static_cast<double>(a.window - a.since + 1);
    if (planted < 2) {
      EXPECT_LT(a.sigma, 0.6 / std::sqrt(n));
    }
    EXPECT_GT(a.log_ratio, 0.9 * a.change * a.change / (2 * a.sigma * a.sigma));
    EXPECT_EQ(a.window, 600u + static_cast<std::uint64_t>(windows) - 1);
  }
}

TEST(ChangeWatch, AlarmStaysUntilAcknowledgedAndComesBackWhereTheChangePersists) {
  WatchOptions o;
  o.baseline_windows = 100;
  ChangeWatch watch = ChangeWatch::make(named(1), o).value();
  Process process(1, 0, 3);
  for (int i = 0; i < 100; ++i) watch.add(process.next());
  const auto changed = [&] {
    Estimate e = process.next();
    e.value[0] += 6;
    return e;
  };
  for (int i = 0; i < 50; ++i) watch.add(changed());
  EXPECT_EQ(watch.state(), WatchState::alarm);
  const std::uint64_t raised = watch.alarm().window;
  for (int i = 0; i < 300; ++i) watch.add(process.next());
  EXPECT_EQ(watch.state(), WatchState::alarm);
  EXPECT_EQ(watch.alarm().window, raised);
  EXPECT_GE(watch.parameter_state(0).highest, 1) << "the alarm is remembered";
  watch.acknowledge();
  for (int i = 0; i < 300; ++i) watch.add(process.next());
  EXPECT_EQ(watch.state(), WatchState::watching);
  for (int i = 0; i < 50; ++i) watch.add(changed());
  EXPECT_EQ(watch.state(), WatchState::alarm);
  watch.learn_again();
  EXPECT_EQ(watch.state(), WatchState::learning);
  EXPECT_EQ(watch.parameter_state(0).highest, 0) << "nothing has been watched yet";
  for (int i = 0; i < 500; ++i) watch.add(changed());
  EXPECT_EQ(watch.state(), WatchState::watching);
  EXPECT_NEAR(watch.parameter_state(0).mean, 11, 0.5);
}

TEST(ChangeWatch, SmallChangesBelowTheLeastAreLeftAlone) {
  WatchOptions o;
  o.baseline_windows = 400;
  for (const double least : {0.0, 4.0}) {
    auto parameters = named(1);
    parameters[0].least = least;
    ChangeWatch watch = ChangeWatch::make(parameters, o).value();
    Process process(1, 0, 5);
    for (int i = 0; i < 400; ++i) watch.add(process.next());
    for (int i = 0; i < 1000; ++i) {
      Estimate e = process.next();
      e.value[0] += 1.5;
      watch.add(e);
    }
    EXPECT_EQ(watch.state() == WatchState::alarm, least == 0) << least;
  }
}

TEST(ChangeWatch, UncertainAndEmptyWindowsCountLessOrNotAtAll) {
  WatchOptions o;
  o.baseline_windows = 100;
  ChangeWatch watch = ChangeWatch::make(named(2), o).value();
  Process process(2, 0, 9);
  for (int i = 0; i < 100; ++i) {
    Estimate e = process.next();
    if (i % 4 != 0) e.value[1] = kNaN;
    watch.add(e);
  }
  EXPECT_TRUE(watch.parameter_state(0).watched);
  EXPECT_FALSE(watch.parameter_state(1).watched);  // determined in a quarter of the baseline
  EXPECT_EQ(watch.parameter_state(1).undetermined, 75u);
  for (int i = 0; i < 200; ++i) {
    Estimate e = process.next();
    e.value[0] = kNaN, e.value[1] = 1e6;
    watch.add(e);
    e.value[0] = 25, e.sigma[0] = 100;  // 20 off, by a window that says that it does not know
    watch.add(e);
  }
  EXPECT_EQ(watch.state(), WatchState::watching);
}

TEST(ChangeWatch, NumbersThatNeverChangedAreWatchedForAnyChange) {
  WatchOptions o;
  o.baseline_windows = 20;
  ChangeWatch watch = ChangeWatch::make(named(2), o).value();
  Estimate e;
  e.value[1] = 4;
  for (int i = 0; i < 100; ++i) watch.add(e);
  EXPECT_EQ(watch.state(), WatchState::watching);
  e.value[1] = 5;
  watch.add(e);
  EXPECT_EQ(watch.state(), WatchState::watching);
  for (int i = 0; i < 2; ++i) watch.add(e);
  ASSERT_EQ(watch.state(), WatchState::alarm);
  EXPECT_EQ(watch.alarm().parameter, 1u);
  EXPECT_NEAR(watch.alarm().change, 1, 1e-12);
}

TEST(ChangeWatch, SaysThatABaselineWhichDriftsIsNotSettled) {
  WatchOptions o;
  o.baseline_windows = 100;
  ChangeWatch watch = ChangeWatch::make(named(2), o).value();
  Process process(2, 0, 2);
  for (int i = 0; i < 100; ++i) {
    Estimate e = process.next();
    e.value[1] += 0.1 * i;
    watch.add(e);
  }
  EXPECT_FALSE(watch.parameter_state(0).unsettled);
  EXPECT_TRUE(watch.parameter_state(1).unsettled);
}

TEST(ChangeWatch, RefusesOptionsOutOfBounds) {
  const auto refused = [](auto change, std::size_t parameters) {
    WatchOptions o;
    change(o);
    const auto w = ChangeWatch::make(named(parameters), o);
    return !w && w.error().code == ErrorCode::bad_input ? w.error().text() : std::string();
  };
  EXPECT_NE(refused([](auto& o) { o.window_s = 0; }, 1).find("window_s"), std::string::npos);
  EXPECT_NE(refused([](auto& o) { o.baseline_windows = 15; }, 1).find("baseline_windows"), std::string::npos);
  EXPECT_NE(refused([](auto& o) { o.false_alarms_per_h = kNaN; }, 1).find("false_alarms_per_h"),
            std::string::npos);
  EXPECT_NE(refused([](auto& o) { o.reference = 0; }, 1).find("reference"), std::string::npos);
  EXPECT_NE(refused([](auto& o) { o.confidence = 1; }, 1).find("confidence"), std::string::npos);
  EXPECT_NE(refused([](auto&) {}, 0).find("parameters"), std::string::npos);
  EXPECT_NE(refused([](auto&) {}, kMaxParameters + 1).find("parameters"), std::string::npos);
}

TEST(WindowFit, FindsWhatIsDeterminedAndNothingElse) {
  // Columns: 1, x, 2x (not apart from x), z (never other than 0), w.
  WindowFit fit(5);
  Random random(4);
  for (int i = 0; i < 2000; ++i) {
    const double x = random.normal(), w = random.normal();
    const std::array<WindowFit::Term, 5> terms{{{0, 1}, {1, x}, {2, 2 * x}, {3, 0}, {4, w}}};
    fit.add(terms, 3 - 0.5 * w + 0.7 * x + 0.1 * random.normal(), 4);
  }
  fit.solve();
  EXPECT_NEAR(fit.value(0), 3, 4 * fit.sigma(0));
  EXPECT_NEAR(fit.value(4), -0.5, 4 * fit.sigma(4));
  EXPECT_NEAR(fit.sigma(4), 0.1 / std::sqrt(2000), 1e-4);
  for (const std::size_t k : {1, 2, 3}) EXPECT_TRUE(std::isnan(fit.value(k))) << k;
  fit.clear();
  fit.solve();
  for (std::size_t k = 0; k < 5; ++k) EXPECT_TRUE(std::isnan(fit.value(k)) && std::isnan(fit.sigma(k)));
}

TEST(WindowFit, CovarianceIsThatOfRepeatedFits) {
  double squares = 0, product = 0, stated = 0, stated_product = 0;
  constexpr int kRuns = 2000;
  for (int run = 0; run < kRuns; ++run) {
    Random random(static_cast<std::uint64_t>(run) + 100);
    WindowFit fit(2);
    for (int i = 0; i < 40; ++i) {
      const double x = 1 + 0.1 * i;
      const std::array<WindowFit::Term, 2> terms{{{0, 1}, {1, x}}};
      fit.add(terms, 0.3 * random.normal(), 1);
    }
    fit.solve();
    squares += fit.value(1) * fit.value(1), product += fit.value(0) * fit.value(1);
    stated += fit.covariance(1, 1), stated_product += fit.covariance(0, 1);
  }
  // A variance of 2000 runs is good to 3.2 %.
  EXPECT_NEAR(squares / stated, 1, 0.13);
  EXPECT_NEAR(product / stated_product, 1, 0.13);
}

}  // namespace
}  // namespace rigor::pair_watch
