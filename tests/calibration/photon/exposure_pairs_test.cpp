#include "calibration/photon/exposure_pairs.h"

#include <cmath>
#include <filesystem>
#include <iostream>
#include <opencv2/imgcodecs.hpp>

#include "tests/calibration/photon/photon_fixture.h"
#include "tests/paths.h"

namespace rigor::calibration {
namespace {

namespace fs = std::filesystem;

/// A still scene of smooth brightness, one frame of each exposure.
void still_scene(FrameStacks& stacks, const CameraModel& m, std::uint64_t seed, double moved_px) {
  const auto stage = test::make_stage(m, true, seed);
  std::uint64_t index = 0;
  for (const double t : {0.005, 0.01, 0.02, 0.04, 0.08}) {
    OpticsPicture p = test::even_picture(m, 40000, 1.0);
    for (int y = 0; y < m.height_px; ++y)
      for (int x = 0; x < m.width_px; ++x)
        p.radiance[4 * static_cast<std::size_t>(y * m.width_px + x)] *= static_cast<float>(
            1 + 0.9 * std::sin((x + moved_px * static_cast<double>(index)) / 30.0) * std::sin(y / 25.0));
    const auto n = test::numbers(*stage, p, ++index, t);
    const std::vector<std::uint16_t> pixels(n.begin(), n.end());
    ASSERT_TRUE(stacks.add({"frame", t, true}, pixels, m.width_px, m.height_px));
  }
}

TEST(ExposurePairs, SingleFramesOfAStillSceneGiveTheGain) {
  CameraModel m = noisy_camera(240, 160);
  m.noise.dark_current_e_per_s = 0;
  m.noise.black_level_dn = 0;
  double chi2 = 0;
  const int seeds = 20;
  for (std::uint64_t seed = 0; seed < seeds; ++seed) {
    FrameStacks stacks;
    still_scene(stacks, m, seed, 0);
    const auto fit = fit_photon(stacks, {.bits = 12});
    ASSERT_TRUE(fit) << fit.error().text();
    const Parameter* gain = fit->result.find("system_gain_dn_per_e");
    ASSERT_TRUE(gain) << all_words(fit->result);
    EXPECT_NEAR(gain->value, 0.38, 0.04) << all_words(fit->result);
    chi2 += std::pow((gain->value - 0.38) / gain->sigma, 2);
    EXPECT_TRUE(not_identifiable(fit->result, "read_noise_e"));
  }
  std::cout << "mean square of the normalised errors " << chi2 / seeds << "\n";
  EXPECT_LT(chi2 / seeds, 2.3) << "χ² of 20 at 0.001";
}

TEST(ExposurePairs, RealFlea3GivesAGainAndNoNoiseOfClippedBlacks) {
  const fs::path folder = rigor::test::test_data("exposure_series");
  if (!fs::exists(folder)) GTEST_SKIP() << "test data: " << folder << " is not here";
  FrameStacks stacks;
  for (const auto& entry : fs::directory_iterator(folder)) {
    const std::string name = entry.path().filename().string();
    if (entry.path().extension() != ".tif") continue;
    const cv::Mat image = cv::imread(entry.path().string(), cv::IMREAD_UNCHANGED);
    ASSERT_EQ(image.type(), CV_8UC1);
    const std::size_t end = name.find("ms_"), begin = name.rfind('_', end) + 1;
    const PhotonFrame frame{name, std::stod(name.substr(begin, end - begin)) * 1e-3,
                            name.find("dark") == std::string::npos};
    const std::vector<std::uint16_t> pixels(image.begin<std::uint8_t>(), image.end<std::uint8_t>());
    ASSERT_TRUE(stacks.add(frame, pixels, image.cols, image.rows));
  }
  const auto fit = fit_photon(stacks, {.bits = 8});
  ASSERT_TRUE(fit) << fit.error().text();
  std::cout << all_words(fit->result);
  EXPECT_TRUE(fit->statistics.mosaic);
  for (const char* name : {"read_noise_e", "dark_current_e_per_s", "black_level_dn", "dsnu_e"}) {
    EXPECT_TRUE(not_identifiable(fit->result, name, "clipped at black")) << name;
    EXPECT_FALSE(fit->result.find(name)) << name << " of clipped frames is no number";
  }
  const Parameter* gain = fit->result.find("system_gain_dn_per_e");
  if (gain) {
    // By hand, from the scatter at one brightness of each pair: 0.036 to 0.048.
    EXPECT_NEAR(gain->value, 0.042, 0.008);
    EXPECT_GT(gain->sigma, 0.001) << "the pairs differ by more than their own uncertainty";
  } else {
    EXPECT_TRUE(not_identifiable(fit->result, "system_gain_dn_per_e"));
  }
  ASSERT_TRUE(fit->linearity_error);
  std::cout << "linearity error " << *fit->linearity_error << "\n";
  EXPECT_LT(*fit->linearity_error, 0.05);
}

}  // namespace
}  // namespace rigor::calibration
