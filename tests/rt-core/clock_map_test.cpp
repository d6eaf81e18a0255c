#include "rt-core/clock_map.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <random>
#include <thread>

namespace rigor {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;

/// A device clock that is known exactly: x = x0 + (t − t0)·(1 + drift).
struct Device {
  std::int64_t x0, t0;
  double drift;
  [[nodiscard]] DeviceTime at(std::int64_t t) const {
    return DeviceTime(x0 + (t - t0) + std::llround(static_cast<double>(t - t0) * drift));
  }
};

/// One latch at bench time t: the request takes `out` ns, the answer `back` ns.
ClockMap::Update latch(ClockMap& map, const Device& d, std::int64_t t, double out, double back) {
  return map.add_latch(d.at(t), BenchTime(t - std::llround(out)), BenchTime(t + std::llround(back)));
}

// Mean square of error / sigma over `n` seeds is chi-squared / n; five standard deviations around 1.
double upper_limit(int n) { return 1 + 5 * std::sqrt(2.0 / n); }

TEST(ClockMap, KnowsNothingBeforeTheFirstPair) {
  ClockMap map;
  EXPECT_FALSE(map.map(DeviceTime(5)).known);
  EXPECT_EQ(map.unmap(BenchTime(5)).ns(), 0);
}

TEST(ClockMap, OneLatchGivesTheOffsetAndAnUncertaintyThatGrowsWithThePriorOfTheDrift) {
  ClockMap map;
  EXPECT_EQ(map.add_latch(DeviceTime(1000), BenchTime(5'000'000), BenchTime(5'100'000)),
            ClockMap::Update::used);
  const Mapped here = map.map(DeviceTime(1000));
  ASSERT_TRUE(here.known);
  EXPECT_EQ(here.t.ns(), 5'050'000);
  // Uniform in 100 us: 28.9 us as scatter and the same as a bias that could be.
  EXPECT_NEAR(static_cast<double>(here.sigma.ns()), 100'000 / std::sqrt(12.0) * std::sqrt(2.0), 200);
  const Mapped later = map.map(DeviceTime(1000 + 10 * kSecond));
  EXPECT_EQ(later.t.ns(), 5'050'000 + 10 * kSecond);
  EXPECT_NEAR(static_cast<double>(later.sigma.ns()), 10e9 * 100e-6, 10e9 * 100e-6 * 0.01);
}

TEST(ClockMap, TheFirstArrivalIsWhereItSaysAndNotAGuessedMillisecondEarlier) {
  ClockMap map({.min_delay = microseconds(120)});
  (void)map.add_arrival(DeviceTime(1000), BenchTime(5'120'000));
  const Mapped first = map.map(DeviceTime(1000));
  ASSERT_TRUE(first.known);
  EXPECT_EQ(first.t.ns(), 5'000'000);
  EXPECT_GE(first.sigma, milliseconds(1)) << "how late it was nobody knows";
  // A device that sends once in a while, each time as quickly: its samples lie as far apart as it says.
  for (std::int64_t k = 1; k < 20; ++k) {
    const std::int64_t before = map.map(DeviceTime(1000 + k * kSecond)).t.ns();
    (void)map.add_arrival(DeviceTime(1000 + k * kSecond), BenchTime(5'120'000 + k * kSecond));
    EXPECT_NEAR(static_cast<double>(map.map(DeviceTime(1000 + k * kSecond)).t.ns() - before), 0, 2) << k;
  }
}

TEST(ClockMap, AFirstLateArrivalOfASecondDoesNotMoveTheMap) {
  ClockMap map;
  const auto add = [&](std::int64_t t, std::int64_t delay) {
    (void)map.add_arrival(DeviceTime(t), BenchTime(t + delay));
  };
  for (std::int64_t t = 0; t < kSecond; t += 1'000'000) add(t, t % 7'000'000 / 100);  // 0 to 60 us
  const std::int64_t before = map.map(DeviceTime(kSecond)).t.ns();
  add(kSecond, 700'000);  // a new segment begins with it
  EXPECT_NEAR(static_cast<double>(map.map(DeviceTime(kSecond)).t.ns() - before), 0, 2'000);
}

// What sigma promises: offset error of many devices, each with its own drift, asymmetry and jitter.
TEST(ClockMap, LatchErrorsAgreeWithTheStatedSigmaOverSeeds) {
  constexpr int kSeeds = 400;
  double z2 = 0, drift_z2 = 0, sigma_sum = 0, error_sum = 0;
  for (int seed = 0; seed < kSeeds; ++seed) {
    std::mt19937_64 rng(static_cast<std::uint64_t>(seed) + 1);
    std::uniform_real_distribution<double> u(0, 1);
    const Device d{static_cast<std::int64_t>(u(rng) * 1e15), 77 * kSecond, (u(rng) - 0.5) * 100e-6};
    ClockMap map;
    const double asymmetry = u(rng);  // of the shortest round trip: unknowable, the same for all latches
    for (int i = 0; i < 40; ++i) {
      const double jitter = -std::log(1 - u(rng)) * 30'000, where = u(rng);
      latch(map, d, d.t0 + i * kSecond, asymmetry * 80'000 + where * jitter,
            (1 - asymmetry) * 80'000 + (1 - where) * jitter);
    }
    const std::int64_t t = d.t0 + 40 * kSecond;
    const Mapped m = map.map(d.at(t));
    const double error = static_cast<double>(m.t.ns() - t);
    z2 += std::pow(error / static_cast<double>(m.sigma.ns()), 2);
    sigma_sum += static_cast<double>(m.sigma.ns());
    error_sum += std::abs(error);
    const auto s = map.state();
    // drift of the map is dt/dx − 1, the negative of the device's to first order
    drift_z2 += (s.drift + d.drift) * (s.drift + d.drift) / s.var_drift;
  }
  EXPECT_LT(z2 / kSeeds, upper_limit(kSeeds));
  EXPECT_GT(z2 / kSeeds, 0.4) << "sigma is far too cautious";
  // A latch's window bounds its error, so the fit is better than its a-priori sigma says; never worse.
  EXPECT_LT(drift_z2 / kSeeds, upper_limit(kSeeds));
  EXPECT_LT(sigma_sum / kSeeds, 60'000) << "mean error " << error_sum / kSeeds;
}

TEST(ClockMap, RecoversADriftOf50ppmFromLatches) {
  std::mt19937_64 rng(3);
  std::uniform_real_distribution<double> u(0, 1);
  const Device d{123'456'789, 9 * kSecond, 50e-6};
  ClockMap map;
  for (int i = 0; i < 60; ++i)
    latch(map, d, d.t0 + i * kSecond, 40'000 + u(rng) * 20'000, 40'000 + u(rng) * 20'000);
  const auto s = map.state();
  EXPECT_NEAR(s.drift, -50e-6, 4 * std::sqrt(s.var_drift));
  EXPECT_LT(std::sqrt(s.var_drift), 1e-6);
  EXPECT_EQ(s.generation, 0u);
}

// Frames that arrive with a one-sided delay of any shape: what is left is the floor's uncertainty.
TEST(ClockMap, ArrivalErrorsAgreeWithTheStatedSigmaOverSeeds) {
  for (const double shape : {1.0, 2.0}) {
    constexpr int kSeeds = 300;
    double z2 = 0, sigma_rms = 0, error_rms = 0;
    int far = 0;
    for (int seed = 0; seed < kSeeds; ++seed) {
      std::mt19937_64 rng(static_cast<std::uint64_t>(seed) * 7 + 5);
      std::uniform_real_distribution<double> u(0, 1);
      std::gamma_distribution<double> delay(shape, 200'000 / shape);
      const Device d{static_cast<std::int64_t>(u(rng) * 1e12), 5 * kSecond, (u(rng) - 0.5) * 100e-6};
      ClockMap map({.min_delay = microseconds(150), .min_delay_sigma = microseconds(1)});
      for (int i = 0; i < 25 * 80; ++i) {
        const std::int64_t t = d.t0 + i * 40'000'000LL;
        map.add_arrival(d.at(t), BenchTime(t + 150'000 + std::llround(delay(rng))));
      }
      const std::int64_t t = d.t0 + 80 * kSecond;
      const Mapped m = map.map(d.at(t));
      ASSERT_TRUE(m.known);
      const double error = static_cast<double>(m.t.ns() - t), sigma = static_cast<double>(m.sigma.ns());
      z2 += error * error / (sigma * sigma);
      sigma_rms += sigma * sigma;
      error_rms += error * error;
      far += std::abs(error) > 3 * sigma;
    }
    EXPECT_LT(z2 / kSeeds, upper_limit(kSeeds)) << "shape " << shape;
    EXPECT_LE(far, 6) << "of " << kSeeds << " beyond three sigma, shape " << shape;
    // It has to beat the plain mean of the delays (200 us ± 200 us) by a wide margin.
    EXPECT_LT(std::sqrt(error_rms / kSeeds), 60'000) << "shape " << shape;
    EXPECT_LT(std::sqrt(sigma_rms / kSeeds), 90'000) << "shape " << shape;
  }
}

TEST(ClockMap, LatchesOutrankArrivals) {
  const Device d{0, kSecond, 0};
  ClockMap map;
  latch(map, d, 2 * kSecond, 10'000, 10'000);
  EXPECT_EQ(map.add_arrival(d.at(2 * kSecond), BenchTime(2 * kSecond + 900'000)), ClockMap::Update::ignored);
  EXPECT_EQ(map.map(d.at(3 * kSecond)).t.ns(), 3 * kSecond);
}

TEST(ClockMap, AStepForwardsIsBelievedWithItsSecondWitness) {
  Device d{0, kSecond, 20e-6};
  ClockMap map;
  for (int i = 0; i < 20; ++i)
    EXPECT_EQ(latch(map, d, d.t0 + i * kSecond, 30'000, 30'000), ClockMap::Update::used);
  const std::int64_t t = d.t0 + 20 * kSecond;
  d.x0 += 5 * kSecond;
  EXPECT_EQ(latch(map, d, t, 30'000, 30'000), ClockMap::Update::suspected);
  EXPECT_EQ(map.state().generation, 0u);
  EXPECT_EQ(latch(map, d, t + kSecond, 30'000, 30'000), ClockMap::Update::reset);
  EXPECT_EQ(map.state().generation, 1u);
  EXPECT_NEAR(static_cast<double>(map.map(d.at(t + kSecond)).t.ns()), static_cast<double>(t + kSecond), 100);
}

TEST(ClockMap, OneWildLatchChangesNothing) {
  const Device d{0, kSecond, 20e-6};
  ClockMap map;
  for (int i = 0; i < 20; ++i) latch(map, d, d.t0 + i * kSecond, 30'000, 30'000);
  const auto before = map.state();
  const std::int64_t t = d.t0 + 20 * kSecond;
  EXPECT_EQ(map.add_latch(DeviceTime(d.at(t).ns() + 77 * kSecond), BenchTime(t), BenchTime(t + 1000)),
            ClockMap::Update::suspected);
  EXPECT_EQ(latch(map, d, t + kSecond, 30'000, 30'000), ClockMap::Update::used);
  EXPECT_EQ(map.state().generation, before.generation);
}

TEST(ClockMap, ARollbackResetsAtOnce) {
  Device d{1000 * kSecond, kSecond, 0};
  ClockMap map;
  for (int i = 0; i < 5; ++i) latch(map, d, d.t0 + i * kSecond, 30'000, 30'000);
  d.x0 = -10 * kSecond;  // restarted
  EXPECT_EQ(latch(map, d, d.t0 + 6 * kSecond, 30'000, 30'000), ClockMap::Update::reset);
  EXPECT_EQ(map.state().generation, 1u);
  EXPECT_EQ(map.map(d.at(d.t0 + 6 * kSecond)).t.ns(), d.t0 + 6 * kSecond);
}

TEST(ClockMap, ArrivalsNoticeADeviceThatRestarted) {
  Device d{1000 * kSecond, kSecond, 0};
  ClockMap map;
  for (int i = 0; i < 200; ++i) {
    const std::int64_t t = d.t0 + i * 40'000'000LL;
    map.add_arrival(d.at(t), BenchTime(t + 300'000));
  }
  d.x0 = 0;
  const std::int64_t t = d.t0 + 10 * kSecond;
  EXPECT_EQ(map.add_arrival(d.at(t), BenchTime(t + 300'000)), ClockMap::Update::reset);
}

TEST(ClockMap, ABurstOfLateArrivalsIsNoStep) {
  const Device d{0, kSecond, 0};
  ClockMap map;
  int i = 0;
  const auto add = [&](std::int64_t delay) {
    const std::int64_t t = d.t0 + i++ * 40'000'000LL;
    return map.add_arrival(d.at(t), BenchTime(t + delay));
  };
  for (int k = 0; k < 200; ++k) add(300'000);
  for (int k = 0; k < 6; ++k) EXPECT_EQ(add(20'000'000), ClockMap::Update::ignored);  // the host stalled
  for (int k = 0; k < 50; ++k) add(300'000);
  EXPECT_EQ(map.state().generation, 0u);
  EXPECT_NEAR(static_cast<double>(map.map(d.at(20 * kSecond)).t.ns() - 20 * kSecond), 300'000, 1000);
}

TEST(ClockMap, CountersNearTheEndOfTheirRangeLoseNothing) {
  const std::int64_t huge = (std::int64_t{1} << 62) + 12345;
  const Device d{huge, 3 * kSecond, 30e-6};
  ClockMap map;
  for (int i = 0; i < 30; ++i) latch(map, d, d.t0 + i * kSecond, 500, 500);
  const std::int64_t t = d.t0 + 30 * kSecond + 1;
  EXPECT_NEAR(static_cast<double>(map.map(d.at(t)).t.ns() - t), 0, 20);
  EXPECT_NEAR(static_cast<double>(map.unmap(BenchTime(t)).ns() - d.at(t).ns()), 0, 20);
  // As far from the pairs as int64 goes: an uncertainty, or an honest "unknown"; never undefined behaviour.
  (void)map.map(DeviceTime(std::numeric_limits<std::int64_t>::min()));
  (void)map.map(DeviceTime(std::numeric_limits<std::int64_t>::max()));
}

TEST(ClockMap, WindowsWithoutSenseAreIgnored) {
  ClockMap map;
  EXPECT_EQ(map.add_latch(DeviceTime(0), BenchTime(10), BenchTime(5)), ClockMap::Update::ignored);
  EXPECT_FALSE(map.map(DeviceTime(0)).known);
}

TEST(ClockMap, ReadersSeeWholeStatesWhileTheDeviceThreadWrites) {
  ClockMap map;
  const Device d{0, kSecond, 50e-6};
  latch(map, d, d.t0, 10, 10);
  std::atomic<bool> end{false};
  std::atomic<std::uint64_t> torn{0}, reads{0};
  std::thread reader([&] {
    while (!end) {
      const auto s = map.state();
      // Every published state maps its own reference to within the drift that may be.
      if (std::abs(static_cast<double>(s.t_ref - s.x_ref - kSecond) + s.offset_ns) > 1e6) ++torn;
      ++reads;
    }
  });
  for (int i = 1; i < 20'000; ++i) latch(map, d, d.t0 + i * 1'000'000LL, 10, 10);
  while (reads < 100) std::this_thread::yield();
  end = true;
  reader.join();
  EXPECT_EQ(torn, 0u);
}

}  // namespace
}  // namespace rigor
