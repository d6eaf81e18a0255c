#include "sensor-hal/channel/pair_watch/image_change.h"

#include <algorithm>
#include <cmath>

#include "tests/sensor-hal/pair_watch/synthetic_scene.h"
#include "tests/sensor-hal/pair_watch/watched_pair.h"

namespace rigor::pair_watch {
namespace {

using testing::camera_of;
using testing::Random;
using testing::Vector;

/// What the real camera differs by from its simulated side.
struct Change {
  double focal = 0, gain = 0, offset_dn = 0, noise = 1, dirt = 0, k1 = 0;
  Vector turn_rad{};
  bool near_thing = false;
  double parallax_px = 0;
};

struct Scene {
  Random random;
  testing::Waves waves{random, 60};
  double near_u, near_v;  ///< a thing near the camera, in shares of the picture
  explicit Scene(std::uint64_t seed) : random(seed) {
    near_u = 0.2 + 0.6 * random.uniform(), near_v = 0.2 + 0.6 * random.uniform();
  }
};

/// DN without noise, of a camera with this change.
std::vector<float> picture(const Scene& scene, CameraModel c, const Change& change) {
  const double black = c.noise.black_level_dn;
  c.fx_px *= 1 + change.focal, c.fy_px *= 1 + change.focal;
  c.lens.k1 += change.k1;
  std::vector<float> out;
  const double near_u = scene.near_u * c.width_px + change.parallax_px, near_v = scene.near_v * c.height_px;
  for (int v = 0; v < c.height_px; ++v)
    for (int u = 0; u < c.width_px; ++u) {
      const OpticalRay d = unproject_ray(c, {double(u), double(v)}).value();
      double light = scene.waves.light(testing::turned(change.turn_rad, {d.x, d.y, d.z}));
      if (change.near_thing && std::hypot(u - near_u, v - near_v) < 0.08 * c.width_px) light = 500;
      light *= 1 + change.gain;
      if (u < c.width_px / 3 && v < c.height_px / 2) light *= 1 - change.dirt;
      out.push_back(static_cast<float>(black + light + change.offset_dn));
    }
  return out;
}

class Pair {
 public:
  Pair(const CameraModel& camera, const Change& simulated_is_off, const Change& change, std::size_t scenes,
       std::uint64_t seed, ImageChangeOptions options = {})
      : camera_(camera), random_(seed), change_(change), changes_(make(camera, options)) {
    real_.reserve(bytes()), simulated_.reserve(bytes());
    for (Sample* s : {&real_, &simulated_}) {
      ImageInfo info;
      info.format = PixelFormat::mono12;
      info.width_px = static_cast<std::uint32_t>(camera.width_px);
      info.height_px = static_cast<std::uint32_t>(camera.height_px);
      s->info = info;
    }
    Change both = simulated_is_off;
    both.focal += change.focal, both.gain += change.gain, both.offset_dn += change.offset_dn;
    both.dirt += change.dirt, both.k1 += change.k1;
    for (std::size_t k = 0; k < 3; ++k) both.turn_rad[k] += change.turn_rad[k];
    Change nothing;
    nothing.near_thing = simulated_is_off.near_thing;
    for (std::size_t i = 0; i < scenes; ++i) {
      const Scene scene(seed * 100 + i);
      simulated_views_.push_back(picture(scene, camera, nothing));
      before_.push_back(picture(scene, camera, simulated_is_off));
      after_.push_back(picture(scene, camera, both));
    }
  }
  static ImageChange make(const CameraModel& camera, const ImageChangeOptions& options) {
    ImageInfo info;
    info.format = PixelFormat::mono12;
    info.width_px = static_cast<std::uint32_t>(camera.width_px);
    info.height_px = static_cast<std::uint32_t>(camera.height_px);
    return ImageChange::make(camera, info, options).value();
  }
  Estimate window(bool changed) {
    const std::size_t i = random_.bits() % simulated_views_.size();
    expose(real_, changed ? after_[i] : before_[i], changed ? change_.noise : 1);
    expose(simulated_, simulated_views_[i], 1);
    EXPECT_TRUE(changes_.add(real_, simulated_));
    Estimate e;
    changes_.finish(e);
    return e;
  }
  ImageChange& changes() { return changes_; }
  Sample& real() { return real_; }
  Sample& simulated() { return simulated_; }

 private:
  [[nodiscard]] std::size_t bytes() const {
    return static_cast<std::size_t>(camera_.width_px) * static_cast<std::size_t>(camera_.height_px) * 2;
  }
  /// Shot and read noise of the camera's model, rounded.
  void expose(Sample& s, const std::vector<float>& mean, double noise) {
    pixels_.resize(mean.size());
    const EmvaNoise& n = camera_.noise;
    const double k = n.system_gain_dn_per_e, read = k * k * n.read_noise_e * n.read_noise_e;
    for (std::size_t i = 0; i < mean.size(); ++i) {
      const double m = double{mean[i]};
      const double sigma = noise * std::sqrt(read + k * (m - n.black_level_dn));
      pixels_[i] =
          static_cast<std::uint16_t>(std::clamp(m + sigma * random_.quick_normal() + 0.5, 0.0, 4095.0));
    }
    testing::fill<std::uint16_t>(s, pixels_);
  }

  CameraModel camera_;
  Random random_;
  Change change_;
  ImageChange changes_;
  Sample real_, simulated_;
  std::vector<std::uint16_t> pixels_;
  std::vector<std::vector<float>> simulated_views_, before_, after_;
};

/// A simulated side that is not perfect.
Change imperfect() {
  Change c;
  c.focal = 0.001, c.gain = 0.02, c.offset_dn = 3, c.turn_rad[1] = 5e-4;
  return c;
}

struct Planted {
  const char* name;
  Change change;
  double truth;
  int most_windows;
};

class ImageChanges : public ::testing::TestWithParam<Planted> {};

TEST_P(ImageChanges, AreFoundAndNamed) {
  const CameraModel camera = camera_of(96, 72);
  Pair pair(camera, imperfect(), GetParam().change, 8, 5);
  ChangeWatch watch = ChangeWatch::make(pair.changes().parameters(), testing::watch_options()).value();
  const int windows = testing::windows_to_alarm(
      watch, [&](bool c) { return pair.window(c); }, 200, 50);
  EXPECT_GE(windows, 1);
  EXPECT_LE(windows, GetParam().most_windows);
  EXPECT_EQ(testing::name_of_alarm(watch), GetParam().name);
  // Linearised, and against a baseline that is off itself: a tenth.
  EXPECT_NEAR(watch.alarm().change, GetParam().truth,
              0.1 * std::abs(GetParam().truth) + 4 * watch.alarm().sigma);
}

Change with(auto set) {
  Change c;
  set(c);
  return c;
}
constexpr double kHalfDegree = 0.5 * 3.14159265358979 / 180;
INSTANTIATE_TEST_SUITE_P(
    Planted, ImageChanges,
    ::testing::Values(
        Planted{"focal length", with([](Change& c) { c.focal = 0.01; }), 0.01, 3},
        Planted{"gain", with([](Change& c) { c.gain = 0.1; }), 0.102, 3},
        Planted{"offset", with([](Change& c) { c.offset_dn = 8; }), 8, 10},
        Planted{"mount x", with([](Change& c) { c.turn_rad[0] = kHalfDegree; }), kHalfDegree, 3},
        Planted{"mount y", with([](Change& c) { c.turn_rad[1] = kHalfDegree; }), kHalfDegree, 3},
        Planted{"mount z", with([](Change& c) { c.turn_rad[2] = kHalfDegree; }), kHalfDegree, 3},
        Planted{"tile 0,0", with([](Change& c) { c.dirt = 0.05; }), -0.05, 3},
        Planted{"noise", with([](Change& c) { c.noise = 2; }), 3, 3}),
    [](const auto& planted) {
      std::string name = planted.param.name;
      std::replace_if(
          name.begin(), name.end(), [](char c) { return !std::isalnum(static_cast<unsigned char>(c)); }, '_');
      return name;
    });

TEST(ImageChange, SmallDriftsAreFoundByManyWindows) {
  const CameraModel camera = camera_of(96, 72);
  Pair pair(camera, imperfect(), with([](Change& c) { c.focal = 1e-3; }), 8, 6);
  ChangeWatch watch = ChangeWatch::make(pair.changes().parameters(), testing::watch_options(400)).value();
  const int windows = testing::windows_to_alarm(
      watch, [&](bool c) { return pair.window(c); }, 400, 50);
  EXPECT_GT(windows, 3);
  EXPECT_EQ(testing::name_of_alarm(watch), "focal length");
}

TEST(ImageChange, TenThousandWindowsWithoutAChangeRaiseNoAlarm) {
  // 28 h of windows of 10 s: 0.03 alarms are to be expected by the stated rate.
  const CameraModel camera = camera_of(48, 36);
  ImageChangeOptions options;
  options.cells = 800;
  Pair pair(camera, imperfect(), Change{}, 16, 8, options);
  ChangeWatch watch = ChangeWatch::make(pair.changes().parameters(), testing::watch_options()).value();
  testing::expect_no_false_alarm(
      watch, [&](bool c) { return pair.window(c); }, 200);
}

/// Of a lens with another k1: by how much fields of the picture move, rms, after the best focal length.
double left_by_lens_px(const CameraModel& camera, double k1, int fields_across, int fields_down) {
  CameraModel bent = camera;
  bent.lens.k1 += k1;
  struct Field {
    double u = 0, v = 0, du = 0, dv = 0, n = 0;
  };
  std::vector<Field> fields(static_cast<std::size_t>(fields_across * fields_down));
  for (int v = 0; v < camera.height_px; ++v)
    for (int u = 0; u < camera.width_px; ++u) {
      const auto q = project_ray(bent, unproject_ray(camera, {double(u), double(v)}).value()).value();
      const int place =
          v * fields_down / camera.height_px * fields_across + u * fields_across / camera.width_px;
      Field& f = fields[static_cast<std::size_t>(place)];
      f.u += u - camera.cx_px, f.v += v - camera.cy_px, f.du += q.u_px - u, f.dv += q.v_px - v, ++f.n;
    }
  double along = 0, squares = 0, left = 0;
  for (const Field& f : fields) along += f.u * f.du + f.v * f.dv, squares += f.u * f.u + f.v * f.v;
  const double focal = along / squares;
  for (const Field& f : fields)
    left += std::pow((f.du - focal * f.u) / f.n, 2) + std::pow((f.dv - focal * f.v) / f.n, 2);
  return std::sqrt(left / static_cast<double>(fields.size()));
}

TEST(ImageChange, ReprojectsFeaturesOnceFocalLengthAndMountAreTakenOff) {
  const CameraModel camera = camera_of(96, 72);
  const auto apart_px = [&](const Change& change, double& shift_px) {
    Pair pair(camera, Change{}, change, 8, 14);
    double sum = 0, shifts = 0;
    for (int i = 0; i < 40; ++i) {
      const Estimate e = pair.window(true);
      sum += e.features_px * e.features_px / 40, shifts += e.shift_px / 40;
    }
    shift_px = shifts;
    return std::sqrt(sum);
  };
  double shift_px = 0;
  const double nothing = apart_px(Change{}, shift_px);
  EXPECT_LT(nothing, 0.04);
  EXPECT_LT(shift_px, 0.05);
  // A turn moves everything by 0.75 px, and explains all of it.
  EXPECT_LT(apart_px(with([](Change& c) { c.turn_rad[1] = kHalfDegree; }), shift_px), 0.06);
  EXPECT_NEAR(shift_px, kHalfDegree * camera.fx_px, 0.1);
  // Another lens is neither.
  const double expected = left_by_lens_px(camera, 0.1, 6, 4);
  EXPECT_GT(expected, 0.2);
  EXPECT_NEAR(apart_px(with([](Change& c) { c.k1 = 0.1; }), shift_px), expected, 0.3 * expected);
}

TEST(ImageChange, ParallaxOfNearThingsIsNoChange) {
  // A thing near the camera, a fifth of the picture across, is seen 2 px off, in half of the scenes.
  const CameraModel camera = camera_of(96, 72);
  Change off = imperfect();
  off.near_thing = true, off.parallax_px = 2;
  Pair pair(camera, off, with([](Change& c) { c.focal = 0.01; }), 16, 9);
  ChangeWatch watch = ChangeWatch::make(pair.changes().parameters(), testing::watch_options()).value();
  const int windows = testing::windows_to_alarm(
      watch, [&](bool c) { return pair.window(c); }, 200, 300);
  EXPECT_GE(windows, 1);
  EXPECT_EQ(testing::name_of_alarm(watch), "focal length");
}

TEST(ImageChange, EdgesCountLessTheMoreTheyMayBeOff) {
  const CameraModel camera = camera_of(96, 72);
  Change off = imperfect();
  off.near_thing = true, off.parallax_px = 1;
  double scatter[2];
  for (int k = 0; k < 2; ++k) {
    ImageChangeOptions options;
    options.misfit_px = k == 0 ? 0 : 0.3;
    Pair pair(camera, off, Change{}, 16, 9, options);
    double sum = 0, squares = 0;
    for (int i = 0; i < 100; ++i) {
      const double x = pair.window(false).value[2];
      sum += x, squares += x * x;
    }
    scatter[k] = std::sqrt(squares / 100 - sum * sum / 1e4);
  }
  EXPECT_LT(scatter[1], 0.8 * scatter[0]) << scatter[0] << " " << scatter[1];
}

TEST(ImageChange, EdgesAreNoNoise) {
  // With a gain of 50 % more the edges of a near thing differ by many times the noise, in the same place.
  const CameraModel camera = camera_of(96, 72);
  Change sharp, change;
  sharp.near_thing = change.near_thing = true, change.gain = 0.5;
  Pair pair(camera, sharp, change, 8, 10);
  double noise = 0;
  for (int i = 0; i < 50; ++i) noise += pair.window(true).value[12] / 50;
  // The real side's light is 50 % more, and so is the variance of its shot noise.
  EXPECT_NEAR(noise, 0.5, 0.15);
}

TEST(ImageChange, SigmasAreThoseOfRepeatedWindowsOfOneScene) {
  Pair pair(camera_of(96, 72), Change{}, Change{}, 1, 12);
  const std::size_t n = pair.changes().parameters().size();
  std::vector<double> sum(n), squares(n), stated(n);
  constexpr int kWindows = 300;
  for (int i = 0; i < kWindows; ++i) {
    const Estimate e = pair.window(false);
    for (std::size_t k = 0; k < n; ++k)
      if (std::isfinite(e.value[k]))
        sum[k] += e.value[k], squares[k] += e.value[k] * e.value[k], stated[k] += e.sigma[k] * e.sigma[k];
  }
  for (std::size_t k = 0; k < n; ++k) {
    if (stated[k] == 0) continue;
    const double variance = (squares[k] - sum[k] * sum[k] / kWindows) / (kWindows - 1);
    // The variance of 300 is good to 8 %; Huber's weights cost some per cent of it.
    EXPECT_NEAR(std::sqrt(variance / (stated[k] / kWindows)), 1, 0.25) << pair.changes().parameters()[k].name;
  }
}

TEST(ImageChange, WhiteWallsTellOfGainOrOffsetAtMost) {
  Pair pair(camera_of(96, 72), Change{}, Change{}, 1, 12);
  Estimate e = pair.window(false);
  std::vector<std::uint16_t> wall(96 * 72, 1500);
  testing::fill<std::uint16_t>(pair.real(), wall);
  testing::fill<std::uint16_t>(pair.simulated(), wall);
  ASSERT_TRUE(pair.changes().add(pair.real(), pair.simulated()));
  pair.changes().finish(e);
  for (const std::size_t k : {0, 1, 2, 3, 4, 5}) EXPECT_TRUE(std::isnan(e.value[k])) << k;
  // Saturated, black and no pictures at all say nothing of anything.
  for (const std::uint16_t v : {std::uint16_t{0}, std::uint16_t{4095}}) {
    std::fill(wall.begin(), wall.end(), v);
    testing::fill<std::uint16_t>(pair.real(), wall);
    ASSERT_TRUE(pair.changes().add(pair.real(), pair.simulated()));
    pair.changes().finish(e);
    for (std::size_t k = 0; k < pair.changes().parameters().size(); ++k)
      EXPECT_TRUE(std::isnan(e.value[k])) << k;
  }
  pair.changes().finish(e);
  EXPECT_TRUE(std::isnan(e.value[0]));
}

TEST(ImageChange, RefusesWhatItCannotCompare) {
  Pair pair(camera_of(96, 72), Change{}, Change{}, 1, 12);
  (void)pair.window(false);
  Sample& real = pair.real();
  const auto info = *real.as<ImageInfo>();
  auto other = info;
  other.width_px = 95;
  real.info = other;
  EXPECT_FALSE(pair.changes().add(real, pair.simulated()));
  other = info, other.offset_x_px = 2, real.info = other;
  EXPECT_FALSE(pair.changes().add(real, pair.simulated()));
  real.info = RangeImageInfo{96, 72};
  EXPECT_FALSE(pair.changes().add(real, pair.simulated()));
  real.info = info, real.size_bytes -= 2;
  EXPECT_FALSE(pair.changes().add(real, pair.simulated()));
  real.size_bytes += 2, real.stamp.validity = kIncomplete;
  EXPECT_FALSE(pair.changes().add(real, pair.simulated()));
  real.stamp.validity = 0;
  EXPECT_TRUE(pair.changes().add(real, pair.simulated()));

  const CameraModel camera = camera_of(96, 72);
  ImageInfo small = info;
  small.width_px = 6;
  EXPECT_FALSE(ImageChange::make(camera, small));
  small = info, small.offset_y_px = 1;
  EXPECT_FALSE(ImageChange::make(camera, small));
  small = info, small.format = PixelFormat::coord3d_c16;
  EXPECT_FALSE(ImageChange::make(camera, small));
  ImageChangeOptions options;
  options.tiles_across = 9, options.tiles_down = 3;
  EXPECT_FALSE(ImageChange::make(camera, info, options));
}

TEST(ImageChange, EveryFormatTellsTheGain) {
  const CameraModel camera = camera_of(64, 48);
  const std::vector<float> mean = picture(Scene(3), camera, Change{});
  for (const PixelFormat format :
       {PixelFormat::mono8, PixelFormat::mono10, PixelFormat::mono12, PixelFormat::mono12p,
        PixelFormat::mono16, PixelFormat::bayer_rg8, PixelFormat::bayer_rg12, PixelFormat::rgb8,
        PixelFormat::yuv422_8, PixelFormat::yuv420_sp}) {
    ImageInfo info;
    info.format = format, info.width_px = 64, info.height_px = 48;
    ImageChange change = ImageChange::make(camera, info).value();
    Sample samples[2];
    for (int side = 0; side < 2; ++side) {
      Sample& s = samples[side];
      s.info = info, s.size_bytes = image_bytes(format, 64, 48);
      s.reserve(s.size_bytes);
      auto* at = reinterpret_cast<unsigned char*>(s.memory().data());
      std::fill(at, at + s.size_bytes, static_cast<unsigned char>(128));
      const double scale = std::ldexp(1.0, significant_bits(format) - 12), black = 100 * scale;
      for (std::size_t i = 0; i < mean.size(); ++i) {
        const double dn = black + (double{mean[i]} - 100) * scale * (side == 0 ? 1.05 : 1);
        const auto v = static_cast<unsigned>(dn + 0.5);
        if (format == PixelFormat::mono12p) {
          unsigned char* p = at + i / 2 * 3;
          if (i % 2 == 0)
            p[0] = static_cast<unsigned char>(v), p[1] = static_cast<unsigned char>(v >> 8);
          else
            p[1] = static_cast<unsigned char>(p[1] | v << 4), p[2] = static_cast<unsigned char>(v >> 4);
        } else if (has_words(format)) {
          at[2 * i] = static_cast<unsigned char>(v), at[2 * i + 1] = static_cast<unsigned char>(v >> 8);
        } else {
          const std::size_t stride = format == PixelFormat::rgb8       ? 3
                                     : format == PixelFormat::yuv422_8 ? 2
                                                                       : 1;
          at[i * stride + (stride == 3 ? 1 : 0)] = static_cast<unsigned char>(v);
        }
      }
    }
    ASSERT_TRUE(change.add(samples[0], samples[1])) << pfnc_name(format);
    Estimate e;
    change.finish(e);
    EXPECT_NEAR(e.value[0], 0.05, 0.001 + 4 * e.sigma[0]) << pfnc_name(format);
    EXPECT_NEAR(e.value[2], 0, 0.002) << pfnc_name(format);
  }
}

}  // namespace
}  // namespace rigor::pair_watch
