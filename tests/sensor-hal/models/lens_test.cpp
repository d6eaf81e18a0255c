#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/models/one_source.h"
#include "tests/sensor-hal/models/test_lenses.h"

namespace rigor {
namespace {

TEST(OpenCvLens, InverseLeadsBackToThePixelWithin1e9) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> u(0.0, 639.0), v(0.0, 479.0);
  for (const OpenCvLens& lens : test::kLenses) {
    const CameraModel camera = test::camera_with(lens);
    for (int i = 0; i < 2000; ++i) {
      const PixelPosition pixel{u(random), v(random)};
      const auto ray = unproject(camera, pixel);
      ASSERT_TRUE(ray) << pixel.u_px << ", " << pixel.v_px << " under k1 " << lens.k1;
      const auto back = project(camera, {ray->x * 3.0, ray->y * 3.0, 3.0});
      ASSERT_TRUE(back);
      EXPECT_NEAR(back->u_px, pixel.u_px, 1e-9);
      EXPECT_NEAR(back->v_px, pixel.v_px, 1e-9);
    }
  }
}

// r (1 + k1 r^2) with k1 = -0.5 turns back at r = sqrt(2/3) = 0.8165, where it reaches 0.5443.
TEST(OpenCvLens, KnowsWhereTheModelFolds) {
  CameraModel camera = test::camera_with({.k1 = -0.5});
  const double r_fold = std::sqrt(2.0 / 3.0), reach = r_fold * (1.0 - 0.5 * r_fold * r_fold);
  EXPECT_TRUE(project(camera, {0.80, 0.0, 1.0}));
  EXPECT_FALSE(project(camera, {0.84, 0.0, 1.0})) << "beyond the fold a point would appear a second time";
  EXPECT_FALSE(project(camera, {1.3, 0.3, 1.0}));
  EXPECT_TRUE(unproject(camera, {camera.cx_px + camera.fx_px * (reach - 1e-3), camera.cy_px}));
  EXPECT_FALSE(unproject(camera, {camera.cx_px + camera.fx_px * (reach + 1e-3), camera.cy_px}));
}

// k2 > 0 turns a folded lens back: behind the fold there is a second sheet on which the formula
// reaches every pixel, and an iteration that jumps there answers with a ray that the lens does not take.
TEST(OpenCvLens, APixelBeyondTheFoldIsNotGivenToTheSheetBehindIt) {
  for (const OpenCvLens& lens : {OpenCvLens{.k1 = -0.38, .k2 = 0.015}, OpenCvLens{.k1 = -0.38, .k2 = 0.05},
                                 OpenCvLens{.k1 = -0.38, .k2 = 0.02, .p1 = 1e-3, .p2 = -2e-3, .k3 = 1e-3},
                                 OpenCvLens{.k1 = -0.6, .k2 = 0.12}}) {
    const CameraModel camera = test::camera_with(lens);
    using F = models::LensMath<float>;
    const auto f = [](double v) { return static_cast<float>(v); };
    for (const double angle : {0.0, 0.7, 1.9, 3.3, 5.0}) {
      // How far the first sheet reaches: the formula's first maximum along a ray from the axis.
      double reach = 0, x_fold = 0;
      for (double r = 0.01; r < 3; r += 1e-4) {
        double xd = 0, yd = 0;
        models::LensMath<double>::lens_distort(r * std::cos(angle), r * std::sin(angle), lens.k1, lens.k2,
                                               lens.p1, lens.p2, lens.k3, 0, 0, 0, xd, yd);
        if (std::hypot(xd, yd) < reach) break;
        reach = std::hypot(xd, yd), x_fold = r;
      }
      ASSERT_LT(x_fold, 2.9) << "this lens does not fold";
      for (const double share : {0.3, 0.6, 0.9, 0.97, 1.04, 1.2, 1.5, 2.0, 3.0}) {
        const double xd = share * reach * std::cos(angle), yd = share * reach * std::sin(angle);
        const auto ray =
            unproject(camera, {camera.cx_px + camera.fx_px * xd, camera.cy_px + camera.fy_px * yd});
        EXPECT_EQ(ray.has_value(), share < 1)
            << lens.k1 << " " << lens.k2 << " at " << angle << ", " << share;
        if (ray && share < 1) {
          EXPECT_LT(std::hypot(ray->x, ray->y), 1.01 * x_fold);
        }
        float x = 0, y = 0, valid = 0;
        F::lens_undistort(f(xd), f(yd), f(lens.k1), f(lens.k2), f(lens.p1), f(lens.p2), f(lens.k3), 0, 0, 0,
                          1e-6f, x, y, valid);
        EXPECT_EQ(valid > 0.5f, share < 1) << "float, " << lens.k1 << " at " << angle << ", " << share;
      }
    }
  }
}

TEST(OpenCvLens, RefusesPointsBehindTheCamera) {
  EXPECT_FALSE(project(test::camera_with({}), {0.1, 0.1, 0.0}));
  EXPECT_FALSE(project(test::camera_with({}), {0.1, 0.1, -1.0}));
}

TEST(OpenCvLens, ANumberThatIsNoneIsInvalid) {
  CameraModel camera = test::camera_with({.k1 = std::nan("")});
  EXPECT_FALSE(unproject(camera, {10, 10}));
  EXPECT_FALSE(camera.validate());
}

// Float against double on the same inputs. Each of the ~40 operations of the forward model errs by half an
// ulp of terms below 8 (the rational lens): 40 * 8 * 6e-8 = 2e-5 at worst, spread over random signs a tenth
// of that; the Newton inverse ends within that of the root, scaled by the inverse of the Jacobian (below 4
// here).
TEST(OpenCvLens, FloatFollowsDouble) {
  using F = models::LensMath<float>;
  using D = models::LensMath<double>;
  std::mt19937 random(2);
  std::uniform_real_distribution<float> x(-0.6f, 0.6f);
  for (const OpenCvLens& l : test::kLenses) {
    const auto f = [](double v) { return static_cast<float>(v); };
    for (int i = 0; i < 2000; ++i) {
      const float xf = x(random), yf = x(random);
      float xdf = 0, ydf = 0, xb = 0, yb = 0, valid = 0;
      double xd = 0, yd = 0;
      F::lens_distort(xf, yf, f(l.k1), f(l.k2), f(l.p1), f(l.p2), f(l.k3), f(l.k4), f(l.k5), f(l.k6), xdf,
                      ydf);
      // The double takes the coefficients that the float saw.
      D::lens_distort(xf, yf, f(l.k1), f(l.k2), f(l.p1), f(l.p2), f(l.k3), f(l.k4), f(l.k5), f(l.k6), xd, yd);
      EXPECT_NEAR(xdf, xd, 2e-6);
      EXPECT_NEAR(ydf, yd, 2e-6);
      F::lens_undistort(xdf, ydf, f(l.k1), f(l.k2), f(l.p1), f(l.p2), f(l.k3), f(l.k4), f(l.k5), f(l.k6),
                        1e-6f, xb, yb, valid);
      ASSERT_GT(valid, 0.5f);
      EXPECT_NEAR(xb, xf, 8e-6);
      EXPECT_NEAR(yb, yf, 8e-6);
    }
  }
}

TEST(Vignetting, FollowsTheFourthPowerOfTheCosine) {
  using L = models::LensMath<double>;
  const double theta = 0.5, r = std::tan(theta), c = std::cos(theta);
  EXPECT_NEAR(L::vignetting_factor(r * 0.6, r * 0.8, 1, 0, 0, 0), c * c * c * c, 1e-15);
  EXPECT_NEAR(L::vignetting_factor(r, 0, 0.5, 0, 0, 0), 0.5 + 0.5 * c * c * c * c, 1e-15);
  EXPECT_NEAR(L::vignetting_factor(0.5, 0, 0, -0.2, 0.1, 0.01), 1 - 0.05 + 0.1 / 16 + 0.01 / 64, 1e-15);
  EXPECT_EQ(L::vignetting_factor(3, 0, 0, -1, 0, 0), 0.0) << "never negative";
}

}  // namespace
}  // namespace rigor
