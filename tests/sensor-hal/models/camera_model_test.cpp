#include "sensor-hal/models/camera_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

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

}  // namespace
}  // namespace rigor
