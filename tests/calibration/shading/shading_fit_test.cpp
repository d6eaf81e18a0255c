#include "calibration/shading/shading_fit.h"

#include <Eigen/Dense>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <nlohmann/json.hpp>

#include "sensor-hal/models/camera_yaml.h"
#include "tests/paths.h"
#include "tests/sim/sensors/camera/sensor_stage_fixture.h"

namespace rigor::calibration {
namespace {

namespace fs = std::filesystem;

CameraModel shaded_camera() {
  CameraModel m = test::quiet_camera(160, 120);
  m.fx_px = m.fy_px = 130;
  m.cx_px = 81.3, m.cy_px = 58.2;
  m.lens.k1 = -0.05;
  m.vignetting = {0, -0.75, 0.35, 0};
  m.noise.prnu = 0.01;
  m.noise.read_noise_e = 3;
  m.noise.dsnu_e = 1;
  m.noise.black_level_dn = 60;
  m.noise.shot_noise = true;
  return m;
}

std::vector<double> mean_of_frames(const CameraModel& m, std::uint64_t seed, int frames, bool light) {
  const auto stage = test::make_stage(m, true, seed);
  auto picture = test::even_picture(m, light ? 9000 : 0);
  std::vector<double> mean(static_cast<std::size_t>(m.width_px) * static_cast<std::size_t>(m.height_px), 0.0);
  for (int i = 0; i < frames; ++i) {
    const auto n = test::numbers(*stage, picture, static_cast<std::uint64_t>(i + 1000 * light));
    for (std::size_t k = 0; k < n.size(); ++k) mean[k] += double(n[k]) / frames;
  }
  return mean;
}

std::string words(const FitResult& r) {
  std::string s;
  for (const auto& p : r.parameters)
    s += p.name + " " + std::to_string(p.value) + " ± " + std::to_string(p.sigma) + "\n";
  for (const auto& c : r.candidates)
    s += (c.chosen ? "* " : "  ") + c.name + " rms " + std::to_string(c.rms) + " bic " +
         std::to_string(c.bic) + " cv " + std::to_string(c.cross_validation) + " ± " +
         std::to_string(c.cross_validation_sigma) + " " + c.note + "\n";
  for (const auto& w : r.warnings) s += w + "\n";
  return s;
}

TEST(ShadingFit, RecoversTheSimulatedLensWithinItsOwnUncertainty) {
  const CameraModel m = shaded_camera();
  double chi2 = 0, dof = 0;
  int inside = 0, intervals = 0;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    const auto cells =
        flat_field_cells(mean_of_frames(m, seed, 2, true), m.width_px, m.height_px, 60, false, 16);
    ASSERT_TRUE(cells) << cells.error().text();
    const auto fit = fit_shading(*cells, m, {.models = {ShadingModel::r4}});
    ASSERT_TRUE(fit) << fit.error().text();
    const FitResult& r = fit->result;
    const std::vector<Eigen::Index> at{r.index_of("a2"), r.index_of("a4")};
    const Eigen::Vector2d error(r.parameters[1].value - m.vignetting.a2,
                                r.parameters[2].value - m.vignetting.a4);
    const Eigen::MatrixXd cov = r.covariance(at, at);
    chi2 += error.dot(cov.ldlt().solve(error));
    dof += 2;
    for (int k = 0; k < 2; ++k) {
      inside += std::abs(error[k]) <= 1.959964 * std::sqrt(cov(k, k));
      ++intervals;
    }
  }
  std::cout << "χ²/dof " << chi2 / dof << ", inside " << inside << " of " << intervals << "\n";
  const double a = 2 / (9 * dof);
  EXPECT_LT(chi2 / dof, std::pow(1 - a + 3.29 * std::sqrt(a), 3));
  EXPECT_GT(chi2 / dof, std::pow(1 - a - 3.29 * std::sqrt(a), 3));
  EXPECT_NEAR(inside, 0.95 * intervals, 3.29 * std::sqrt(intervals * 0.95 * 0.05) + 0.5);
}

TEST(ShadingFit, TakesNoMoreTermsThanTheLensHas) {
  for (const auto& [v, expected] : {std::pair{Vignetting{0, -0.5, 0, 0}, ShadingModel::r2},
                                    {Vignetting{0.9, 0, 0, 0}, ShadingModel::cos4},
                                    {Vignetting{0, -0.9, 0.6, 0}, ShadingModel::r4},
                                    {Vignetting{}, ShadingModel::none}}) {
    CameraModel m = shaded_camera();
    m.vignetting = v;
    const auto cells =
        flat_field_cells(mean_of_frames(m, 3, 8, true), m.width_px, m.height_px, 60, false, 20);
    ASSERT_TRUE(cells);
    const auto fit = fit_shading(*cells, m, {});
    ASSERT_TRUE(fit) << fit.error().text();
    EXPECT_EQ(fit->model, expected) << words(fit->result);
  }
}

TEST(ShadingFit, RealImx219WithinTwoPercentAndTheFourthPowerIsNeeded) {
  const fs::path file = rigor::test::test_data("lens_shading_imx219/imx219.json");
  if (!fs::exists(file)) GTEST_SKIP() << "test data: " << file << " is not here";
  std::ifstream in(file);
  const auto json = nlohmann::json::parse(in);
  std::vector<double> gains;
  for (const auto& a : json["algorithms"])
    if (a.contains("rpi.alsc")) gains = a["rpi.alsc"]["luminance_lut"].get<std::vector<double>>();
  ASSERT_EQ(gains.size(), 192u);
  const auto sensor_model =
      load_camera(fs::path(rigor::test::source_dir()) / "configs/sensors/rolling-shutter-phone.yaml");
  ASSERT_TRUE(sensor_model);
  const auto cells = gain_table_cells(gains, 16, sensor_model->model.width_px, sensor_model->model.height_px);
  ASSERT_TRUE(cells);
  const auto fit = fit_shading(*cells, sensor_model->model, {});
  ASSERT_TRUE(fit) << fit.error().text();
  std::cout << words(fit->result) << "RMS " << fit->rms << " relative " << fit->rms_relative << "\n";
  EXPECT_LT(fit->rms, 0.02);
  const auto& c = fit->result.candidates;
  EXPECT_GT(c[2].bic, c[3].bic + 10) << "r2 against r4";
  EXPECT_GT(c[2].cross_validation, c[3].cross_validation + c[3].cross_validation_sigma);
  // The powers make up for each other; what to record then is said.
  ASSERT_FALSE(fit->result.weak.empty());
  EXPECT_NE(fit->result.weak[0].cure.find("corners"), std::string::npos);
}

TEST(ShadingFit, DustAndOutliersAreLeftOutAndNamed) {
  const CameraModel m = shaded_camera();
  auto mean = mean_of_frames(m, 5, 8, true);
  for (int y = 30; y < 44; ++y)
    for (int x = 100; x < 116; ++x) mean[static_cast<std::size_t>(y * m.width_px + x)] *= 0.8;
  const auto cells = flat_field_cells(mean, m.width_px, m.height_px, 60, false, 20);
  ASSERT_TRUE(cells);
  const auto fit = fit_shading(*cells, m, {.models = {ShadingModel::r4}});
  ASSERT_TRUE(fit);
  EXPECT_GE(fit->result.rejected.size(), 2u);
  EXPECT_NEAR(fit->result.find("a2")->value, -0.75, 0.02);
}

TEST(ShadingFit, ACentreBesideThePrincipalPointIsSaid) {
  CameraModel m = shaded_camera();
  const auto cells = flat_field_cells(mean_of_frames(m, 5, 8, true), m.width_px, m.height_px, 60, false, 20);
  ASSERT_TRUE(cells);
  CameraModel believed = m;
  believed.cx_px -= 8;
  const auto fit = fit_shading(*cells, believed, {});
  ASSERT_TRUE(fit);
  EXPECT_NEAR(fit->centre_du_px, 8, 1);
  EXPECT_NE(words(fit->result).find("off the principal point"), std::string::npos);
}

TEST(ShadingFit, AMosaicsColoursDoNotMatter) {
  const CameraModel m = shaded_camera();
  auto mean = mean_of_frames(m, 6, 8, true);
  for (int y = 0; y < m.height_px; ++y)
    for (int x = 0; x < m.width_px; ++x) {
      double& v = mean[static_cast<std::size_t>(y * m.width_px + x)];
      const double gain = (y & 1) ? ((x & 1) ? 0.4 : 0.9) : ((x & 1) ? 1.0 : 0.6);
      v = 60 + gain * (v - 60);
    }
  const auto cells = flat_field_cells(mean, m.width_px, m.height_px, 60, true, 20);
  ASSERT_TRUE(cells);
  const auto fit = fit_shading(*cells, m, {.models = {ShadingModel::r4}});
  ASSERT_TRUE(fit);
  EXPECT_NEAR(fit->result.find("a2")->value, -0.75, 0.02);
  EXPECT_NEAR(fit->result.find("a4")->value, 0.35, 0.03);
}

TEST(ShadingFit, BadInputSaysWhatWasExpected) {
  const CameraModel m = shaded_camera();
  EXPECT_FALSE(flat_field_cells(std::vector<double>(160 * 120, 50.0), 160, 120, 60, false)) << "below black";
  EXPECT_FALSE(gain_table_cells(std::vector<double>(12, 1.0), 4, 160, 120)) << "three rows";
  EXPECT_FALSE(gain_table_cells(std::vector<double>(16, -1.0), 4, 160, 120));
  CameraModel fisheye = m;
  fisheye.projection = Projection::kannala_brandt;
  const auto cells = gain_table_cells(std::vector<double>(64, 1.0), 8, 160, 120);
  ASSERT_TRUE(cells);
  const auto fit = fit_shading(*cells, fisheye, {.models = {ShadingModel::r4}});
  ASSERT_FALSE(fit);
  EXPECT_NE(fit.error().text().find("fisheye"), std::string::npos);
  CameraModel tele = m;
  tele.fx_px = tele.fy_px = 1e5;
  EXPECT_FALSE(fit_shading(*cells, tele, {}));
}

}  // namespace
}  // namespace rigor::calibration
