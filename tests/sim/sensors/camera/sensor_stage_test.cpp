// What comes out of the sensor stage: formats, mosaic, processing, regions, odd input, threads.
#include "sim/sensors/camera/sensor_stage.h"

#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <limits>

#include "sensor-hal/models/one_source.h"
#include "tests/sim/sensors/camera/sensor_stage_fixture.h"

namespace rigor {
namespace {

using test::busy_picture;
using test::even_picture;
using test::make_stage;
using test::numbers;
using test::quiet_camera;
using test::radiance_for;
using test::shoot;

int word(const std::vector<std::byte>& b, std::size_t i) {
  return std::to_integer<int>(b[2 * i]) | std::to_integer<int>(b[2 * i + 1]) << 8;
}

CameraModel camera_with_everything(int width = 161, int height = 83) {
  CameraModel m = quiet_camera(width, height);
  m.noise.shot_noise = true;
  m.noise.read_noise_e = 5;
  m.noise.dsnu_e = 2;
  m.noise.prnu = 0.01;
  m.noise.dark_current_e_per_s = 100;
  m.noise.hot_pixel_share = 0.002;
  m.noise.hot_pixel_dark_e_per_s = 3e4;
  m.noise.black_level_dn = 64;
  m.lens.k1 = -0.2;
  m.vignetting.cos4_weight = 1;
  m.bloom = {.fraction = 0.05, .radius_px = 3, .exponent = 1.5, .veiling_glare = 0.02};
  m.processing = {.median_filter = true,
                  .white_balance = {1.6, 1, 1.4},
                  .demosaic = true,
                  .gamma = 2.2,
                  .subtract_black = true};
  return m;
}

TEST(SensorStage, SameBytesOnAnyNumberOfThreads) {
  for (const bool processing : {false, true}) {
    CameraModel m = camera_with_everything();
    if (!processing) m.processing = {};
    const OpticsPicture p = busy_picture(m);
    std::vector<std::vector<std::byte>> first;
    for (const std::size_t threads : {1u, 2u, 4u}) {
      const tbb::global_control allowed(tbb::global_control::max_allowed_parallelism, threads);
      tbb::task_arena arena(static_cast<int>(threads));
      arena.execute([&] {
        const auto stage = make_stage(m);
        for (std::size_t i = 0; i < kPixelFormats.size(); ++i) {
          const auto got =
              shoot(*stage, p, {.capture_index = 3, .exposure_s = 0.01, .format = kPixelFormats[i]},
                    m.width_px, m.height_px);
          if (threads == 1) first.push_back(got);
          EXPECT_EQ(got, first[i]) << pfnc_name(kPixelFormats[i]) << " on " << threads;
        }
      });
    }
  }
}

// A region is the crop of the full picture, whatever looks beyond its border, where the full picture is
// handed in; and without such effects from the region's own light alone.
TEST(SensorStage, ARegionIsTheCropOfTheFullPicture) {
  for (const bool spreading : {false, true}) {
    CameraModel m = camera_with_everything();
    if (!spreading) {
      m.bloom = {};
      m.processing.median_filter = m.processing.demosaic = false;
    }
    const auto stage = make_stage(m);
    const OpticsPicture full = busy_picture(m);
    constexpr OpticsRequest::Region r{34, 18, 57, 31};
    OpticsPicture cut{r.width_px, r.height_px, {}};
    for (int y = 0; y < r.height_px; ++y) {
      const auto* const row =
          full.radiance.data() + 4 * (static_cast<std::size_t>(r.y_px + y) * m.width_px + r.x_px);
      cut.radiance.insert(cut.radiance.end(), row, row + 4 * r.width_px);
    }
    for (const PixelFormat f : kPixelFormats) {
      if (f == PixelFormat::mono12p) continue;  // its rows begin within bytes; mono12 stands for it
      const SensorStageRequest q{.capture_index = 8, .exposure_s = 0.01, .format = f};
      const auto whole = shoot(*stage, full, q, m.width_px, m.height_px);
      SensorStageRequest part = q;
      part.region = r;
      const auto from_full = shoot(*stage, full, part, r.width_px, r.height_px);
      const std::size_t bytes = bits_per_pixel(f) / 8;
      std::vector<std::byte> crop;
      for (int y = 0; y < r.height_px; ++y) {
        const auto* const row =
            whole.data() + bytes * (static_cast<std::size_t>(r.y_px + y) * m.width_px + r.x_px);
        crop.insert(crop.end(), row, row + bytes * r.width_px);
      }
      EXPECT_EQ(from_full, crop) << pfnc_name(f);
      if (!spreading) {
        EXPECT_EQ(shoot(*stage, cut, part, r.width_px, r.height_px), crop) << pfnc_name(f);
      }
    }
  }
}

TEST(SensorStage, EveryDepthCarriesTheUpperBits) {
  CameraModel m = camera_with_everything(33, 21);  // odd: rows of Mono12p begin within bytes
  m.processing = {};
  m.bloom = {};
  m.optics.colour_efficiency = {m.optics.mono_efficiency, m.optics.mono_efficiency, m.optics.mono_efficiency};
  const OpticsPicture p = busy_picture(m);
  for (const int adc : {8, 10, 12, 14, 16}) {
    m.noise.adc_bits = adc;
    m.noise.system_gain_dn_per_e = std::ldexp(0.25, adc - 12);
    m.noise.black_level_dn = std::ldexp(64, adc - 12);
    const auto stage = make_stage(m);
    const auto in = [&](PixelFormat f) {
      return shoot(*stage, p, {.capture_index = 2, .exposure_s = 0.01, .format = f}, 33, 21);
    };
    const auto full = in(PixelFormat::mono16), packed = in(PixelFormat::mono12p), m8 = in(PixelFormat::mono8),
               m10 = in(PixelFormat::mono10), m12 = in(PixelFormat::mono12), b8 = in(PixelFormat::bayer_rg8),
               b10 = in(PixelFormat::bayer_rg10), b12 = in(PixelFormat::bayer_rg12),
               b16 = in(PixelFormat::bayer_rg16), rgb = in(PixelFormat::rgb8);
    ASSERT_EQ(packed.size(), (33u * 21 * 12 + 7) / 8);
    ASSERT_EQ(rgb.size(), 3u * 33 * 21);
    int top = 0;
    for (std::size_t i = 0; i < 33 * 21; ++i) {
      const int dn = word(full, i);
      top = std::max(top, dn);
      const auto at = [&](int bits) { return adc > bits ? dn >> (adc - bits) : dn; };
      ASSERT_EQ(std::to_integer<int>(m8[i]), at(8));
      ASSERT_EQ(word(m10, i), at(10));
      ASSERT_EQ(word(m12, i), at(12));
      const std::size_t byte = i * 12 / 8;
      const int lo = std::to_integer<int>(packed[byte]), hi = std::to_integer<int>(packed[byte + 1]);
      ASSERT_EQ(i % 2 == 0 ? lo | (hi & 15) << 8 : lo >> 4 | hi << 4, at(12)) << i;
      // All filters are alike here, and a mosaic's noise is that of a monochrome pixel.
      ASSERT_EQ(word(b16, i), dn);
      ASSERT_EQ(word(b12, i), at(12));
      ASSERT_EQ(word(b10, i), at(10));
      ASSERT_EQ(std::to_integer<int>(b8[i]), at(8));
      ASSERT_EQ(std::to_integer<int>(rgb[3 * i]), at(8)) << "the first of three samples";
    }
    EXPECT_GT(top, (1 << adc) / 2) << "the picture uses the converter";
  }
}

TEST(SensorStage, MosaicPixelsSeeTheirOwnColour) {
  CameraModel m = quiet_camera(24, 16);
  for (const bool bloom : {false, true}) {
    if (bloom) m.bloom.fraction = 0.1;  // light of one colour stays of that colour
    OpticsPicture p = even_picture(m, 0);
    for (std::size_t i = 0; i < p.radiance.size(); i += 4)
      for (std::size_t b = 0; b < 3; ++b)
        p.radiance[i + b] = radiance_for(m, 1000.0 * static_cast<double>(b + 1), 0.01, b);
    const auto stage = make_stage(m);
    for (const OpticsRequest::Region r : {OpticsRequest::Region{}, OpticsRequest::Region{4, 2, 6, 6}}) {
      const int w = r.width_px == 0 ? 24 : r.width_px, h = r.width_px == 0 ? 16 : r.height_px;
      const auto raw =
          shoot(*stage, p, {.exposure_s = 0.01, .format = PixelFormat::bayer_rg12, .region = r}, w, h);
      for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x) {
          const int colour = y % 2 + x % 2;  // R G / G B
          ASSERT_NEAR(word(raw, static_cast<std::size_t>(y) * w + x), 250 * (colour + 1), 1)
              << x << ", " << y;
        }
      CameraModel with = m;
      with.processing.demosaic = true;
      const auto rgb =
          shoot(*make_stage(with), p, {.exposure_s = 0.01, .format = PixelFormat::rgb8, .region = r}, w, h);
      for (std::size_t i = 0; i < rgb.size(); ++i)
        ASSERT_NEAR(std::to_integer<int>(rgb[i]), (250 * (static_cast<int>(i % 3) + 1)) >> 4, 1)
            << "even light";
    }
  }
}

// Malvar, He and Cutler's filters are exact for light that rises linearly, up to rounding.
TEST(SensorStage, DemosaicingFollowsARamp) {
  CameraModel m = quiet_camera(40, 30);
  m.noise.adc_bits = 8;
  m.noise.system_gain_dn_per_e = 0.01;
  m.noise.full_well_e = 20000;
  m.processing.demosaic = true;
  OpticsPicture p = even_picture(m, 0);
  const auto level = [](int x, int y) { return 1000.0 + 300.0 * x + 150.0 * y; };  // 3 and 1.5 DN a pixel
  for (int y = 0; y < 30; ++y)
    for (int x = 0; x < 40; ++x)
      for (std::size_t b = 0; b < 3; ++b)
        p.radiance[4 * (static_cast<std::size_t>(y) * 40 + x) + b] = radiance_for(m, level(x, y), 0.01, b);
  const auto rgb = shoot(*make_stage(m), p, {.exposure_s = 0.01, .format = PixelFormat::rgb8}, 40, 30);
  for (int y = 2; y < 28; ++y)
    for (int x = 2; x < 38; ++x)
      for (int c = 0; c < 3; ++c)
        // Roundings of the raw numbers, each up to 0.5, through weights whose magnitudes sum to 3, and its
        // own.
        ASSERT_NEAR(std::to_integer<int>(rgb[3 * (static_cast<std::size_t>(y) * 40 + x) + c]),
                    0.01 * level(x, y), 1.6);
}

TEST(SensorStage, BalancesWhiteAndBendsGammaAsWritten) {
  CameraModel m = quiet_camera(8, 6);
  m.noise.black_level_dn = 95;
  m.processing.white_balance = {1.5, 1, 2};
  const auto first = [&](PixelFormat f, double electrons) {
    OpticsPicture p = even_picture(m, 0);
    for (std::size_t i = 0; i < p.radiance.size(); i += 4)
      for (std::size_t b = 0; b < 3; ++b) p.radiance[i + b] = radiance_for(m, electrons, 0.01, b);
    return shoot(*make_stage(m), p, {.exposure_s = 0.01, .format = f}, 8, 6);
  };
  // 4000 e- are 1000 DN above 95: red 1595, green 1095, blue 2095.
  auto raw = first(PixelFormat::bayer_rg12, 4000);
  EXPECT_EQ(word(raw, 0), 1595);
  EXPECT_EQ(word(raw, 1), 1095);
  EXPECT_EQ(word(raw, 9), 2095);
  EXPECT_EQ(word(first(PixelFormat::mono12, 4000), 0), 1095) << "no colours, no balance";
  EXPECT_EQ(word(first(PixelFormat::bayer_rg12, 12000), 9), 4095) << "clipped";
  m.processing = {.gamma = 2};
  // 1000 of the 4000 DN above black: the square root of a quarter.
  EXPECT_EQ(word(first(PixelFormat::mono12, 4000), 0), 95 + 2000);
  EXPECT_EQ(word(first(PixelFormat::mono12, 0), 0), 95);
  m.processing.subtract_black = true;
  EXPECT_EQ(word(first(PixelFormat::mono12, 4000), 0), 2048) << "4095 / 2, rounded";
  EXPECT_EQ(word(first(PixelFormat::mono12, 0), 0), 0);
  EXPECT_EQ(std::to_integer<int>(first(PixelFormat::mono8, 4000)[0]), 128) << "rounded at the output's bits";
}

TEST(SensorStage, TheMedianTakesHotPixelsAway) {
  CameraModel m = quiet_camera(80, 60);
  m.noise.hot_pixel_share = 0.01;
  m.noise.hot_pixel_dark_e_per_s = 4e5;
  const OpticsPicture p = even_picture(m, 400);
  const auto with_hot = numbers(*make_stage(m), p);
  EXPECT_GT(std::count_if(with_hot.begin(), with_hot.end(), [](int v) { return v > 110; }), 20);
  m.processing.median_filter = true;
  const auto filtered = numbers(*make_stage(m), p);
  // Five hot ones among nine pixels: 126 * 0.01^5 = 1e-8 of the pixels.
  for (const int v : filtered) ASSERT_EQ(v, 100);
}

TEST(SensorStage, VignettingIsTheModelsAlongTheIdealRay) {
  CameraModel m = quiet_camera(200, 150);
  m.fx_px = m.fy_px = 120;
  m.lens.k1 = -0.05;
  m.vignetting = {.cos4_weight = 0.7, .a2 = -0.1};
  m.noise.adc_bits = 16;
  m.noise.system_gain_dn_per_e = 4;
  const auto dn = numbers(*make_stage(m), even_picture(m, 12000));
  for (int y = 0; y < 150; y += 7)
    for (int x = 0; x < 200; x += 7) {
      const auto ray = unproject(m, {static_cast<double>(x), static_cast<double>(y)});
      ASSERT_TRUE(ray);
      const double v = models::LensMath<double>::vignetting_factor(ray->x, ray->y, 0.7, -0.1, 0, 0);
      EXPECT_NEAR(dn[static_cast<std::size_t>(y) * 200 + x], 48000 * v, 0.5 + 0.3);
    }
}

TEST(SensorStage, AFisheyesVignettingEndsAtNinetyDegrees) {
  CameraModel m = quiet_camera(200, 150);
  m.projection = Projection::kannala_brandt;
  m.fx_px = m.fy_px = 50;
  m.vignetting.cos4_weight = 0.75;
  const auto dn = numbers(*make_stage(m), even_picture(m, 12000));
  for (int x = 0; x < 200; ++x) {
    // An ideal fisheye: the angle is the distance from the middle.
    const double theta = std::hypot(x - m.cx_px, 0.5) / 50, cosine = std::max(0.0, std::cos(theta));
    EXPECT_NEAR(dn[static_cast<std::size_t>(75) * 200 + x], 3000 * (0.25 + 0.75 * std::pow(cosine, 4)), 0.55)
        << x;
  }
  m.vignetting.a2 = -0.1;
  EXPECT_FALSE(m.validate());
}

TEST(SensorStage, CountsWhatIsNoRadianceAndGoesOn) {
  CameraModel m = quiet_camera(16, 12);
  m.optics.mono_efficiency = {0.5, 0.0, 0.5, 0.1};
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN(),
                  kInf = std::numeric_limits<float>::infinity();
  for (const bool bloom : {false, true}) {
    if (bloom) m.bloom = {.fraction = 1e-3, .veiling_glare = 1e-3};
    OpticsPicture p = even_picture(m, 0);
    for (std::size_t b = 0; b < 4; ++b) p.radiance[4 * 5 + b] = kNan;
    p.radiance[4 * 6] = -1.0f;
    p.radiance[4 * 40 + 1] = kNan;  // a band that the sensor does not see
    if (!bloom) p.radiance[4 * 100] = kInf, p.radiance[4 * 101] = 3e38f;
    const auto stage = make_stage(m);
    SensorStageCounts counts;
    std::vector<std::byte> out(16 * 12 * 2);
    ASSERT_TRUE(stage->expose({.exposure_s = 0.01, .format = PixelFormat::mono12}, p, out, &counts));
    EXPECT_EQ(counts.invalid_pixels, 3u);
    EXPECT_EQ(counts.clipped_pixels, bloom ? 0u : 2u);
    for (std::size_t i = 0; i < 16 * 12; ++i)
      EXPECT_EQ(word(out, i), !bloom && (i == 100 || i == 101) ? 3750 : 0) << i;  // the well: 15000 e-
  }
  // One infinite pixel blinds the others by its scattered light and does not turn them into NaN.
  OpticsPicture p = even_picture(m, 0);
  p.radiance[4 * 100] = kInf;
  for (const int dn : numbers(*make_stage(m), p)) EXPECT_EQ(dn, 3750);
}

TEST(SensorStage, RefusesWhatDoesNotFit) {
  const CameraModel m = quiet_camera(32, 24);
  const auto stage = make_stage(m);
  const OpticsPicture p = even_picture(m, 100);
  const auto refused = [&](SensorStageRequest q, std::size_t bytes, const char* named,
                           const OpticsPicture& picture) {
    std::vector<std::byte> out(bytes);
    const Status s = stage->expose(q, picture, out);
    ASSERT_FALSE(s) << named;
    EXPECT_EQ(s.error().code, ErrorCode::bad_input);
    EXPECT_NE(s.error().text().find(named), std::string::npos) << s.error().text();
  };
  refused({.region = {0, 0, 33, 24}}, 33 * 24, "region", p);
  refused({.region = {-1, 0, 8, 8}}, 64, "region", p);
  refused({.region = {0, 0, 8, 0}}, 0, "region", p);  // empty
  refused({.region = {std::numeric_limits<int>::max(), 0, 8, 8}}, 64, "region", p);
  refused({.format = PixelFormat::bayer_rg12, .region = {1, 0, 8, 8}}, 128, "even", p);
  refused({}, 32 * 24 - 1, "bytes", p);
  refused({.exposure_s = -1}, 32 * 24, "exposure", p);
  refused({.exposure_s = std::nan("")}, 32 * 24, "exposure", p);
  refused({.gain_db = 1e9}, 32 * 24, "gain", p);
  refused({}, 32 * 24, "picture", OpticsPicture{31, 24, std::vector<float>(31 * 24 * 4)});
  refused({}, 32 * 24, "radiance", OpticsPicture{32, 24, std::vector<float>(32 * 24 * 4 - 1)});
  CameraModel bad = m;
  bad.noise.prnu = 2;
  EXPECT_FALSE(SensorStage::create({.name = "bad", .model = bad}));
}

TEST(SensorStage, WithoutNoiseNothingIsDrawn) {
  CameraModel m = camera_with_everything(64, 48);
  m.bloom = {};
  m.vignetting = {};
  m.processing = {};
  const auto stage = make_stage(m, false);
  const OpticsPicture p = even_picture(m, 1000);
  for (const int dn : numbers(*stage, p, 1))
    ASSERT_EQ(dn, 64 + 250) << "1 e- of dark current is below a half";
}

}  // namespace
}  // namespace rigor
