// Scattered light: all of it stays in the picture, even light stays even, and a point's spread is the kernel.
#include "sim/sensors/camera/sensor_stage_bloom.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <numeric>

#include "sensor-hal/models/one_source.h"
#include "tests/sim/sensors/camera/sensor_stage_fixture.h"

namespace rigor {
namespace {

using sensor_stage::BloomOperator;
using Model = models::PictureMath<double>;

double sum(const std::vector<float>& v) { return std::accumulate(v.begin(), v.end(), 0.0); }

struct Case {
  int width, height;
  Bloom bloom;
};
std::vector<Case> cases() {
  std::vector<Case> out;
  for (const auto& [w, h] : {std::pair{96, 72}, {101, 53}, {1, 1}, {5, 3}, {640, 2}})
    for (const double radius : {0.3, 1.0, 4.0, 15.0})
      for (const double exponent : {0.75, 1.5, 3.0})
        out.push_back(
            {w, h, {.fraction = 0.3, .radius_px = radius, .exponent = exponent, .veiling_glare = 0.05}});
  return out;
}

TEST(Bloom, KeepsAllLightOfEveryPoint) {
  for (const Case& c : cases()) {
    BloomOperator bloom(c.width, c.height, c.bloom);
    // Middle, border, corner, and a picture full of lights from 1 to 1e6.
    for (const auto& [x, y] : {std::pair{c.width / 2, c.height / 2}, {0, c.height / 2}, {c.width - 1, 0}}) {
      std::vector<float> plane(static_cast<std::size_t>(c.width) * c.height);
      plane[static_cast<std::size_t>(y) * c.width + x] = 1e5f;
      bloom.apply(plane);
      EXPECT_NEAR(sum(plane) / 1e5, 1, 1e-6)
          << c.width << " r " << c.bloom.radius_px << " p " << c.bloom.exponent << " at " << x << ", " << y;
      EXPECT_GE(*std::min_element(plane.begin(), plane.end()), 0.0f);
    }
    std::vector<float> plane(static_cast<std::size_t>(c.width) * c.height);
    for (std::size_t i = 0; i < plane.size(); ++i)
      plane[i] = std::exp2(static_cast<float>((i * 2654435761u >> 7) % 20));
    const double before = sum(plane);
    bloom.apply(plane);
    EXPECT_NEAR(sum(plane) / before, 1, 1e-6) << c.width << " r " << c.bloom.radius_px;
  }
}

TEST(Bloom, EvenLightStaysEven) {
  for (const Case& c : cases()) {
    BloomOperator bloom(c.width, c.height, c.bloom);
    std::vector<float> plane(static_cast<std::size_t>(c.width) * c.height, 1000.0f);
    bloom.apply(plane);
    for (const float v : plane) ASSERT_NEAR(v, 1000, 2e-3) << c.width << " r " << c.bloom.radius_px;
  }
}

/// The same by its definition, in double: the kernel between every two pixels, made doubly stochastic.
class DirectBloom {
 public:
  DirectBloom(int width, int height, const Bloom& b) : width_(width), height_(height), bloom_(b) {
    const std::size_t n = static_cast<std::size_t>(width) * height;
    balance_.assign(n, 1);
    for (int round = 0; round < 30; ++round) {
      const auto spread = convolve(balance_);
      for (std::size_t i = 0; i < n; ++i) balance_[i] /= std::sqrt(balance_[i] * spread[i]);
    }
  }
  [[nodiscard]] std::vector<double> point(int x, int y) const {
    std::vector<double> out(balance_.size());
    for (int v = 0; v < height_; ++v)
      for (int u = 0; u < width_; ++u)
        out[at(u, v)] = balance_[at(u, v)] * balance_[at(x, y)] * kernel(u - x, v - y);
    return out;
  }

 private:
  [[nodiscard]] std::size_t at(int x, int y) const { return static_cast<std::size_t>(y) * width_ + x; }
  [[nodiscard]] double kernel(int dx, int dy) const {
    return Model::bloom_kernel(dx * dx + dy * dy, bloom_.radius_px, bloom_.exponent);
  }
  [[nodiscard]] std::vector<double> convolve(const std::vector<double>& in) const {
    std::vector<double> table(static_cast<std::size_t>(width_) * height_), out(in.size());
    for (int y = 0; y < height_; ++y)
      for (int x = 0; x < width_; ++x) table[at(x, y)] = kernel(x, y);
    for (int y = 0; y < height_; ++y)
      for (int x = 0; x < width_; ++x) {
        double s = 0;
        for (int v = 0; v < height_; ++v)
          for (int u = 0; u < width_; ++u) s += table[at(std::abs(u - x), std::abs(v - y))] * in[at(u, v)];
        out[at(x, y)] = s;
      }
    return out;
  }
  int width_, height_;
  Bloom bloom_;
  std::vector<double> balance_;
};

// The sum of Gaussians on pictures of falling size against the kernel itself, relative to the kernel's value
// at each pixel, from 1 to 1e-4 of its peak.
TEST(Bloom, APointSpreadsAsTheKernelSays) {
  for (const auto& [radius, exponent] :
       {std::pair{0.5, 1.5}, {2.0, 1.0}, {4.0, 1.5}, {4.0, 2.5}, {12.0, 1.5}}) {
    const Bloom b{.fraction = 1, .radius_px = radius, .exponent = exponent};
    constexpr int kWidth = 56, kHeight = 40;
    const DirectBloom direct(kWidth, kHeight, b);
    BloomOperator bloom(kWidth, kHeight, b);
    double worst = 0, squares = 0, count = 0, moved = 0;
    for (const auto& [x, y] : {std::pair{27, 19}, {28, 20}, {3, 36}, {0, 0}}) {
      const auto expected = direct.point(x, y);
      std::vector<float> plane(kWidth * kHeight);
      plane[static_cast<std::size_t>(y) * kWidth + x] = 1;
      bloom.apply(plane);
      for (std::size_t i = 0; i < plane.size(); ++i) {
        const double relative = plane[i] / expected[i] - 1;
        worst = std::max(worst, std::abs(relative));
        squares += relative * relative;
        ++count;
        moved += 0.5 * std::abs(plane[i] - expected[i]) / 4;
      }
    }
    if (std::getenv("RIGOR_VERBOSE") != nullptr)
      std::printf("bloom r %.1f p %.1f: worst %.4f, rms %.4f, light at the wrong place %.5f\n", radius,
                  exponent, worst, std::sqrt(squares / count), moved);
    EXPECT_LT(worst, 0.06) << radius << " " << exponent;
    EXPECT_LT(std::sqrt(squares / count), 0.012) << radius << " " << exponent;
    EXPECT_LT(moved, 0.003) << radius << " " << exponent;
  }
}

TEST(Bloom, VeilingGlareIsTheMeanEverywhere) {
  BloomOperator bloom(10, 8, {.fraction = 0, .veiling_glare = 0.1});
  std::vector<float> plane(80);
  plane[17] = 800;
  bloom.apply(plane);
  EXPECT_NEAR(plane[0], 1.0, 1e-6);
  EXPECT_NEAR(plane[17], 0.9 * 800 + 1.0, 1e-3);
}

// Before the well: a light a hundred times too bright gives its neighbours what the kernel says of all of it.
TEST(Bloom, ComesBeforeSaturation) {
  CameraModel m = test::quiet_camera(63, 47);
  m.noise.full_well_e = 16000;
  m.bloom = {.fraction = 0.05, .radius_px = 3, .exponent = 1.5};
  OpticsPicture p = test::even_picture(m, 0);
  p.radiance[4 * (23 * 63 + 31)] = test::radiance_for(m, 1.6e6, 0.01);
  const auto dn = test::numbers(*test::make_stage(m), p);
  EXPECT_EQ(dn[23 * 63 + 31], 4000) << "full";
  const DirectBloom direct(63, 47, m.bloom);
  const auto spread = direct.point(31, 23);
  for (const int dx : {1, 2, 5, 10, 20})
    EXPECT_NEAR(dn[static_cast<std::size_t>(23 * 63 + 31 + dx)],
                std::min(4000.0, 0.25 * 1.6e6 * 0.05 * spread[static_cast<std::size_t>(23 * 63 + 31 + dx)]),
                1 + 0.02 * dn[static_cast<std::size_t>(23 * 63 + 31 + dx)])
        << dx;
}

}  // namespace
}  // namespace rigor
