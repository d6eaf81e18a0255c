// Time-of-flight cameras and channels of numbers.
#include <cmath>
#include <limits>

#include "sensor-hal/channel/pair_watch/range_image_change.h"
#include "sensor-hal/channel/pair_watch/value_change.h"
#include "tests/sensor-hal/pair_watch/noise_for_tests.h"
#include "tests/sensor-hal/pair_watch/watched_pair.h"

namespace rigor::pair_watch {
namespace {

using testing::Random;

struct RangeChange {
  double offset_m = 0, scale = 0, noise = 1, flying = 0, low_m = 0, lost = 0, amplitude = 0;
};

class RangePair {
 public:
  static constexpr std::uint32_t kWidth = 48, kHeight = 36;
  RangePair(const RangeChange& change, std::uint64_t seed)
      : random_(seed),
        change_(change),
        changes_(RangeImageChange::make({kWidth, kHeight}, {.sigma_m = 0.01, .amplitude_max = 1}).value()) {
    real_.reserve(8 * kWidth * kHeight), simulated_.reserve(8 * kWidth * kHeight);
  }
  Estimate window(bool changed) {
    const std::uint64_t scene = random_.bits() % 8;
    RangeChange c = changed ? change_ : RangeChange{};
    c.offset_m += 0.003, c.flying += 0.1;
    expose(real_, scene, c);
    RangeChange simulated;
    simulated.flying = 0.1;
    expose(simulated_, scene, simulated);
    EXPECT_TRUE(changes_.add(real_, simulated_));
    Estimate e;
    changes_.finish(e);
    return e;
  }
  RangeImageChange& changes() { return changes_; }
  Sample& real() { return real_; }
  Sample& simulated() { return simulated_; }

 private:
  void expose(Sample& s, std::uint64_t scene, const RangeChange& c) {
    std::vector<float> data(2 * kWidth * kHeight);
    const double edge = 14 + static_cast<double>(scene);
    for (std::uint32_t v = 0; v < kHeight; ++v)
      for (std::uint32_t u = 0; u < kWidth; ++u) {
        // A wall that leans, and a board before it.
        const bool board = u > edge && u < edge + 16 && v > 8 && v < 28;
        double range = board ? 1.5 : 3 + 0.02 * u + 0.01 * v;
        const double amplitude = board ? 0.8 : 0.1 + 0.5 * v / kHeight;
        if (std::abs(u - edge) < 1 && v > 8 && v < 28 && random_.uniform() < c.flying) range = 2.2;
        range = range * (1 + c.scale) + c.offset_m + (amplitude < 1.0 / 3 ? c.low_m : 0) +
                0.01 * c.noise * random_.quick_normal();
        const bool lost = random_.uniform() < 0.005 + c.lost;
        data[v * kWidth + u] = lost ? std::numeric_limits<float>::quiet_NaN() : static_cast<float>(range);
        data[kWidth * kHeight + v * kWidth + u] =
            static_cast<float>(amplitude * (1 + c.amplitude) + 0.01 * random_.quick_normal());
      }
    s.info = RangeImageInfo{kWidth, kHeight};
    testing::fill<float>(s, data);
  }
  Random random_;
  RangeChange change_;
  RangeImageChange changes_;
  Sample real_, simulated_;
};

struct PlantedRange {
  const char* name;
  RangeChange change;
  double truth;
};
class RangeImageChanges : public ::testing::TestWithParam<PlantedRange> {};

TEST_P(RangeImageChanges, AreFoundAndNamed) {
  RangePair pair(GetParam().change, 3);
  ChangeWatch watch = ChangeWatch::make(pair.changes().parameters(), testing::watch_options()).value();
  const int windows = testing::windows_to_alarm(
      watch, [&](bool c) { return pair.window(c); }, 200, 50);
  EXPECT_GE(windows, 1);
  EXPECT_LE(windows, 15);
  EXPECT_EQ(testing::name_of_alarm(watch), GetParam().name);
  if (GetParam().truth != 0) {
    EXPECT_NEAR(watch.alarm().change, GetParam().truth,
                0.15 * std::abs(GetParam().truth) + 4 * watch.alarm().sigma);
  }
}

RangeChange range_with(auto set) {
  RangeChange c;
  set(c);
  return c;
}
INSTANTIATE_TEST_SUITE_P(
    Planted, RangeImageChanges,
    ::testing::Values(PlantedRange{"offset", range_with([](auto& c) { c.offset_m = 0.02; }), 0.02},
                      PlantedRange{"range scale", range_with([](auto& c) { c.scale = 0.01; }), 0.01},
                      PlantedRange{"low amplitude", range_with([](auto& c) { c.low_m = 0.02; }), 0.02},
                      PlantedRange{"noise", range_with([](auto& c) { c.noise = 2; }), 3},
                      PlantedRange{"flying", range_with([](auto& c) { c.flying = 0.6; }), 0},
                      PlantedRange{"amplitude", range_with([](auto& c) { c.amplitude = -0.1; }), -0.1},
                      PlantedRange{"lost", range_with([](auto& c) { c.lost = 0.05; }), 0.05}),
    [](const auto& planted) {
      std::string name = planted.param.name;
      for (char& c : name)
        if (c == ' ') c = '_';
      return name;
    });

TEST(RangeImageChange, TenThousandWindowsWithoutAChangeRaiseNoAlarm) {
  RangePair pair(RangeChange{}, 5);
  ChangeWatch watch = ChangeWatch::make(pair.changes().parameters(), testing::watch_options()).value();
  testing::expect_no_false_alarm(
      watch, [&](bool c) { return pair.window(c); }, 200);
}

TEST(RangeImageChange, PixelsWeighByTheNoiseOfTheirAmplitude) {
  // A leaning wall whose light falls to a tenth across, and whose noise grows as that light falls.
  constexpr std::size_t kWidth = 48, kHeight = 36;
  Random random(7);
  std::array<Sample, 2> side;
  std::vector<float> data(2 * kWidth * kHeight);
  double scatter[2], excess = 0;
  for (const int k : {0, 1}) {
    RangeImageChange change =
        RangeImageChange::make({kWidth, kHeight}, {.sigma_m = 0.01, .noise_exponent = k == 0 ? 0.0 : 1.0})
            .value();
    double sum = 0, squares = 0;
    for (int i = 0; i < 200; ++i) {
      for (Sample& s : side) {
        for (std::size_t p = 0; p < kWidth * kHeight; ++p) {
          const double amplitude = 0.1 + 0.8 * static_cast<double>(p % kWidth) / kWidth;
          data[p] = static_cast<float>(3 - amplitude + 0.01 * (0.5 / amplitude) * random.quick_normal());
          data[kWidth * kHeight + p] = static_cast<float>(amplitude);
        }
        s.reserve(data.size() * sizeof(float)), s.info = RangeImageInfo{kWidth, kHeight};
        testing::fill<float>(s, data);
      }
      ASSERT_TRUE(change.add(side[0], side[1]));
      Estimate e;
      change.finish(e);
      sum += e.value[0], squares += e.value[0] * e.value[0];
      if (k == 1) excess += e.value[5] / 200;
    }
    scatter[k] = std::sqrt(squares / 200 - sum * sum / 4e4);
  }
  EXPECT_LT(scatter[1], 0.7 * scatter[0]) << scatter[0] << " " << scatter[1];
  EXPECT_NEAR(excess, 0, 0.05) << "of the variance, everywhere";
}

/// Noise of the simulated side is in the residual and in the range that a scale goes with. Of a wall whose
/// ranges are within 0.6 m, with 0.03 m of noise, each window's scale was off by −4 %.
TEST(RangeImageChange, NoiseOfTheSimulatedSideIsNotTakenForAScale) {
  constexpr std::size_t kPixels = 48 * 36;
  for (const double scale : {0.0, 0.02}) {
    Random random(11);
    RangeImageChange change = RangeImageChange::make({48, 36}, {.sigma_m = 0.03}).value();
    std::array<Sample, 2> side;
    std::vector<float> data(kPixels);
    double sum = 0, squares = 0;
    constexpr double kWindows = 300;
    for (int window = 0; window < kWindows; ++window) {
      for (const std::size_t k : {0, 1}) {
        for (std::size_t p = 0; p < kPixels; ++p) {
          const double range = 3 + 0.01 * double(p % 48) + 0.003 * double(p / 48);
          data[p] = static_cast<float>(range * (k == 0 ? 1 + scale : 1) + 0.03 * random.quick_normal());
        }
        side[k].reserve(kPixels * sizeof(float)), side[k].info = RangeImageInfo{48, 36};
        testing::fill<float>(side[k], data);
      }
      ASSERT_TRUE(change.add(side[0], side[1]));
      Estimate e;
      change.finish(e);
      sum += e.value[1] / kWindows, squares += e.value[1] * e.value[1] / kWindows;
    }
    const double sigma = std::sqrt((squares - sum * sum) / kWindows);
    std::printf("  range scale %.5f ± %.5f of %.5f\n", sum, sigma, scale);
    EXPECT_NEAR(sum, scale, 3.5 * sigma);
  }
}

TEST(RangeImageChange, WhereAllIsDimTheOffsetIsToldStill) {
  constexpr std::size_t kPixels = 48 * 36;
  Random random(9);
  RangeImageChange change =
      RangeImageChange::make({48, 36}, {.sigma_m = 0.01, .noise_exponent = 0.5}).value();
  std::array<Sample, 2> side;
  std::vector<float> data(2 * kPixels);
  for (const std::size_t k : {0, 1}) {
    for (std::size_t p = 0; p < kPixels; ++p) {
      data[p] = static_cast<float>(3 + 0.01 * static_cast<double>(p % 48) + (k == 0 ? 0.02 : 0) +
                                   0.02 * random.quick_normal());
      data[kPixels + p] = 0.1F;
    }
    side[k].reserve(data.size() * sizeof(float)), side[k].info = RangeImageInfo{48, 36};
    testing::fill<float>(side[k], data);
  }
  ASSERT_TRUE(change.add(side[0], side[1]));
  Estimate e;
  change.finish(e);
  // Scale and offset of ranges between 3 and 3.5 m: together they are the 20 mm.
  ASSERT_TRUE(std::isfinite(e.value[0]) && std::isfinite(e.value[1]));
  EXPECT_NEAR(e.value[0] + 3.24 * e.value[1], 0.02, 0.004);
}

TEST(RangeImageChange, EmptyUnlikeAndIncompleteOnesSayNothing) {
  RangePair pair(RangeChange{}, 3);
  (void)pair.window(false);
  std::vector<float> nothing(2 * RangePair::kWidth * RangePair::kHeight,
                             std::numeric_limits<float>::quiet_NaN());
  testing::fill<float>(pair.real(), nothing);
  EXPECT_TRUE(pair.changes().add(pair.real(), pair.simulated()));
  Estimate e;
  pair.changes().finish(e);
  EXPECT_TRUE(std::isnan(e.value[0]));
  EXPECT_TRUE(std::isnan(e.value[5]));
  EXPECT_EQ(e.value[10], 1);  // lost, all of them
  pair.real().info = RangeImageInfo{36, 48};
  EXPECT_FALSE(pair.changes().add(pair.real(), pair.simulated()));
  pair.real().info = RangeImageInfo{RangePair::kWidth, RangePair::kHeight}, pair.real().size_bytes = 100;
  EXPECT_FALSE(pair.changes().add(pair.real(), pair.simulated()));
  EXPECT_FALSE(RangeImageChange::make({4, 4}, {}));
  EXPECT_FALSE(RangeImageChange::make({48, 36}, {.sigma_m = kNaN}));
  EXPECT_FALSE(RangeImageChange::make({48, 36}, {.noise_exponent = -1}));
}

struct NumberChange {
  double bias = 0, scale = 0, delay_s = 0, noise = 1;
};

/// A register that swings, one that stands still, and one that is a switch; at 100 Hz, windows of 10 s.
class NumberPair {
 public:
  NumberPair(std::size_t changed, const NumberChange& change, std::uint64_t seed, int instants = 1000)
      : random_(seed), changed_(changed), change_(change), instants_(instants) {
    changes_.emplace(
        ValueChange::make({{"speed", "m/s", 0}, {"voltage", "V", 0.01}, {"switch", "1", 0}}).value());
  }
  Estimate window(bool changed) {
    for (int i = 0; i < instants_; ++i) {
      t_s_ += 0.01;
      const NumberChange none, c = changed ? change_ : none;
      const auto of = [&](std::size_t k) { return k == changed_ ? c : none; };
      const double speed_at = t_s_ - of(0).delay_s;
      const double speed = 2 + std::sin(0.9 * speed_at) + 0.5 * std::sin(3.1 * speed_at);
      const double simulated_speed = 2 + std::sin(0.9 * t_s_) + 0.5 * std::sin(3.1 * t_s_);
      const auto steps = [](double x) { return 0.01 * std::round(x / 0.01); };
      const std::array<double, 3> real{
          speed * (1 + of(0).scale) + of(0).bias + 0.02 * of(0).noise * random_.quick_normal(),
          steps(24.1 + of(1).bias + 0.02 * of(1).noise * random_.quick_normal()), 1 + of(2).bias};
      const std::array<double, 3> simulated{simulated_speed + 0.02 * random_.quick_normal(),
                                            steps(24 + 0.02 * random_.quick_normal()), 1};
      EXPECT_TRUE(changes_->add(t_s_, real, simulated));
    }
    Estimate e;
    changes_->finish(e);
    return e;
  }
  ValueChange& changes() { return *changes_; }

 private:
  Random random_;
  std::size_t changed_;
  NumberChange change_;
  int instants_;  ///< in a window
  double t_s_ = 0;
  std::optional<ValueChange> changes_;
};

struct PlantedNumber {
  const char* name;
  std::size_t which;
  NumberChange change;
  double truth;
};
class ValueChanges : public ::testing::TestWithParam<PlantedNumber> {};

TEST_P(ValueChanges, AreFoundAndNamed) {
  NumberPair pair(GetParam().which, GetParam().change, 8);
  ChangeWatch watch = ChangeWatch::make(pair.changes().parameters(), testing::watch_options(100)).value();
  const int windows = testing::windows_to_alarm(
      watch, [&](bool c) { return pair.window(c); }, 100, 50);
  EXPECT_GE(windows, 1);
  EXPECT_LE(windows, 10);
  EXPECT_EQ(testing::name_of_alarm(watch), GetParam().name);
  EXPECT_NEAR(watch.alarm().change, GetParam().truth,
              0.1 * std::abs(GetParam().truth) + 4 * watch.alarm().sigma);
}

INSTANTIATE_TEST_SUITE_P(Planted, ValueChanges,
                         ::testing::Values(PlantedNumber{"speed bias", 0, {.bias = 0.02}, 0.02},
                                           PlantedNumber{"speed scale", 0, {.scale = 0.01}, 0.01},
                                           PlantedNumber{"speed delay", 0, {.delay_s = 0.005}, 0.005},
                                           // Real 4 and simulated 1, after 1 and 1.
                                           PlantedNumber{"speed noise", 0, {.noise = 2}, std::log(2.5)},
                                           PlantedNumber{"voltage bias", 1, {.bias = 0.01}, 0.01},
                                           PlantedNumber{"voltage noise", 1, {.noise = 2}, std::log(2.5)},
                                           PlantedNumber{"switch bias", 2, {.bias = -1}, -1}),
                         [](const auto& planted) {
                           std::string name = planted.param.name;
                           for (char& c : name)
                             if (c == ' ') c = '_';
                           return name;
                         });

TEST(ValueChange, TenThousandWindowsWithoutAChangeRaiseNoAlarm) {
  NumberPair pair(0, NumberChange{}, 5, 200);
  ChangeWatch watch = ChangeWatch::make(pair.changes().parameters(), testing::watch_options()).value();
  testing::expect_no_false_alarm(
      watch, [&](bool c) { return pair.window(c); }, 200);
}

TEST(ValueChange, NoneOneAndBrokenNumbersSayNothing) {
  EXPECT_FALSE(ValueChange::make({}));
  EXPECT_FALSE(ValueChange::make(std::vector<WatchedValue>(11, {"x", "1", 0})));
  EXPECT_FALSE(ValueChange::make({{"x", "1", -1}}));
  ValueChange c = ValueChange::make({{"x", "1", 0}}).value();
  Estimate e;
  c.finish(e);
  EXPECT_TRUE(std::isnan(e.value[0]));
  const std::array<double, 1> one{1}, broken{kNaN};
  const std::array<double, 2> two{1, 2};
  EXPECT_TRUE(c.add(0, one, one));
  c.finish(e);
  EXPECT_TRUE(std::isnan(e.value[0]));
  EXPECT_FALSE(c.add(1, one, two));
  EXPECT_FALSE(c.add(kNaN, one, one));
  for (int i = 0; i < 100; ++i) EXPECT_TRUE(c.add(i, broken, one));
  c.finish(e);
  EXPECT_TRUE(std::isnan(e.value[0]));
  for (int i = 0; i < 100; ++i) EXPECT_TRUE(c.add(5, one, one));  // time stands still
  c.finish(e);
  EXPECT_TRUE(std::isnan(e.value[0]));
  for (int i = 0; i < 100; ++i) EXPECT_TRUE(c.add(i, two, two) || c.add(i, one, one));
  c.finish(e);
  EXPECT_EQ(e.value[0], 0);
  EXPECT_TRUE(std::isnan(e.value[1]));  // it stands still: neither scale nor delay
}

}  // namespace
}  // namespace rigor::pair_watch
