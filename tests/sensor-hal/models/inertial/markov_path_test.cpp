#include "sensor-hal/models/markov_path.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "tests/sensor-hal/models/inertial/statistics.h"

namespace rigor::models {
namespace {

using test::expect_mean;
using test::Mean;

constexpr auto kEffect = NoiseEffect::imu_walk;
constexpr int kKeys = 1000;

PhiloxKey key_of(int seed) { return channel_key(static_cast<std::uint64_t>(seed), 7); }

TEST(MarkovPath, GivesTheSameValueWhateverWasAskedBefore) {
  for (const bool walk : {false, true}) {
    const auto make = [&] {
      return walk ? MarkovPath::walk(key_of(3), kEffect, 1)
                  : MarkovPath::stationary(key_of(3), kEffect, 1, 50);
    };
    MarkovPath rising = make();
    std::vector<std::array<double, 3>> values;
    for (std::uint64_t i = 0; i < 5000; ++i) values.push_back(rising.at(i));
    MarkovPath jumping = make();
    for (std::uint64_t i = 0, k = 0; i < 5000; ++i, k = (k + 2741) % 5000)
      ASSERT_EQ(jumping.at(k), values[k]) << k;
    const std::uint64_t far = (std::uint64_t{1} << 39) + 12345;
    const auto late = jumping.at(far);
    ASSERT_EQ(rising.at(4999), values[4999]);
    ASSERT_EQ(rising.at(far), late);
    ASSERT_EQ(make().at(0), values[0]);
    ASSERT_NE(values[1], values[2]);
  }
}

TEST(MarkovPath, IsCorrelatedAsItShouldBeAcrossEveryKindOfBorder) {
  constexpr double kT = 300;
  struct Pair {
    std::uint64_t i, k;
  };
  for (const Pair p : {Pair{0, 1},
                       {0, 300},
                       {5, 205},
                       {1023, 1024},
                       {1000, 1300},
                       {(1u << 20) - 100, (1u << 20) + 100},
                       {777'777, 779'777},
                       {1'000'000, 1'000'000}}) {
    Mean product;
    for (int seed = 0; seed < kKeys; ++seed) {
      MarkovPath path = MarkovPath::stationary(key_of(seed), kEffect, 0, kT);
      const auto a = path.at(p.i), b = path.at(p.k);
      for (std::size_t axis = 0; axis < 3; ++axis) product.add(a[axis] * b[axis]);
    }
    expect_mean(product, std::exp(-static_cast<double>(p.k - p.i) / kT), "correlation");
  }
  Mean between_axes;
  for (int seed = 0; seed < kKeys; ++seed) {
    const auto a = MarkovPath::stationary(key_of(seed), kEffect, 0, kT).at(100);
    between_axes.add(a[0] * a[1]);
  }
  expect_mean(between_axes, 0, "axes");
}

TEST(MarkovPath, OfAWalkGrowsByOneWithEachCaptureAndForgets) {
  Mean near, far, product;
  for (int seed = 0; seed < kKeys; ++seed) {
    MarkovPath path = MarkovPath::walk(key_of(seed), kEffect, 0);
    ASSERT_EQ(path.at(0), (std::array<double, 3>{}));
    const auto a = path.at(4000), b = path.at(4001), c = path.at(104'000);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      near.add(std::pow(b[axis] - a[axis], 2));
      far.add(std::pow(c[axis] - a[axis], 2) / 100'000);
      product.add((c[axis] - b[axis]) * (b[axis] - a[axis]));
    }
  }
  expect_mean(near, 1, "a step");
  expect_mean(far, 1, "many steps");
  expect_mean(product, 0, "steps that follow each other");
}

}  // namespace
}  // namespace rigor::models
