// What the tests of the time-of-flight simulator share: an optical frame that is the world's (x right, y
// down, z forward), a camera without errors, closed forms.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <numbers>

#include "sensor-hal/models/tof/tof_math.h"
#include "sim/sensors/tof/tof_simulator.h"
#include "tests/sim/sensors/analytic_engine.h"

namespace rigor::test {

inline constexpr double kLightSpeed_mps = 299792458.0;
inline constexpr double kPi = std::numbers::pi;

/// AnalyticWorld that says whether it moves, as engines of content do: by batches that differ.
class MovableWorld final : public render::ContentSource {
 public:
  [[nodiscard]] std::shared_ptr<const render::ContentWindow> collect(const render::ContentQuery& query,
                                                                     BenchTime begin, BenchTime end,
                                                                     int instants) override {
    if (!moves) return still.collect(query, begin, end, instants);
    auto window = std::make_shared<render::ContentWindow>();
    window->begin = begin;
    window->end = end;
    for (int i = 0; i < instants; ++i) {
      auto frame = std::make_shared<render::ContentFrame>(still.frame);
      auto batch = std::make_shared<render::Batch>();
      batch->nodes = moving_nodes;
      frame->batches.push_back(std::move(batch));
      window->frames.push_back(std::move(frame));
    }
    asked_instants = instants;
    return window;
  }
  [[nodiscard]] Eigen::Isometry3d T_world_node(world::NodeId node, BenchTime t) const override {
    return still.T_world_node(node, t);
  }
  [[nodiscard]] std::string type_name(world::NodeId node) const override { return still.type_name(node); }

  AnalyticWorld still;
  bool moves = false;
  std::vector<world::NodeId> moving_nodes{{}};  ///< of the batch that moves: what has no node of its own
  int asked_instants = 0;
};

/// No noise, no rounding, no well to speak of, one ray per pixel, all taps at once.
inline models::TofModel perfect(int width_px, int height_px, double fx_px) {
  models::TofModel m;
  m.width_px = width_px;
  m.height_px = height_px;
  m.fx_px = m.fy_px = fx_px;
  m.cx_px = (width_px - 1) / 2.0;
  m.cy_px = (height_px - 1) / 2.0;
  m.modulation.contrast = 0.5;
  m.pixel.trembling = false;
  m.pixel.full_well_e = 1e12;
  m.sampling.motion = false;
  return m;
}

struct TofBench {
  std::shared_ptr<AnalyticEngine> engine = std::make_shared<AnalyticEngine>();
  MovableWorld world;
  render::PoseFunction pose = still();
  BenchTime t{1'000'000'000};

  std::unique_ptr<TofSimulator> camera(const models::TofModel& model, bool ideal = false,
                                       std::uint64_t seed = 1, const std::string& name = "tof") const {
    auto made = TofSimulator::create({.name = name, .model = model, .seed = seed, .ideal = ideal}, engine);
    EXPECT_TRUE(made) << (made ? "" : made.error().text());
    return std::move(*made);
  }
  TofPicture shoot(TofSimulator& camera, std::uint64_t index = 0, GroundTruth* truth = nullptr,
                   bool taps = false) {
    TofPicture p;
    const Status s = camera.capture({.index = index, .t_capture = t}, {world, pose}, p, truth, taps);
    EXPECT_TRUE(s) << (s ? "" : s.error().text());
    return p;
  }
  TofPicture shoot(const models::TofModel& model, std::uint64_t index = 0, bool taps = false) {
    const auto c = camera(model);
    return shoot(*c, index, nullptr, taps);
  }
  void wall(double z_m, float reflectance = 0.8F) {
    engine->add(Plane{.point = {0, 0, z_m}, .normal = {0, 0, -1}}, {.reflectance = grey(reflectance)});
  }
};

inline constexpr double kNear_m = 1.4, kFar_m = 2.6;

/// A far wall, and before it a near one to the left of pixel coordinate `edge_px`.
inline void step_at(TofBench& b, const models::TofModel& m, double edge_px, float near_reflectance = 0.4F) {
  b.wall(kFar_m, 0.8F);
  const double x = (edge_px - m.cx_px) / m.fx_px * kNear_m;
  b.engine->add(Rectangle{.centre = {x - 5, 0, kNear_m}, .half_u = {5, 0, 0}, .half_v = {0, 5, 0}},
                {.reflectance = grey(near_reflectance)});
}

inline double turns_of(double range_m, double f_hz) { return 2 * f_hz * range_m / kLightSpeed_mps; }
/// E times the phasor of a pure cosine.
inline std::complex<double> phasor_of(double e, double range_m, double f_hz) {
  return std::polar(e, 2 * kPi * turns_of(range_m, f_hz));
}
/// Tap 0 to 3 of light E from a range, contrast 0.5.
inline double tap_of(double e, double range_m, int tap, double f_hz = 30e6) {
  return e / 2 * (1 + 0.5 * std::cos(2 * kPi * turns_of(range_m, f_hz) + tap * kPi / 2));
}
/// Range of a phasor within one turn.
inline double range_of(std::complex<double> p, double f_hz) {
  double turns = std::arg(p) / (2 * kPi);
  if (turns < 0) turns += 1;
  return turns * kLightSpeed_mps / (2 * f_hz);
}
/// Ideal ray's direction cosine to the axis.
inline double axis_cosine(const models::TofModel& m, int u, int v) {
  const auto p = unproject(m.camera(), {double(u), double(v)});
  return 1 / std::sqrt(1 + p->x * p->x + p->y * p->y);
}

struct Spread {
  double mean = 0, sigma = 0;
  int count = 0;
};
template <class Values>
Spread spread_of(const Values& values) {
  Spread s;
  double sum = 0, squares = 0;
  for (const auto v : values)
    if (!std::isnan(double(v))) sum += double(v), ++s.count;
  s.mean = sum / s.count;
  for (const auto v : values)
    if (!std::isnan(double(v))) squares += (double(v) - s.mean) * (double(v) - s.mean);
  s.sigma = std::sqrt(squares / (s.count - 1));
  return s;
}
/// Relative half-width of a sample standard deviation of n normal draws, 99.99 %: chi-squared for large n.
inline double chi_bound(int n) { return 3.9 / std::sqrt(2.0 * n); }

}  // namespace rigor::test
