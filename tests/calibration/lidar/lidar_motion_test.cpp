// Things that move while a LiDAR stands still: what they do to the noise that is fitted. People are planted
// in a simulated log and in one of a real scanner, whose noise without them is known.
#include <gtest/gtest.h>

#include <iostream>
#include <random>

#include "tests/calibration/lidar/recorded_returns.h"
#include "tests/calibration/lidar/simulated_room.h"

namespace rigor::calibration {
namespace {

/// A person: half a metre wide, rounded, in clothes whose surface is uneven.
struct Walker {
  double from_rad = 0, to_rad = 0;  ///< sector that is walked to and fro
  double range_m = 2;
  double passes = 3;    ///< over the sector in the whole log
  double sway_m = 0.3;  ///< to and from the sensor
  double units = 40;
};

/// The returns that would be behind the walkers are theirs.
std::size_t plant(LidarReturns& log, const std::vector<Walker>& walkers, std::uint64_t seed, double noise_m,
                  double step_m) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::size_t planted = 0;
  for (const Walker& w : walkers)
    for (LidarReturn& r : log.all) {
      const double azimuth = r.azimuth_rad;
      if (azimuth < w.from_rad - 0.2 || azimuth > w.to_rad + 0.2) continue;
      const double t = static_cast<double>(r.scan) / log.scans;
      const double way = std::abs(std::remainder(t * w.passes, 2.0));  // 0 … 1 … 0
      const double middle = w.from_rad + (w.to_rad - w.from_rad) * way;
      const double across = (azimuth - middle) * w.range_m / 0.25;
      if (std::abs(across) > 1) continue;
      const double body = w.range_m + w.sway_m * std::sin(9 * t + 2 * w.passes) +
                          0.15 * (1 - std::sqrt(1 - across * across)) + 0.01 * std::sin(40 * across + 30 * t);
      if (body > static_cast<double>(r.range_m)) continue;
      const double measured = body + noise_m * normal(random);
      r.range_m = static_cast<float>(step_m > 0 ? step_m * std::round(measured / step_m) : measured);
      r.remission = static_cast<float>(std::round(w.units * (1 + 0.1 * normal(random))));
      ++planted;
    }
  return planted;
}

/// Walkers over `share` of the beams: three to and fro, one who stands and sways for the whole log.
std::vector<Walker> walkers_over(double from_rad, double to_rad, double share, double units,
                                 std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> unit;
  const double width = share * (to_rad - from_rad);
  const double begin = from_rad + (to_rad - from_rad - width) * unit(random);
  std::vector<Walker> out;
  for (int k = 0; k < 3; ++k)
    out.push_back({begin, begin + width, 0.8 + 0.5 * k, 2 + 1.5 * k, 0.2, units * (0.6 + 0.4 * k)});
  out.push_back({begin + 0.5 * width, begin + 0.5 * width + 1e-3, 1.6, 1, 0.03, units});
  return out;
}

/// A 2D scanner of half a degree in a room of four walls, 3.6 mm of noise in whole millimetres.
LidarReturns flat_log(int scans, std::uint64_t seed, models::LidarModel& model) {
  test::Truth t;
  t.model = test::sixteen_beams(0.5);
  t.model.scan.beams.resize(1);
  t.model.scan.beams[0].elevation_rad = 0;
  t.model.range.step_m = 0.001;
  t.model.noise = {.floor_m = 0.0036, .scale_m = 0, .offset = 0, .exponent = 1};
  model = t.model;
  return test::measure(t, scans, seed);
}

TEST(LidarMotion, WalkersOnAnyShareOfTheBeamsDoNotChangeTheNoiseOfASimulatedLog) {
  models::LidarModel model;
  const LidarReturns still = flat_log(140, 1, model);
  const auto without = fit_range_noise(still, model, {.model = "constant"});
  ASSERT_TRUE(without) << without.error().text();
  EXPECT_NEAR(without->sigma_m, 0.0036, 0.01 * 0.0036);
  for (const double share : {0.05, 0.2, 0.4, 0.6})
    for (std::uint64_t seed = 0; seed < 3; ++seed) {
      LidarReturns log = still;
      const auto planted = plant(log, walkers_over(-3.1, 3.1, share, 40, seed), seed, 0.0036, 0.001);
      const auto fit = fit_range_noise(log, model, {.model = "constant"});
      ASSERT_TRUE(fit) << fit.error().text();
      std::cout << "share " << share << ", planted " << planted << " of " << log.all.size() << ": sigma "
                << 1e3 * fit->sigma_m << " mm, without " << 1e3 * without->sigma_m << "; by rounded values "
                << 1e3 * fit->rounded_sigma_m << ", without " << 1e3 * without->rounded_sigma_m << "\n";
      EXPECT_NEAR(fit->sigma_m, without->sigma_m, 0.03 * without->sigma_m) << share << " " << seed;
      EXPECT_NEAR(fit->rounded_sigma_m, without->rounded_sigma_m, 0.03 * without->rounded_sigma_m)
          << share << " " << seed;
    }
}

TEST(LidarMotion, WalkersOnAnyShareOfTheBeamsDoNotChangeTheNoiseOfALms511) {
  NEED_RECORDING("sick_lidar/20210301_lms511.json");
  const test::Recording r = test::read_returns("sick-lms511.yaml", "sick_lidar/20210301_lms511.json");
  const auto without = fit_range_noise(r.returns, r.sensor_model);
  ASSERT_TRUE(without) << without.error().text();
  double from = 10, to = -10;
  for (const LidarReturn& x : r.returns.all)
    from = std::min(from, static_cast<double>(x.azimuth_rad)),
    to = std::max(to, static_cast<double>(x.azimuth_rad));
  for (const double share : {0.05, 0.2, 0.4, 0.6})
    for (std::uint64_t seed = 0; seed < 2; ++seed) {
      LidarReturns log = r.returns;
      const auto planted =
          plant(log, walkers_over(from, to, share, 150, seed), seed, 0.0036, r.sensor_model.range.step_m);
      const auto fit = fit_range_noise(log, r.sensor_model);
      ASSERT_TRUE(fit) << fit.error().text();
      std::cout << "share " << share << ", planted " << planted << " of " << log.all.size() << ": sigma "
                << 1e3 * fit->sigma_m << " mm, without " << 1e3 * without->sigma_m << "; by rounded values "
                << 1e3 * fit->rounded_sigma_m << ", without " << 1e3 * without->rounded_sigma_m << "; "
                << fit->result.model << "; bands";
      for (const NoiseBand& b : fit->bands) std::cout << " " << 1e3 * b.measured_m;
      std::cout << "\n";
      EXPECT_NEAR(fit->sigma_m, without->sigma_m, 0.03 * without->sigma_m) << share << " " << seed;
      EXPECT_NEAR(fit->rounded_sigma_m, without->rounded_sigma_m, 0.03 * without->rounded_sigma_m)
          << share << " " << seed;
    }
}

/// Leaves in the wind: white noise from scan to scan, wider than the device's. Judged by its own beam it is
/// noise; the bins of remission beside it say what it is.
TEST(LidarMotion, ABandThatFluttersWithoutMemoryIsLeftOutOrNamed) {
  models::LidarModel model;
  LidarReturns log = flat_log(140, 2, model);
  const auto without = fit_range_noise(log, model, {.model = "constant"});
  ASSERT_TRUE(without) << without.error().text();
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  for (LidarReturn& r : log.all)
    if (r.azimuth_rad > 0.2F && r.azimuth_rad < 1.0F)
      r.range_m += static_cast<float>(0.001 * std::round(9 * normal(random)));
  const auto fit = fit_range_noise(log, model, {.model = "constant"});
  ASSERT_TRUE(fit) << fit.error().text();
  const bool left_out = std::abs(fit->sigma_m / without->sigma_m - 1) < 0.03;
  EXPECT_TRUE(left_out || !fit->result.warnings.empty()) << fit->sigma_m;
}

}  // namespace
}  // namespace rigor::calibration
