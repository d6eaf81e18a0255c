// The fisheye, rays of every direction and colour, depth of field, shutter, dark current.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/philox.h"
#include "tests/sensor-hal/models/test_lenses.h"

namespace rigor {
namespace {

double length(const OpticalRay& r) { return std::sqrt(r.x * r.x + r.y * r.y + r.z * r.z); }

TEST(Angles, AreThoseOfTheLibraryToTheLastDigits) {
  using D = models::LensMath<double>;
  using F = models::LensMath<float>;
  std::mt19937 random(5);
  std::uniform_real_distribution<double> angle(0.0, std::numbers::pi), scale(-8.0, 8.0);
  for (int i = 0; i < 20000; ++i) {
    const double a = i < 100 ? 1e-9 * i : angle(random), s = std::exp2(scale(random));
    const double r = s * std::sin(a), z = s * std::cos(a);
    // Some 30 operations of half an ulp of pi.
    EXPECT_NEAR(D::angle_from_axis(r, z), std::atan2(r, z), 3e-15);
    const float rf = static_cast<float>(r), zf = static_cast<float>(z);
    EXPECT_NEAR(F::angle_from_axis(rf, zf), std::atan2(static_cast<double>(rf), static_cast<double>(zf)),
                1e-6);
    double sine = 0, cosine = 0;
    D::angle_sine_cosine(a, sine, cosine);
    EXPECT_NEAR(sine, std::sin(a), 2e-15);
    EXPECT_NEAR(cosine, std::cos(a), 2e-15);
    float sf = 0, cf = 0;
    const float af = static_cast<float>(a);
    F::angle_sine_cosine(af, sf, cf);
    EXPECT_NEAR(sf, std::sin(static_cast<double>(af)), 1e-6);
    EXPECT_NEAR(cf, std::cos(static_cast<double>(af)), 1e-6);
  }
}

// 180 degrees of field and more: half the rays of these pixels are at more than 90 degrees for some lenses.
TEST(Fisheye, InverseLeadsBackToThePixelWithin1e9) {
  std::mt19937 random(6);
  std::uniform_real_distribution<double> u(-200.0, 839.0), v(-200.0, 679.0);
  int beyond_90 = 0, taken = 0;
  for (const KannalaBrandtLens& lens : test::kFisheyes) {
    const CameraModel camera = test::fisheye_camera_with(lens);
    for (int i = 0; i < 4000; ++i) {
      const PixelPosition pixel{u(random), v(random)};
      const auto ray = unproject_ray(camera, pixel);
      if (!ray) continue;
      ++taken;
      EXPECT_NEAR(length(*ray), 1.0, 1e-14);
      beyond_90 += ray->z < 0 ? 1 : 0;
      const auto back = project_ray(camera, {ray->x * 7, ray->y * 7, ray->z * 7});
      ASSERT_TRUE(back) << lens.k1 << " at " << pixel.u_px << ", " << pixel.v_px;
      EXPECT_NEAR(back->u_px, pixel.u_px, 1e-9);
      EXPECT_NEAR(back->v_px, pixel.v_px, 1e-9);
      const auto flat = unproject(camera, pixel);
      EXPECT_EQ(flat.has_value(), ray->z > 0) << "x/z cannot say rays of 90 degrees and more";
      if (flat && ray->z > 0.01) {
        EXPECT_NEAR(flat->x, ray->x / ray->z, 1e-9 * (1 + std::abs(flat->x)));
      }
    }
  }
  EXPECT_GT(taken, 10000);
  EXPECT_GT(beyond_90, 1000);
}

// r = theta (1 + k1 theta^2) with k1 < 0 turns back at theta = sqrt(-1 / (3 k1)), where it reaches 2/3 of
// theta.
TEST(Fisheye, KnowsWhereTheModelFolds) {
  const KannalaBrandtLens lens{.k1 = -0.3};
  const CameraModel camera = test::fisheye_camera_with(lens);
  const double fold = std::sqrt(1.0 / 0.9), reach = fold * 2.0 / 3.0;
  EXPECT_NEAR(fisheye_theta_max_rad(lens), fold, 1e-12);
  const auto at = [&](double theta) {
    return project_ray(camera, {std::sin(theta), 0.0, std::cos(theta)}).has_value();
  };
  EXPECT_TRUE(at(fold - 1e-6));
  EXPECT_FALSE(at(fold + 1e-6)) << "beyond the fold a point would appear a second time";
  EXPECT_FALSE(at(3.0));
  EXPECT_TRUE(unproject_ray(camera, {camera.cx_px, camera.cy_px + camera.fy_px * (reach - 1e-9)}));
  EXPECT_FALSE(unproject_ray(camera, {camera.cx_px, camera.cy_px + camera.fy_px * (reach + 1e-9)}));
  // The slope dips below zero between 1.155 and 1.414 and is positive again after that: s^2/1.2 - 1.4 s... by
  // coefficients 1 + 3 k1 s + 5 k2 s^2 with roots s = 4/3 and 2.
  const KannalaBrandtLens dip{.k1 = -(1 / (4.0 / 3) + 1 / 2.0) / 3, .k2 = 1 / (4.0 / 3 * 2) / 5};
  EXPECT_NEAR(fisheye_theta_max_rad(dip), std::sqrt(4.0 / 3), 1e-12);
}

TEST(Fisheye, EndsStraightBackwards) {
  const CameraModel ideal = test::fisheye_camera_with(KannalaBrandtLens{});
  EXPECT_EQ(fisheye_theta_max_rad({}), std::numbers::pi);
  const double fx = ideal.fx_px;
  EXPECT_TRUE(unproject_ray(ideal, {ideal.cx_px + fx * (std::numbers::pi - 1e-6), ideal.cy_px}));
  EXPECT_FALSE(unproject_ray(ideal, {ideal.cx_px + fx * (std::numbers::pi + 1e-6), ideal.cy_px}));
  EXPECT_FALSE(project_ray(ideal, {0, 0, -1}));
  EXPECT_FALSE(project_ray(ideal, {0, 0, 0}));
  const auto sideways = project_ray(ideal, {1, 0, 0});
  ASSERT_TRUE(sideways);
  EXPECT_NEAR(sideways->u_px, ideal.cx_px + fx * std::numbers::pi / 2, 1e-10);
  const auto axis = project_ray(ideal, {0, 0, 2});
  ASSERT_TRUE(axis);
  EXPECT_EQ(axis->u_px, ideal.cx_px);
}

// Float against double on the inputs that the float saw. theta errs by 1e-6 (Angles); r is a polynomial in it
// with slopes below 2 here.
TEST(Fisheye, FloatFollowsDouble) {
  using F = models::LensMath<float>;
  using D = models::LensMath<double>;
  std::mt19937 random(7);
  std::uniform_real_distribution<float> part(-1, 1);
  for (const KannalaBrandtLens& l : test::kFisheyes) {
    const float k1 = static_cast<float>(l.k1), k2 = static_cast<float>(l.k2), k3 = static_cast<float>(l.k3),
                k4 = static_cast<float>(l.k4);
    const auto end = static_cast<float>(0.9 * fisheye_theta_max_rad(l));
    for (int i = 0; i < 2000; ++i) {
      const float x = part(random), y = part(random), z = part(random);
      float xf = 0, yf = 0, vf = 0;
      double xd = 0, yd = 0, vd = 0;
      F::fisheye_project(x, y, z, k1, k2, k3, k4, end, xf, yf, vf);
      D::fisheye_project(x, y, z, k1, k2, k3, k4, end, xd, yd, vd);
      if (vd < 0.5 || vf < 0.5) continue;
      EXPECT_NEAR(xf, xd, 4e-6);
      EXPECT_NEAR(yf, yd, 4e-6);
      float rx = 0, ry = 0, rz = 0;
      double qx = 0, qy = 0, qz = 0;
      F::fisheye_unproject(xf, yf, k1, k2, k3, k4, end, 1e-6f, rx, ry, rz, vf);
      D::fisheye_unproject(xf, yf, k1, k2, k3, k4, end, 1e-15, qx, qy, qz, vd);
      if (vd < 0.5 || vf < 0.5) continue;
      const double slope = D::fisheye_radius_slope(std::acos(qz), k1, k2, k3, k4);
      EXPECT_NEAR(rx, qx, 4e-6 / std::min(1.0, slope));
      EXPECT_NEAR(rz, qz, 4e-6 / std::min(1.0, slope));
    }
  }
}

// A point at the angle of the image's edge: red lands 0.2 % farther out than the reference, blue 0.1 %
// nearer.
TEST(Chromatic, MagnifiesEachColourAboutThePrincipalPoint) {
  for (const Projection projection : {Projection::opencv, Projection::kannala_brandt}) {
    CameraModel c = test::camera_with(test::kLenses[1]);
    c.fisheye = test::kFisheyes[1];
    c.projection = projection;
    c.chromatic.magnification = {1.002, 1.0, 0.999};
    const OpticalRay ray{0.4, -0.25, 1.0};
    const auto reference = project_ray(c, ray);
    ASSERT_TRUE(reference);
    const auto plain = project(c, {0.4, -0.25, 1.0});
    ASSERT_TRUE(plain);
    EXPECT_EQ(plain->u_px, reference->u_px);
    for (int channel = kRed; channel <= kBlue; ++channel) {
      const double m = c.chromatic.magnification[static_cast<std::size_t>(channel)];
      const auto p = project_ray(c, ray, channel);
      ASSERT_TRUE(p);
      EXPECT_NEAR(p->u_px - c.cx_px, m * (reference->u_px - c.cx_px), 1e-10);
      EXPECT_NEAR(p->v_px - c.cy_px, m * (reference->v_px - c.cy_px), 1e-10);
      const auto back = unproject_ray(c, *p, channel);
      ASSERT_TRUE(back);
      EXPECT_NEAR(back->x / back->z, 0.4, 1e-11);
      EXPECT_NEAR(back->y / back->z, -0.25, 1e-11);
    }
  }
}

// f = 8 mm, f/2, in focus at 2 m, 5 um pixels; by hand for d = 1 m: 64e-6 * 1 / (2 * 5e-6 * 1 * 1.992) =
// 3.2129 px; for d = infinity: 64e-6 / (2 * 5e-6 * 1.992) the same; for d = 4 m half of it.
TEST(DepthOfField, IsThatOfAThinLens) {
  CameraModel c;
  c.optics.f_number = 2;
  c.optics.pixel_pitch_m = 5e-6;
  EXPECT_EQ(blur_diameter_px(c, 1.0), 0.0) << "off";
  c.depth_of_field = {.focus_distance_m = 2, .focal_length_m = 0.008};
  const double one = 64e-6 / (2 * 5e-6 * 1.992);
  EXPECT_NEAR(one, 3.2129, 1e-4);
  EXPECT_NEAR(blur_diameter_px(c, 1.0), one, 1e-12);
  EXPECT_NEAR(blur_diameter_px(c, std::numeric_limits<double>::infinity()), one, 1e-12);
  EXPECT_NEAR(blur_diameter_px(c, 4.0), one / 2, 1e-12);
  EXPECT_EQ(blur_diameter_px(c, 2.0), 0.0);
  EXPECT_NEAR(aperture_diameter_m(c), 0.004, 1e-15);
  // A colour whose focus lies 0.1 m nearer: 64e-6 * 0.1 / (1e-5 * 2 * 1.892).
  c.chromatic.focus_shift_m = {0, 0, -0.1};
  EXPECT_EQ(blur_diameter_px(c, 2.0, kRed), 0.0);
  EXPECT_NEAR(blur_diameter_px(c, 2.0, kBlue), 64e-6 * 0.1 / (1e-5 * 2 * 1.892), 1e-12);
  // Without a focal length it is that of the picture.
  c.depth_of_field.focal_length_m = 0;
  EXPECT_NEAR(focal_length_m(c), c.fx_px * 5e-6, 1e-15);
  // An object at d appears in focus, or the model is refused.
  c.depth_of_field.focus_distance_m = 0.002;
  const Status s = c.validate();
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().message.find("depth_of_field.focus_distance_m"), std::string::npos);
  using F = models::LensMath<float>;
  for (const float d : {0.1f, 0.7f, 3.0f, 1e6f, std::numeric_limits<float>::infinity()})
    EXPECT_NEAR(F::blur_diameter_px(d, 2.0f, 0.008f, 2.0f, 5e-6f),
                models::LensMath<double>::blur_diameter_px(d, 2.0, 0.008f, 2.0, 5e-6f), 3e-4)
        << "below ten roundings of 60 px";
}

TEST(Shutter, RowsFollowEachOtherAboutTheCentreRow) {
  CameraModel c;
  c.height_px = 481;
  c.shutter.line_time_s = 20e-6;
  EXPECT_EQ(row_delay_s(c, 240), 0.0);
  EXPECT_NEAR(row_delay_s(c, 0), -240 * 20e-6, 1e-15);
  EXPECT_NEAR(row_delay_s(c, 480), 240 * 20e-6, 1e-15);
}

TEST(DarkCurrent, DoublesEverySevenKelvin) {
  EmvaNoise n{.dark_current_e_per_s = 10};
  n.temperature_c = n.dark_reference_c;
  EXPECT_EQ(n.dark_current_at_temperature_e_per_s(), 10.0);
  n.temperature_c = n.dark_reference_c + 14;
  EXPECT_NEAR(n.dark_current_at_temperature_e_per_s(), 40.0, 1e-12);
  EXPECT_NEAR(n.hot_pixel_dark_at_temperature_e_per_s(), 4 * n.hot_pixel_dark_e_per_s, 1e-9);
  n.temperature_c = n.dark_reference_c - 7;
  EXPECT_NEAR(n.dark_current_at_temperature_e_per_s(), 5.0, 1e-12);
  using F = models::NoiseMath<float>;
  EXPECT_NEAR(F::dark_current_at(10.0f, 39.0f, 25.0f, 7.0f), 40.0f, 1e-4f);
}

TEST(DarkCurrent, HotPixelsAreExponentiallyDistributed) {
  using D = models::NoiseMath<double>;
  using F = models::NoiseMath<float>;
  EXPECT_EQ(D::hot_pixel_rate(0.01, 5000, 0.01, 0.5), 0.0);
  EXPECT_NEAR(D::hot_pixel_rate(0.01, 5000, 0.0099, 0.5), 5000 * std::log(2.0), 1e-9);
  EXPECT_NEAR(F::hot_pixel_rate(0.01f, 5000, 0.0099f, 0.5f), 5000 * std::log(2.0), 1e-3);
}

// A dozen roundings of 6e-8, of exp and log among them, whose argument is magnified by exponents up to 3.
TEST(PictureModels, FloatFollowsDouble) {
  using D = models::PictureMath<double>;
  using F = models::PictureMath<float>;
  std::mt19937 random(12);
  std::uniform_real_distribution<float> part(0, 1);
  for (int i = 0; i < 2000; ++i) {
    const float r2 = 1e4f * part(random), radius = 0.5f + 10 * part(random), p = 0.5f + 2.5f * part(random);
    const double kernel = D::bloom_kernel(r2, radius, p);
    EXPECT_NEAR(F::bloom_kernel(r2, radius, p) / kernel, 1, 1e-5);
    EXPECT_NEAR(kernel, std::pow(1 + r2 / (static_cast<double>(radius) * radius), -p), 1e-12);
    const float t = 8 * part(random) + 1e-3f;
    EXPECT_NEAR(F::bloom_gaussian_sigma(t, radius) / D::bloom_gaussian_sigma(t, radius), 1, 1e-6);
    EXPECT_NEAR(F::bloom_gaussian_height(t, p, 0.7f) / D::bloom_gaussian_height(t, p, 0.7f), 1, 1e-5);
    EXPECT_NEAR(F::bloom_mix(r2, t, p, 0.1f, 0.02f), D::bloom_mix(r2, t, p, 0.1f, 0.02f), 2e-3);
    const float dn = std::floor(4096 * part(random)), gamma = 0.4f + part(random);
    const double balanced = D::balanced_dn(dn, 64, p);
    EXPECT_NEAR(F::balanced_dn(dn, 64, p), balanced, 2e-3);
    EXPECT_NEAR(F::processed_dn(static_cast<float>(balanced), 64, 4095, gamma, 64),
                D::processed_dn(static_cast<float>(balanced), 64, 4095, gamma, 64), 2e-2);
  }
}

}  // namespace
}  // namespace rigor
