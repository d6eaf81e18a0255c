// Sky, sun and air along rays, and what a light query refuses.
#include "sim/render/rays/light_sky.h"
#include "tests/sim/render/rays/light_fixture.h"

namespace rigor::test {
namespace {

using LightAirTest = LightTest;

std::shared_ptr<SkyMap> uneven_sky() {
  auto s = std::make_shared<SkyMap>();
  s->width = 64;
  s->height = 16;
  for (int j = 0; j < 16; ++j)
    for (int i = 0; i < 64; ++i) {
      Spectrum l{};
      for (std::size_t b = 0; b < l.size(); ++b) {
        // Bright about one place, as round the sun.
        const double a = (i + 0.5) * 2 * kPi / 64 - 1.0, e = (j + 0.5) * 0.5 * kPi / 16;
        l[b] = static_cast<float>(0.2 * static_cast<double>(b + 1) +
                                  5 * std::exp(4 * (std::cos(a) * std::cos(e - 0.6) - 1)));
      }
      s->radiance.push_back(l);
    }
  return s;
}

TEST_F(LightAirTest, AnEmptyWorldIsSkyAboveAndGroundBelow) {
  const auto sky = uneven_sky();
  frame_.light.sky = sky;
  frame_.light.ground_albedo = {0.1F, 0.2F, 0.3F, 0.4F, 0.5F, 0.6F};
  for (const double azimuth : {0.0, 57.3, 180.0, 359.9})
    for (const double elevation : {0.01, 3.0, 45.0, 90.0}) {
      const Vector3d d = direction(azimuth, elevation);
      const LightSample l = light({1, 2, 3}, d);
      const Spectrum e = sky->at(d);
      for (std::size_t b = 0; b < 4; ++b)
        EXPECT_NEAR(l.radiance[b], e[b], 1e-4 * e[b]) << azimuth << " " << elevation;
      EXPECT_TRUE(std::isinf(l.range_m));
      EXPECT_EQ(l.node.value, 0U);
    }
  // Below the horizon: ground that sky and sun light, albedo over pi of it.
  frame_.light.sky = even_sky(2);
  set_sun(10, 30, 4);
  const LightSample below = light({0, 0, 3}, {0, 1, -0.2});
  EXPECT_NEAR(below.radiance[1], 0.2 / kPi * (2 * kPi + 4 * 0.5), 2e-3);
}

TEST_F(LightAirTest, IrradianceByNormalIsTheIntegralOfTheSky) {
  const auto sky = uneven_sky();
  const light::SkyTables tables(sky.get(), {0, 1, 2, 5});
  double worst = 0;
  for (int k = 0; k < 60; ++k) {
    const Vector3d n = Vector3d(std::sin(3.1 * k), std::cos(1.7 * k), std::sin(0.9 * k + 1)).normalized();
    Vector3d sum = Vector3d::Zero();
    const int across = 720, up = 180;
    for (int j = 0; j < up; ++j)
      for (int i = 0; i < across; ++i) {
        const double e = (j + 0.5) * 90.0 / up;
        const Vector3d d = direction((i + 0.5) * 360.0 / across, e);
        const double part = std::cos(deg(e)) * deg(90.0 / up) * deg(360.0 / across) * std::max(0.0, d.dot(n));
        const Spectrum l = sky->at(d);
        sum +=
            part * Vector3d(static_cast<double>(l[0]), static_cast<double>(l[1]), static_cast<double>(l[5]));
      }
    const light::Bands4 got =
        tables.irradiance({static_cast<float>(n.x()), static_cast<float>(n.y()), static_cast<float>(n.z())});
    worst = std::max({worst, std::abs(static_cast<double>(got[0]) - sum[0]),
                      std::abs(static_cast<double>(got[1]) - sum[1]),
                      std::abs(static_cast<double>(got[3]) - sum[2])});
  }
  const light::Bands4 most = tables.irradiance({0, 0, 1});
  EXPECT_LT(worst, 0.01 * static_cast<double>(most[3]));
}

TEST_F(LightAirTest, TheSunsDiscSendsItsIrradiance) {
  set_sun(90, 20, 4);
  const Vector3d to = direction(90, 20), a = to.cross(Vector3d::UnitZ()).normalized(), b = to.cross(a);
  const double step = 1.0 / 8000;
  std::vector<Ray> rays;
  for (int i = -50; i <= 50; ++i)
    for (int j = -50; j <= 50; ++j) rays.push_back(ray_of({0, 0, 0}, to + step * (i * a + j * b)));
  for (const float spread : {0.0F, static_cast<float>(step)}) {
    query_.spread_rad = spread;
    double sum = 0;
    for (const LightSample& s : trace(rays)) sum += static_cast<double>(s.radiance[0]) * step * step;
    EXPECT_NEAR(sum, 4, 0.02) << spread;
  }
  set_sun(90, -0.1, 4);
  EXPECT_EQ(light({0, 0, 0}, direction(90, 0.1)).radiance[0], 0);
}

TEST_F(LightAirTest, HazeTakesLightByTheExponentialOfTheWayBelowItsTop) {
  frame_.light.sky = even_sky(1);
  const Spectrum extinction{1e-3F, 2e-3F, 4e-3F, 5e-4F, 5e-4F, 5e-4F};
  frame_.batches = {one(box_mesh({500, 1, 500}, surface_of(0.5F)), 1, {0, 401, 0})};
  const Vector3d eye(0, 0, 30);
  for (const double slope : {0.0, 0.3, -0.2}) {
    const Vector3d d(0, 1, slope);
    frame_.hazes.clear();
    const LightSample clear = light(eye, d);
    const double way = 400 * d.norm(), z = eye.z() + 400 * slope;
    ASSERT_NEAR(clear.range_m, way, 1e-2);
    for (const double top : {std::numeric_limits<double>::infinity(), 50.0, 5.0}) {
      const double low = std::min(eye.z(), z), high = std::max(eye.z(), z);
      const double share =
          high > low ? std::clamp((top - low) / (high - low), 0.0, 1.0) : (top > low ? 1.0 : 0.0);
      frame_.hazes = {{.extinction_per_m = extinction, .top_m = top, .inscattered_radiance = grey(0.7F)}};
      const LightSample hazy = light(eye, d);
      for (std::size_t b = 0; b < 4; ++b) {
        const double t = std::exp(-static_cast<double>(extinction[b]) * way * share);
        EXPECT_NEAR(hazy.radiance[b], static_cast<double>(clear.radiance[b]) * t + 0.7 * (1 - t), 2e-5)
            << slope << " " << top;
      }
    }
  }
  // Upwards through a layer of 50 m, and through all of an endless one.
  frame_.hazes = {{.extinction_per_m = extinction, .top_m = 80, .inscattered_radiance = grey(0.7F)}};
  frame_.batches.clear();
  const double t = std::exp(-1e-3 * 100);
  EXPECT_NEAR(light(eye, direction(0, 30)).radiance[0], t + 0.7 * (1 - t), 1e-4);
  frame_.hazes[0].top_m = std::numeric_limits<double>::infinity();
  EXPECT_NEAR(light(eye, direction(0, 30)).radiance[0], 0.7, 1e-6);
}

TEST_F(LightAirTest, SeveralHazesAndRainAddTheirDepths) {
  frame_.batches = {one(box_mesh({500, 1, 500}, surface_of(0)), 1, {0, 101, 0})};
  frame_.light.sky = even_sky(3);
  frame_.hazes = {{.extinction_per_m = grey(2e-3F), .inscattered_radiance = grey(1)},
                  {.extinction_per_m = grey(6e-3F), .inscattered_radiance = grey(0.2F)}};
  double t = std::exp(-0.8), source = (0.2 * 1 + 0.6 * 0.2) / 0.8;
  EXPECT_NEAR(light({0, 0, 0}, {0, 1, 0}).radiance[0], source * (1 - t), 1e-5);
  // Rain shines with the mean of what surrounds it: here half a sky.
  frame_.precipitation.kind = Precipitation::Kind::rain;
  frame_.precipitation.extinction_per_m = grey(8e-3F);
  t = std::exp(-1.6);
  source = (0.2 * 1 + 0.6 * 0.2 + 0.8 * 1.5) / 1.6;
  EXPECT_NEAR(light({0, 0, 0}, {0, 1, 0}).radiance[0], source * (1 - t), 1e-3);
}

TEST_F(LightAirTest, RefusesWhatMakesNoSense) {
  std::vector<Ray> rays(3);
  std::vector<LightSample> samples(3);
  const auto refused = [&](const LightQuery& q, std::span<LightSample> out) {
    const Status s = tracer_->trace(q, out);
    return !s && s.error().code == ErrorCode::bad_input;
  };
  EXPECT_TRUE(refused({.rays = rays}, samples)) << "nothing prepared";
  ASSERT_TRUE(engine_->prepare(window_of(std::vector<ContentFrame>{frame_})));
  EXPECT_TRUE(tracer_->trace({.rays = rays}, samples));
  EXPECT_TRUE(refused({.rays = rays}, std::span(samples).first(2)));
  EXPECT_TRUE(refused({.bands = {0, 1, 2, 6}, .rays = rays}, samples));
  EXPECT_TRUE(refused({.rays = rays, .sky_rays = -1}, samples));
  EXPECT_TRUE(refused({.origin = {0, 0, std::nan("")}, .rays = rays}, samples));
  EXPECT_TRUE(tracer_->trace({}, {}));
}

}  // namespace
}  // namespace rigor::test
