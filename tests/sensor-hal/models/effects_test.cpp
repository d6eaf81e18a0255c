// Effects by name: each alone, none, and names that are none.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "sensor-hal/models/camera_effects.h"
#include "sensor-hal/models/lidar/lidar_effects.h"
#include "sensor-hal/models/tof/tof_model_effects.h"

namespace rigor {
namespace {

using testing::HasSubstr;
using Names = std::vector<std::string>;

TEST(EffectSwitches, OfACameraLeaveWhatIsNamedAndTakeTheRest) {
  CameraModel m;
  m.lens.k1 = -0.2;
  m.bloom.fraction = 0.1;
  m.bloom.veiling_glare = 0.01;
  m.depth_of_field.focus_distance_m = 2;
  m.shutter.line_time_s = 1e-5;
  const auto only = only_effects(m, Names{"bloom", "read_noise"});
  ASSERT_TRUE(only);
  EXPECT_EQ(only->bloom.fraction, 0.1);
  EXPECT_EQ(only->noise.read_noise_e, m.noise.read_noise_e);
  EXPECT_EQ(only->bloom.veiling_glare, 0);
  EXPECT_EQ(only->lens, OpenCvLens{});
  EXPECT_EQ(only->depth_of_field.focus_distance_m, 0);
  EXPECT_EQ(only->shutter.line_time_s, 0);
  EXPECT_FALSE(only->noise.shot_noise);
  EXPECT_EQ(only->noise.prnu, 0);
  EXPECT_EQ(only->fx_px, m.fx_px);
}

TEST(EffectSwitches, NameTheEffectsThereAreWhereOneIsUnknown) {
  const auto camera = only_effects(CameraModel{}, Names{"blom"});
  ASSERT_FALSE(camera);
  EXPECT_EQ(camera.error().code, ErrorCode::bad_input);
  EXPECT_THAT(camera.error().text(), testing::AllOf(HasSubstr("\"blom\""), HasSubstr("bloom")));
  EXPECT_THAT(models::only_effects(models::LidarModel{}, Names{"footprnt"}).error().text(),
              HasSubstr("footprint"));
  EXPECT_THAT(models::only_effects(models::TofModel{}, Names{"wiggling"}).error().text(),
              HasSubstr("wiggling_bias, sine_like_noise, trembling"));
}

TEST(EffectSwitches, OfALidarAndATimeOfFlightCameraTakeEveryError) {
  models::LidarModel lidar;
  lidar.footprint.sub_rays = 5;
  lidar.echoes = {.separation_m = 0.5, .returns = models::LidarReturns::dual};
  lidar.noise.floor_m = 0.01;
  lidar.range.step_m = 0.002;
  lidar.scan.beams[0].range_bias_m = 0.03;
  const auto bias = models::only_effects(lidar, Names{"beam_bias"});
  ASSERT_TRUE(bias);
  EXPECT_EQ(bias->scan.beams[0].range_bias_m, 0.03);
  EXPECT_EQ(bias->footprint.sub_rays, 1);
  EXPECT_EQ(bias->noise.floor_m, 0);
  EXPECT_EQ(bias->range.step_m, 0);

  EXPECT_EQ(bias->echoes.returns, models::LidarReturns::strongest);
  EXPECT_EQ(bias->echoes.separation_m, 0.5) << "or each sub-ray would be an echo of its own";
  EXPECT_EQ(models::only_effects(lidar, Names{"none"})->scan.beams[0].range_bias_m, 0);

  models::TofModel tof;
  tof.pixel.adc_bits = 12;
  tof.sampling.samples = 4;
  const auto flying = models::only_effects(tof, Names{"flying_pixels"});
  ASSERT_TRUE(flying);
  EXPECT_EQ(flying->sampling.samples, 4);
  EXPECT_FALSE(flying->pixel.trembling);
  EXPECT_EQ(flying->pixel.adc_bits, 0);
  EXPECT_GT(flying->pixel.full_well_e, 1e9);
  const auto rounded = models::only_effects(tof, Names{"quantisation"});
  ASSERT_TRUE(rounded);
  EXPECT_EQ(rounded->pixel.full_well_e, tof.pixel.full_well_e) << "the step hangs on the well";
}

TEST(EffectSwitches, GiveModelsThatAreValid) {
  for (const auto name : camera_effects())
    EXPECT_TRUE(only_effects(CameraModel{}, Names{std::string(name)})->validate()) << name;
  for (const auto name : models::tof_effects())
    EXPECT_TRUE(models::only_effects(models::TofModel{}, Names{std::string(name)})->validate()) << name;
}

}  // namespace
}  // namespace rigor
