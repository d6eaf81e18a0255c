// Where the rays optics traces more: pixels that differ from a neighbour.
#include "sim/sensors/camera/uneven_pixels.h"

#include <limits>

#include "tests/sim/sensors/camera/plate_world.h"

namespace rigor::test {
namespace {

OpticsPicture even_picture(int width_px, int height_px, float radiance) {
  return {width_px, height_px,
          std::vector<float>(4 * static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px),
                             radiance)};
}
float& at(OpticsPicture& p, int u, int v, std::size_t band) {
  return p.radiance[4 * static_cast<std::size_t>(v * p.width_px + u) + band];
}
bool everywhere(int, int) { return true; }
constexpr std::array<float, 4> kMean{1, 1, 1, 1};

TEST(UnevenPixels, AreAPixelThatDiffersAndItsNeighbours) {
  OpticsPicture p = even_picture(9, 7, 1);
  at(p, 4, 3, 2) = 2.1F;
  const auto found = uneven_pixels(p, {0, 0, 9, 7}, kMean, 1, everywhere);
  EXPECT_EQ(found.size(), 9U);
  for (const PixelPlace& q : found) EXPECT_TRUE(std::abs(q.u - 4) <= 1 && std::abs(q.v - 3) <= 1);
  at(p, 4, 3, 2) = 1.9F;
  EXPECT_TRUE(uneven_pixels(p, {0, 0, 9, 7}, kMean, 1, everywhere).empty());
}

TEST(UnevenPixels, TheContrastIsRelativeToTheMeanOfTheBand) {
  OpticsPicture p = even_picture(5, 5, 1);
  at(p, 2, 2, 3) = 2.1F;
  EXPECT_TRUE(uneven_pixels(p, {0, 0, 5, 5}, {1, 1, 1, 2}, 1, everywhere).empty());
  EXPECT_EQ(uneven_pixels(p, {0, 0, 5, 5}, {2, 2, 2, 1}, 1, everywhere).size(), 9U);
  EXPECT_TRUE(uneven_pixels(p, {0, 0, 5, 5}, {0, 0, 0, 0}, 1, everywhere).empty());
}

TEST(UnevenPixels, OfAPartKnowTheNeighboursBeyondIt) {
  OpticsPicture p = even_picture(9, 7, 1);
  at(p, 4, 3, 0) = 3;
  const auto found = uneven_pixels(p, {5, 4, 4, 3}, kMean, 1, everywhere);
  EXPECT_EQ(found, (std::vector<PixelPlace>{{5, 4}}));
}

TEST(UnevenPixels, PlacesWithoutLightAndValuesThatAreNotFiniteDoNotCount) {
  OpticsPicture p = even_picture(9, 7, 2);
  at(p, 0, 0, 0) = 0;
  EXPECT_TRUE(uneven_pixels(p, {0, 0, 9, 7}, kMean, 1, [](int u, int v) { return u > 0 || v > 0; }).empty());
  EXPECT_EQ(uneven_pixels(p, {0, 0, 9, 7}, kMean, 1, everywhere).size(), 4U);
  at(p, 0, 0, 0) = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(uneven_pixels(p, {0, 0, 9, 7}, kMean, 1, everywhere).empty());
}

TEST_P(CameraOptics, MoreSamplesInUnevenPixelsTakeTheErrorAwayFromThinThings) {
  if (!rays()) return;
  // Bars a little wider than a pixel, so that the middle of a pixel meets each of them.
  for (int i = 0; i < 8; ++i)
    world_.put({0.6F * 3 / 80, 1e-3F, 1}, in_front((i - 4) * 0.2 + 0.011 * i, 0, 3));
  CameraModel lens = small_camera();
  CameraModel coloured = lens;
  coloured.chromatic.magnification = {1.02, 1, 0.97};
  for (const CameraModel& m : {lens, coloured})
    for (const bool traced : {false, true}) {
      // Colours that are moved are blurred in both.
      OpticsOptions o = fine();
      o.trace_colours = traced;
      const OpticsPicture reference = shoot(m, o);
      o = plain();
      o.trace_colours = traced;
      const double few = rms(shoot(m, o), reference);
      o.samples.uneven = 16;
      EXPECT_LT(rms(shoot(m, o), reference), 0.35 * few);
    }
}

TEST_P(CameraOptics, APartIsTheSameAsInTheWholePictureWithMoreSamplesInUnevenPixels) {
  if (!rays()) return;
  world_.put({0.15F, 1e-3F, 0.15F}, in_front(0.5, -0.3, 3));
  world_.put({0.01F, 1e-3F, 0.5F}, in_front(-0.2, 0.1, 3));
  CameraModel coloured = small_camera();
  coloured.chromatic.magnification = {1.02, 1, 0.97};
  for (const CameraModel& m : {small_camera(), coloured})
    for (const int step : {1, 2}) {
      OpticsOptions o = plain();
      o.samples.uneven = 4;
      o.pixel_step = step;
      const OpticsPicture whole = shoot(m, o);
      OpticsRequest part;
      part.region = {37, 9, 17, 14};
      const OpticsPicture cut = shoot(m, o, part);
      for (int v = 0; v < 14; ++v)
        for (int u = 0; u < 17; ++u)
          for (int band = 0; band < 4; ++band)
            ASSERT_EQ(CameraOptics::at(cut, u, v, band), CameraOptics::at(whole, u + 37, v + 9, band))
                << u << " " << v << " " << band << " step " << step;
    }
}

TEST_P(CameraOptics, SamplesByDefaultAreAsGoodAsFourInEveryPixel) {
  if (!rays()) return;
  world_.light().light.sky = even_sky(5);
  // Bars before each other and before the sky, narrower and wider than a pixel, and a plate behind half of
  // them.
  for (int i = 0; i < 8; ++i)
    world_.put({(0.4F + 0.2F * static_cast<float>(i)) * 3 / 80, 1e-3F, 1},
               in_front((i - 4) * 0.2 + 0.011 * i, 0, 3), 0.1F + 0.1F * static_cast<float>(i % 3));
  world_.put({2, 1e-3F, 0.5F}, in_front(0, -0.4, 4), 0.6F);
  CameraModel blurred = small_camera();
  blurred.optics.f_number = 2;
  blurred.optics.pixel_pitch_m = 20e-6;
  blurred.depth_of_field.focus_distance_m = 1;
  for (const CameraModel& m : {small_camera(), blurred}) {
    const OpticsPicture reference = shoot(m, fine());
    OpticsOptions o = plain();
    o.samples = PixelSamples::only(4);
    const double four = rms(shoot(m, o), reference);
    o.samples = {};
    EXPECT_EQ(o.samples.every, 1);
    EXPECT_LT(rms(shoot(m, o), reference), four);
    o.samples = PixelSamples::only(1);
    EXPECT_GT(rms(shoot(m, o), reference), 1.5 * four);  // the picture has what more samples are for
  }
}

TEST_P(CameraOptics, SkySamplesFindTheShareOfSkyInAPixel) {
  if (!rays()) return;
  world_.light().light.sky = even_sky(5);
  // Bars before the sky, narrower and wider than a pixel.
  for (int i = 0; i < 8; ++i)
    world_.put({(0.4F + 0.2F * static_cast<float>(i)) * 3 / 80, 1e-3F, 1},
               in_front((i - 4) * 0.2 + 0.011 * i, 0, 3), 0.1F);
  const OpticsPicture reference = shoot(small_camera(), fine());
  OpticsOptions o = plain();
  o.samples.every = 1;
  const double few = rms(shoot(small_camera(), o), reference);
  o.samples.sky = 16;
  EXPECT_LT(rms(shoot(small_camera(), o), reference), 0.3 * few);
}

/// Two black plates with a slit of sky between them, a third of a pixel wide, that leans by a pixel in ten.
void put_slit(PlateWorld& world) {
  for (const double side : {-1.0, 1.0}) {
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.linear() = Eigen::AngleAxisd(std::atan(0.1), Eigen::Vector3d::UnitY()).toRotationMatrix();
    T.translation() =
        in_front(0, 0, 3) + T.linear() * Eigen::Vector3d(side * (2 + 0.5 * 0.33 * 3 / 80), 0, 0);
    world.add({{2, 1e-3F, 2}, [T](double) { return T; }, false, 0});
  }
}

TEST_P(CameraOptics, SkySamplesFollowASlitFromWhereTheMiddleOfAPixelMeetsIt) {
  if (!rays()) return;
  world_.light().light.sky = even_sky(50);
  put_slit(world_);
  const OpticsPicture reference = shoot(small_camera(), fine());
  // Rows above the horizon in which sky is found: of ten, three or four by the middles of pixels, and three
  // to both sides.
  const auto found = [&](const OpticsPicture& p) {
    int rows = 0;
    for (int v = 0; v < 22; ++v) {
      float light = 0, all = 0;
      for (int u = 0; u < p.width_px; ++u)
        light += CameraOptics::at(p, u, v, 0), all += CameraOptics::at(reference, u, v, 0);
      rows += light > 0.5F * all ? 1 : 0;
    }
    return rows;
  };
  OpticsOptions o = plain();
  EXPECT_LT(found(shoot(small_camera(), o)), 10);
  o.samples.sky = 16;
  EXPECT_GT(found(shoot(small_camera(), o)), 19);
}

TEST_P(CameraOptics, SkySamplesAreRightOnTheMeanWhereFewOfThemMeetTheSky) {
  if (!rays()) return;
  world_.light().light.sky = even_sky(50);
  // A plate to the left that leaves a fiftieth of the pixels of column 32.
  world_.put({1, 1e-3F, 2}, in_front(0.98 * 3 / 80 - 1, 0, 3), 0);
  OpticsOptions o = plain();
  o.samples.sky = 16;
  constexpr int kRows = 22, kDraws = 40;  // above the horizon
  double share = 0;
  for (int i = 0; i < kDraws; ++i) {
    OpticsRequest request;
    request.seed = static_cast<std::uint64_t>(i) + 1;
    const OpticsPicture p = shoot(small_camera(), o, request);
    for (int v = 0; v < kRows; ++v)
      share +=
          static_cast<double>(CameraOptics::at(p, 32, v) / CameraOptics::at(p, 40, v)) / (kRows * kDraws);
  }
  // One sample of 17 is in the middle. Standard error: at most 6 %.
  EXPECT_NEAR(share, 0.02 * 16 / 17, 0.2 * 0.02);
}

TEST_P(CameraOptics, APartIsTheSameAsInTheWholePictureInGatheredLight) {
  if (!rays()) return;
  world_.light().light.sky = even_sky(2);
  world_.light().light.ground_albedo = grey(0.2F);
  world_.put({20, 20, 0.1F}, {0, 0, -0.6}, 0.6F);  // a floor, a box and a wall
  world_.put({0.3F, 0.3F, 0.5F}, {0.3, 2.5, -0.4}, 0.3F);
  world_.put({0.1F, 5, 3}, {-1, 3, 0}, 0.8F);
  for (const auto& [every, uneven, sky] : {std::array{1, 0, 0}, {2, 0, 0}, {1, 7, 0}, {1, 7, 8}})
    for (const int step : {1, 2}) {
      OpticsOptions o = plain();
      o.samples = {every, uneven, sky};
      o.pixel_step = step;
      const OpticsPicture whole = shoot(small_camera(), o);
      for (int left = 16; left < 20; ++left)
        for (int top = 20; top < 22; ++top) {
          OpticsRequest part;
          part.region = {left, top, 21, 15};
          const OpticsPicture cut = shoot(small_camera(), o, part);
          for (int v = 0; v < 15; ++v)
            for (int u = 0; u < 21; ++u)
              ASSERT_EQ(CameraOptics::at(cut, u, v), CameraOptics::at(whole, u + left, v + top))
                  << u << " " << v << " of the part from " << left << " " << top << ", samples " << every
                  << " " << uneven << " " << sky << " step " << step;
        }
    }
}

TEST_P(CameraOptics, SkySamplesSeeTheSkyFromWithinABodyWithOneSide) {
  if (!rays()) return;
  world_.light().light.sky = even_sky(5);
  world_.put({2, 2, 2}, {0, 0, 0}, 0.5F);  // the eye is in it
  world_.put({0.02F, 1e-3F, 1}, in_front(0, 0, 3), 0.1F);
  OpticsOptions o = plain();
  const OpticsPicture without = shoot(small_camera(), o);
  o.samples.sky = 16;
  EXPECT_LT(rms(shoot(small_camera(), o), without), 0.1 * 5);
}

TEST_P(CameraOptics, APartIsTheSameAsInTheWholePictureWithSkySamples) {
  if (!rays()) return;
  world_.light().light.sky = even_sky(5);
  put_slit(world_);
  for (int i = 0; i < 5; ++i)
    if (i != 1) world_.put({0.02F, 1e-3F, 0.7F}, in_front(0.17 * i - 0.2, 0.1, 2), 0.3F);
  for (const auto& [uneven, sky] : {std::pair{0, 8}, {4, 8}, {0, 12}}) {
    OpticsOptions o = plain();
    o.samples.uneven = uneven;
    o.samples.sky = sky;
    const OpticsPicture whole = shoot(small_camera(), o);
    // Parts that begin at all places of the slit: some know of it only by what lies beyond their edge.
    for (int top = 0; top < 12; ++top) {
      OpticsRequest part;
      part.region = {25, top, 17, 10};
      const OpticsPicture cut = shoot(small_camera(), o, part);
      for (int v = 0; v < 10; ++v)
        for (int u = 0; u < 17; ++u)
          for (int band = 0; band < 4; ++band)
            ASSERT_EQ(CameraOptics::at(cut, u, v, band), CameraOptics::at(whole, u + 25, v + top, band))
                << u << " " << v << " of the part from row " << top;
    }
  }
}

TEST_P(CameraOptics, RefusesSamplesOutOfRange) {
  if (!rays()) return;
  OpticsOptions o = plain();
  for (const int n : {-1, 4097}) {
    o.samples.uneven = n;
    auto light = SharedLight::create(nullptr);
    ASSERT_TRUE(light) << light.error().text();
    OpticsOptions sky = plain();
    sky.samples.sky = n;
    for (const OpticsOptions& wrong : {o, sky}) {
      const auto made = make_rays_optics(small_camera(), wrong, *light);
      ASSERT_FALSE(made);
      EXPECT_EQ(made.error().code, ErrorCode::bad_input);
    }
  }
}

}  // namespace
}  // namespace rigor::test
