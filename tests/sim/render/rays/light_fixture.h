// Small worlds with light for the tracer of light.
#pragma once

#include <algorithm>

#include "sim/render/rays/light_tracer.h"
#include "tests/sim/render/rays/rays_fixture.h"

namespace rigor::test {

constexpr double kPi = std::numbers::pi;
inline double deg(double d) { return d * kPi / 180; }
/// From north over east, and up from the horizon.
inline Vector3d direction(double azimuth_deg, double elevation_deg) {
  const double a = deg(azimuth_deg), e = deg(elevation_deg);
  return {std::sin(a) * std::cos(e), std::cos(a) * std::cos(e), std::sin(e)};
}
inline std::shared_ptr<SkyMap> even_sky(float radiance) {
  auto s = std::make_shared<SkyMap>();
  s->width = 32;
  s->height = 8;
  s->radiance.assign(32 * 8, grey(radiance));
  return s;
}
inline std::shared_ptr<Texture> texture_of(std::uint32_t width, std::uint32_t height,
                                           std::vector<std::uint8_t> rgba, bool srgb = false) {
  auto t = std::make_shared<Texture>();
  t->width = width;
  t->height = height;
  t->srgb = srgb;
  t->rgba = std::move(rgba);
  return t;
}

class LightTest : public RaysTest {
 protected:
  void SetUp() override {
    RaysTest::SetUp();
    tracer_ = std::make_unique<LightTracer>(engine_);
    frame_.light.sky = even_sky(0);
    frame_.light.ground_albedo = {};
  }
  void set_sun(double azimuth_deg, double elevation_deg, float irradiance) {
    frame_.light.direction_to_sun = direction(azimuth_deg, elevation_deg);
    frame_.light.sun_irradiance = grey(irradiance);
  }
  std::vector<LightSample> trace(const std::vector<Ray>& rays) { return trace(*engine_, *tracer_, rays); }
  std::vector<LightSample> trace(EmbreeEngine& engine, LightTracer& tracer, const std::vector<Ray>& rays) {
    const Status ready = engine.prepare(window_of(std::vector<ContentFrame>{frame_}));
    EXPECT_TRUE(ready) << ready.error().text();
    std::vector<LightSample> out(rays.size());
    query_.rays = rays;
    if (query_.gathered) {
      EXPECT_TRUE(tracer.gather(query_));
    }
    const Status s = tracer.trace(query_, out);
    EXPECT_TRUE(s) << s.error().text();
    return out;
  }
  LightSample light(const Vector3d& from, const Vector3d& towards) {
    return trace({ray_of(from, towards)})[0];
  }
  /// From a metre above a place, straight down.
  LightSample down_at(double x, double y) { return light({x, y, 1}, -Vector3d::UnitZ()); }

  ContentFrame frame_;
  LightQuery query_;
  std::unique_ptr<LightTracer> tracer_;
};

}  // namespace rigor::test
