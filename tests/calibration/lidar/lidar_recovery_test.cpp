// The loop closes: what the simulator's formulas made is found again, as surely as is said. Seeds 0 … 99.
#include <gtest/gtest.h>

#include <Eigen/Dense>

#include <iostream>
#include <random>

#include "tests/calibration/lidar/simulated_room.h"

namespace rigor::calibration {
namespace {

using test::measure;
using test::sixteen_beams;
using test::Truth;

/// Joint normalised error and how many intervals hold the truth.
struct Judge {
  double chi_square = 0;
  int degrees = 0, inside = 0;
  int open = 0;  ///< parameters of which the fit says that the data leave them open

  void add(const FitResult& f, std::vector<std::pair<std::string, double>> truth) {
    open += static_cast<int>(std::erase_if(truth, [&](const auto& t) {
      const Parameter* p = f.find(t.first);
      return p && !std::isfinite(p->sigma);
    }));
    if (truth.empty()) return;
    Eigen::VectorXd e(truth.size());
    Eigen::MatrixXd c(truth.size(), truth.size());
    for (std::size_t i = 0; i < truth.size(); ++i) {
      const int a = f.index_of(truth[i].first);
      ASSERT_GE(a, 0) << truth[i].first;
      const Parameter& p = f.parameters[static_cast<std::size_t>(a)];
      const auto k = static_cast<Eigen::Index>(i);
      e[k] = p.value - truth[i].second;
      inside += std::abs(e[k]) <= 1.959964 * p.sigma;
      for (std::size_t j = 0; j < truth.size(); ++j)
        c(k, static_cast<Eigen::Index>(j)) = f.covariance(a, f.index_of(truth[j].first));
    }
    chi_square += e.dot(c.ldlt().solve(e));
    degrees += static_cast<int>(truth.size());
  }
  /// Limits at 0.001 in all: normal approximations of χ² (Wilson–Hilferty) and of the binomial.
  /// `excess`: a known one, by which the stated standard uncertainties are too small.
  void expect(const char* what) const {
    const double n = degrees, a = 2 / (9 * n);
    const double low = n * std::pow(1 - a - 3.2905 * std::sqrt(a), 3),
                 high = n * std::pow(1 - a + 3.2905 * std::sqrt(a), 3);
    const double share = inside / n, width = 3.2905 * std::sqrt(0.95 * 0.05 / n);
    std::cout << what << ": chi-squared/dof " << chi_square / n << " (" << low / n << " to " << high / n
              << "), inside 95 %: " << share << " (" << 0.95 - width << " to " << 0.95 + width << ")\n";
    EXPECT_GT(chi_square, low) << what;
    EXPECT_LT(chi_square, high) << what;
    EXPECT_GT(share, 0.95 - width) << what;
    EXPECT_LT(share, 0.95 + width) << what;
  }
};

std::string at(const char* name, std::size_t i) { return std::string(name) + "[" + std::to_string(i) + "]"; }

TEST(LidarRecovery, BiasesNoiseAndGainsComeBackAsSurelyAsIsSaid) {
  Judge biases, noise, gains;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> draw;
    Truth t;
    t.model = sixteen_beams(3);
    std::vector<std::pair<std::string, double>> bias_truth, gain_truth;
    double mean_log = 0;
    for (auto& b : t.model.scan.beams) {
      b.range_bias_m = 0.02 * draw(random);
      b.remission_gain = std::exp(0.1 * draw(random));
      mean_log += std::log(b.remission_gain) / 16;
    }
    for (std::size_t b = 0; b < 16; ++b) {
      bias_truth.emplace_back(at("beam_bias_m", b), t.model.scan.beams[b].range_bias_m);
      // The last is what the others leave: against their mean 15 of 16 are free.
      if (b < 15)
        gain_truth.emplace_back(at("remission_gain", b),
                                t.model.scan.beams[b].remission_gain / std::exp(mean_log));
    }
    // Remission is told through gains: a sensor model without them would see it blurred. Noise has its own
    // test.
    const LidarReturns returns = measure(t, 6, seed);
    models::LidarModel sensor_model = sixteen_beams(3);
    const auto fit = fit_lidar(returns, sensor_model, {.model = "beams", .noise_model = "offset"});
    ASSERT_TRUE(fit) << fit.error().text();
    biases.add(fit->result, bias_truth);
    if (fit->result.index_of("remission_gain[0]") >= 0) gains.add(fit->result, gain_truth);

    Truth plain;
    plain.model = sensor_model;
    const auto n = fit_range_noise(measure(plain, 12, seed), sensor_model, {.model = "offset"});
    ASSERT_TRUE(n) << n.error().text();
    noise.add(n->result, {{"noise_scale_m", 0.0063}, {"noise_offset", 0.17}});
  }
  biases.expect("biases of beams");
  noise.expect("noise");
  EXPECT_EQ(gains.degrees, 1500);
  gains.expect("gains");
}

/// Waves of all lengths from 8 degrees of azimuth on that run all the way up the walls, by azimuth.
std::function<double(std::uint16_t, double)> walls_with_boards(std::uint64_t seed, double rms_m) {
  std::mt19937_64 random(seed + 77);
  std::uniform_real_distribution<double> draw;
  constexpr int kWaves = 40;
  std::vector<std::pair<double, double>> waves;
  for (int i = 0; i < kWaves; ++i) {
    const double length_deg = 8 + 17 * draw(random);
    waves.emplace_back(std::round(360 / length_deg * std::cos(2 * M_PI * draw(random))),
                       2 * M_PI * draw(random));
  }
  return [=](std::uint16_t, double azimuth) {
    double sum = 0;
    for (const auto& [times, phase] : waves) sum += std::sin(times * azimuth + phase);
    return rms_m * sum / std::sqrt(kWaves / 2.0);
  };
}

/// As uneven, but alike over so many degrees at most: a first-order autoregression in steps of 0.1 degrees.
std::function<double(std::uint16_t, double)> walls_that_wander(std::uint64_t seed, double rms_m,
                                                               double length_deg) {
  std::mt19937_64 random(seed + 77);
  std::normal_distribution<double> draw;
  constexpr std::size_t kSteps = 3600;
  std::vector<double> at(kSteps);
  const double rho = std::exp(-0.1 / length_deg);
  double x = draw(random);
  for (double& a : at) a = x = rho * x + std::sqrt(1 - rho * rho) * draw(random);
  return [=](std::uint16_t, double azimuth) {
    return rms_m * at[static_cast<std::size_t>(azimuth * 1800 / M_PI + 10 * kSteps) % kSteps];
  };
}

/// Of such walls all beams err alike at an azimuth. Taken as independent witnesses they made a bias more than
/// three times too sure.
void expect_honest(const std::function<std::function<double(std::uint16_t, double)>(std::uint64_t)>& walls) {
  constexpr int kSeeds = 24;
  Judge offset, beams;
  double columns = 0;
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    Truth t;
    t.uneven_m = walls(seed);
    const LidarReturns returns = measure(t, 2, seed);
    for (const char* model : {"offset", "beams"}) {
      const auto fit = fit_lidar(returns, sixteen_beams(), {.model = model, .noise_model = "offset"});
      ASSERT_TRUE(fit) << fit.error().text();
      const bool all = std::string(model) == "offset";
      if (all)
        offset.add(fit->result, {{"range_bias_m", 0}});
      else  // together: what they differ by, too
        beams.add(fit->result, {{"beam_bias_m[5]", 0}, {"beam_bias_m[10]", 0}});
      columns += fit->bias->column_correlation / (2 * kSeeds);
    }
  }
  std::cout << "mean correlation of a column " << columns << "\n";
  EXPECT_GT(columns, 0.25);
  offset.expect("bias of all beams");
  beams.expect("biases of two beams");
}

TEST(LidarRecovery, WallsThatAreUnevenAlikeForAllBeamsAreInTheUncertainty) {
  expect_honest([](std::uint64_t seed) { return walls_with_boards(seed, 0.005); });
}

/// What the walls' own numbers take from the residuals made a bias 1.8 times too sure.
TEST(LidarRecovery, WallsThatWanderAlikeForAllBeamsAreInTheUncertainty) {
  expect_honest([](std::uint64_t seed) { return walls_that_wander(seed, 0.005, 4); });
}

TEST(LidarRecovery, AnglesAndWalkComeBackAsSurelyAsIsSaid) {
  Judge judge;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    std::mt19937_64 random(seed + 1000);
    std::normal_distribution<double> draw;
    Truth t;
    t.model = sixteen_beams(2);
    t.walls.push_back({Eigen::Vector3d(0.02, 0.01, -1).normalized(), 1.1, 0.6});
    t.walls.push_back({Eigen::Vector3d(0.01, -0.03, 1).normalized(), 1.4, 0.7});
    t.model.range.remission_bias_m = 0.02;
    std::vector<std::pair<std::string, double>> truth{{"remission_bias_m", t.model.range.remission_bias_m}};
    for (std::size_t b = 0; b < 16; ++b) {
      auto& beam = t.model.scan.beams[b];
      beam.range_bias_m = 0.02 * draw(random);
      beam.elevation_rad += 0.002 * draw(random);
      if (b > 0) beam.azimuth_rad += 0.002 * draw(random);
      truth.emplace_back(at("beam_bias_m", b), beam.range_bias_m);
      truth.emplace_back(at("beam_elevation_rad", b), beam.elevation_rad);
      if (b > 0) truth.emplace_back(at("beam_azimuth_rad", b), beam.azimuth_rad);
    }
    const LidarReturns returns = measure(t, 4, seed);
    const models::LidarModel sensor_model = sixteen_beams(2);
    BiasFitOptions o;
    for (const BiasModel& m : bias_models(16, false, false))
      if (m.name == "beams+angles+walk") o.models = {m};
    ASSERT_EQ(o.models.size(), 1u);
    const auto planes = find_planes(returns, sensor_model.scan, {.minimum_share = 0.04});
    const auto noise = fit_range_noise(returns, sensor_model, {.model = "offset"});
    ASSERT_TRUE(noise) << noise.error().text();
    o.sigma_m = [m = noise->model](double e) { return std::hypot(m.sigma_m(e), 0.002 / std::sqrt(12)); };
    o.remission_sigma = [](double e) { return std::hypot(0.02 * e, 0.01 / std::sqrt(12)); };
    const auto fit = fit_biases(returns, sensor_model, planes, o);
    ASSERT_TRUE(fit) << fit.error().text();
    if (seed == 0) {
      for (const auto& p : fit->planes) std::cout << p.name << " " << p.returns << "\n";
      for (const auto& w : fit->result.weak) std::cout << w.sigma << " " << w.words << "\n";
    }
    judge.add(fit->result, truth);
  }
  judge.expect("biases, angles and walk");
  // A beam that sees the floor alone has its bias, its angles and the floor's distance open: said, not told.
  EXPECT_LE(judge.open, judge.degrees / 50);
}

TEST(LidarRecovery, ScaleAndIncidenceComeBackFromSurveyedWalls) {
  Judge judge;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    Truth t;
    t.model = sixteen_beams(4);
    t.model.range.scale = 1.004;
    t.model.range.incidence_bias_m = 0.03;
    std::vector<LidarPlane> walls;
    for (const auto& w : t.walls) {
      LidarPlane p;
      p.name = "surveyed";
      p.q_per_m = w.normal / w.distance_m;
      walls.push_back(p);
    }
    const auto fit = fit_lidar(measure(t, 6, seed), sixteen_beams(4),
                               {.model = "beams+oblique+scale", .noise_model = "offset", .surveyed = walls});
    ASSERT_TRUE(fit) << fit.error().text();
    std::vector<std::pair<std::string, double>> truth{{"range_scale", t.model.range.scale},
                                                      {"incidence_bias_m", t.model.range.incidence_bias_m}};
    for (std::size_t b = 0; b < 16; ++b) truth.emplace_back(at("beam_bias_m", b), 0);
    judge.add(fit->result, truth);
    // What was fitted is what a simulator plays.
    EXPECT_EQ(fit->model.range.scale, fit->result.find("range_scale")->value);
    EXPECT_EQ(fit->model.range.incidence_bias_m, fit->result.find("incidence_bias_m")->value);
  }
  judge.expect("scale, incidence and biases");
}

TEST(LidarRecovery, LeastRemissionIsFoundWhereItCutsAndBoundedWhereItDoesNot) {
  int inside = 0, sharp = 0;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> even(0, 0.4);
    std::normal_distribution<double> draw;
    std::vector<double> cut, bell;
    for (int i = 0; i < 20000; ++i) {
      const double e = even(random);
      if (e >= 0.08) cut.push_back(e * (1 + 0.02 * draw(random)));
      bell.push_back(0.3 * std::exp(0.3 * draw(random)));
    }
    const auto edge = detection_edge(cut, 0.02 * 0.08, 0);
    ASSERT_TRUE(edge && edge->sharp);
    inside += std::abs(edge->at - 0.08) < 1.96 * edge->sigma;
    const auto none = detection_edge(bell, 0.002, 0);
    ASSERT_TRUE(none);
    sharp += none->sharp;
  }
  std::cout << "edge inside 95 %: " << inside << ", sharp without one: " << sharp << "\n";
  EXPECT_GE(inside, 87);
  EXPECT_EQ(sharp, 0);
}

TEST(LidarRecovery, LeastRemissionThatGrowsWithRangeIsFound) {
  using Math = models::LidarMath<double>;
  models::LidarDetection truth;
  truth.minimum_remission = 0.05, truth.limit_remission = 0.1, truth.limit_range_m = 20;
  int found = 0, floors = 0, limits = 0, alone = 0;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> even(0, 0.4), range(2, 60);
    std::normal_distribution<double> draw;
    std::vector<double> e, r, near_e, near_r;
    for (int i = 0; i < 30000; ++i) {
      const double x = even(random), at = range(random);
      if (x < Math::lidar_least_remission(at, truth.minimum_remission, truth.limit_remission,
                                          truth.limit_range_m, 0))
        continue;
      e.push_back(x * (1 + 0.02 * draw(random))), r.push_back(at);
      if (at < 12) near_e.push_back(e.back()), near_r.push_back(at);
    }
    const DetectionFit d = fit_detection(e, r, 0.02, 0, truth);
    if (!d.floor || !d.limit) continue;
    ++found;
    EXPECT_EQ(d.limit_range_m, 20);
    floors += std::abs(d.floor->at - 0.05) < 1.96 * d.floor->sigma;
    limits += std::abs(d.limit->at - 0.1) < 1.96 * d.limit->sigma;
    // Nearer than where power decides there is the floor alone.
    const DetectionFit n = fit_detection(near_e, near_r, 0.02, 0, truth);
    alone += n.floor && !n.limit;
  }
  std::cout << "both found " << found << ", inside 95 %: floor " << floors << ", limit " << limits
            << "; floor alone " << alone << "\n";
  EXPECT_GE(found, 95);
  EXPECT_GE(floors, found - 12);  // binomial at 0.001
  EXPECT_GE(limits, found - 12);
  EXPECT_GE(alone, 95);
}

}  // namespace
}  // namespace rigor::calibration
