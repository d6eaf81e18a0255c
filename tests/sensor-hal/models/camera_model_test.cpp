#include "sensor-hal/models/camera_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "sensor-hal/models/lens_walk.h"
#include "tests/sensor-hal/models/test_lenses.h"

namespace rigor {
namespace {

TEST(CameraModel, DefaultsAreValid) {
  EXPECT_TRUE(CameraModel{}.validate());
  EXPECT_NEAR(CameraModel{}.system_gain_dn_per_e(), 4095.0 / 10000.0, 1e-12);
}

TEST(CameraModel, SaysWhichValueIsWrongAndWhatWasExpected) {
  struct Case {
    const char* named;
    std::function<void(CameraModel&)> spoil;
  };
  for (const Case& c :
       {Case{"width_px", [](CameraModel& m) { m.width_px = 0; }},
        Case{"fx_px", [](CameraModel& m) { m.fx_px = -1; }},
        Case{"lens.k3", [](CameraModel& m) { m.lens.k3 = std::nan(""); }},
        Case{"optics.f_number", [](CameraModel& m) { m.optics.f_number = 0; }},
        Case{"optics.mono_efficiency", [](CameraModel& m) { m.optics.mono_efficiency[2] = 1.5; }},
        Case{"noise.adc_bits", [](CameraModel& m) { m.noise.adc_bits = 17; }},
        Case{"noise.black_level_dn", [](CameraModel& m) { m.noise.black_level_dn = 5000; }},
        Case{"noise.prnu", [](CameraModel& m) { m.noise.prnu = -0.1; }}}) {
    CameraModel m;
    c.spoil(m);
    const Status s = m.validate();
    ASSERT_FALSE(s) << c.named;
    EXPECT_EQ(s.error().code, ErrorCode::bad_input);
    EXPECT_NE(s.error().message.find(c.named), std::string::npos) << s.error().message;
    EXPECT_NE(s.error().message.find("expected"), std::string::npos);
  }
}

// 1 W m^-2 sr^-1 of green light through f/2 onto 5 um pixels, by hand: E = pi/4 / 4 W/m^2, 2.5e-11
// m^2, 3.713e-19 J.
TEST(CameraModel, CountsPhotons) {
  CameraModel m;
  m.optics.f_number = 2.0;
  m.optics.transmission = 1.0;
  m.optics.pixel_pitch_m = 5e-6;
  const auto rate = m.electron_rate_per_radiance({0, 1, 0, 0});
  EXPECT_NEAR(rate[1], 0.19635 * 2.5e-11 / 3.713e-19, 0.001 * rate[1]);
  EXPECT_EQ(rate[0], 0.0);
}

TEST(LensWalk, AgreesWithEachPixelOnItsOwn) {
  for (const OpenCvLens& lens : test::kLenses) {
    CameraModel c = test::camera_with(lens);
    c.chromatic.magnification = {0.999, 1.0, 1.002};
    for (const int channel : {static_cast<int>(kReferenceChannel), static_cast<int>(kBlue)}) {
      std::size_t there = 0;
      // Beyond the picture as well, where some of these lenses fold.
      for (int v = -600; v < 1080; v += 57) {
        LensWalk walk(c, channel);
        for (int u = -600; u < 1240; u += 3) {
          const PixelPosition pixel{static_cast<double>(u), static_cast<double>(v)};
          const auto p = walk(pixel);
          const auto ray = unproject_ray(c, pixel, channel);
          ASSERT_EQ(p.has_value(), ray.has_value()) << lens.k1 << ": " << u << ' ' << v;
          if (!p) continue;
          ++there;
          ASSERT_NEAR(p->x, ray->x / ray->z, 1e-9 * (1 + std::abs(p->x))) << lens.k1 << ": " << u << ' ' << v;
          ASSERT_NEAR(p->y, ray->y / ray->z, 1e-9 * (1 + std::abs(p->y))) << lens.k1 << ": " << u << ' ' << v;
        }
      }
      EXPECT_GT(there, 2000U);
    }
  }
}

}  // namespace
}  // namespace rigor
