#include "calibration/camera/camera_fit.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <random>

namespace rigor::calibration {
namespace {

namespace fs = std::filesystem;

fs::path recording(const std::string& name) { return fs::path(RIGOR_SOURCE_DIR) / "../shared/data" / name; }

#define NEED_RECORDING(path) \
  if (!fs::exists(path)) GTEST_SKIP() << "test data: " << path << " is not here"

const Board kBoard{BoardKind::chessboard, 9, 6, 1.0};

TEST(CameraFit, RealChessboardWithCleanCornersGivesTheReferenceValues) {
  const auto file = recording("chessboard_left/corners_win7_left.vnl");
  NEED_RECORDING(file);
  const auto views = read_corner_list(file, kBoard, 640, 480);
  ASSERT_TRUE(views) << views.error().text();
  const auto fit = fit_camera(*views, {});
  ASSERT_TRUE(fit) << fit.error().text();
  for (const auto& c : fit->result.candidates)
    std::cout << c.name << " rms " << c.rms << " bic " << c.bic << " cv " << c.cross_validation << " ± "
              << c.cross_validation_sigma << " " << c.note << (c.chosen ? " *" : "") << "\n";
  for (const auto& p : fit->result.parameters)
    std::cout << p.name << " " << p.value << " ± " << p.sigma << "\n";
  std::cout << "rejected " << fit->result.rejected.size() << " rms per corner " << fit->rms_per_corner_px
            << "\n";
  EXPECT_EQ(fit->lens_model, LensModel::opencv4);
  EXPECT_NEAR(fit->result.find("fx_px")->value, 533.1, 0.9);
}

TEST(CameraFit, RealChessboardWithBadCornersNamesThemAndComesBack) {
  const auto file = recording("chessboard_left/corners_win11_left.vnl");
  NEED_RECORDING(file);
  const auto views = read_corner_list(file, kBoard, 640, 480);
  ASSERT_TRUE(views) << views.error().text();
  const auto fit = fit_camera(*views, {.models = {LensModel::opencv4}});
  ASSERT_TRUE(fit) << fit.error().text();
  for (const auto& r : fit->result.rejected)
    std::cout << r.what << " " << r.residual << " " << r.sigmas << "\n";
  EXPECT_NEAR(fit->result.find("fx_px")->value, 533.6, 0.5);
}

}  // namespace
}  // namespace rigor::calibration
