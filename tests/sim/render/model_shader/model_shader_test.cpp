// The error models are one source for shader and CPU: here the shader runs, each function over thousands of
// draws of its arguments, beside the same calls in float and in double.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <memory>
#include <string>

#include "sensor-hal/models/air/air_math.h"
#include "sensor-hal/models/lidar/lidar_math.h"
#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/philox.h"
#include "sensor-hal/models/tof/tof_math.h"
#include "tests/sim/render/model_shader/compute_kernel.h"

namespace rigor {
namespace {

constexpr std::uint32_t kSpirv[] =
#include "model_calls.comp.inc"
    ;

using std::cos;
using std::exp;
using std::exp2;
using std::floor;
using std::log;
using std::sin;
using std::sqrt;

#define FN static inline
#define OUT(type) type&
#define UINT std::uint32_t
template <class REAL>
struct Models {
#include "sensor-hal/models/angles.glsl.h"
#include "sensor-hal/models/opencv_lens.glsl.h"
//
#include "sensor-hal/models/depth_of_field.glsl.h"
#include "sensor-hal/models/fisheye_lens.glsl.h"
#include "sensor-hal/models/vignetting.glsl.h"
//
#include "sensor-hal/models/random_draws.glsl.h"
//
#include "sensor-hal/models/bloom.glsl.h"
#include "sensor-hal/models/dark_current.glsl.h"
#include "sensor-hal/models/emva_noise.glsl.h"
#include "sensor-hal/models/image_processing.glsl.h"
//
#include "sensor-hal/models/air/air.glsl.h"
#include "sensor-hal/models/lidar/lidar.glsl.h"
#include "sensor-hal/models/tof/tof.glsl.h"
//
#include "tests/sim/render/model_shader/model_calls.glsl.h"
};
#undef FN
#undef OUT
#undef UINT

struct Span {
  double from, to;
  bool decades = false;  ///< evenly over the logarithm
};

/// A call, over what its arguments are drawn, and how far the shader may be from the CPU.
struct Call {
  int which;
  const char* name;
  std::vector<Span> arguments;
  /// Relative to the result's magnitude or to `magnitude`, whichever is larger: Vulkan allows exp and log
  /// 3 + 2|x| units in the last place.
  double tolerance = 2e-6;
  double magnitude = 1;
  /// Share of draws that may lie on the other side of a step: a rounding, a fold, a search's end.
  double steps = 0;
};

const Span kSmall{-0.05, 0.05}, kUnit{0, 1};

const std::vector<Call>& calls() {
  static const std::vector<Call> table = {
      {0, "lens_distort", {{-1, 1}, {-1, 1}, kSmall, kSmall, kSmall, kSmall, kSmall, kSmall, kSmall, kSmall}},
      {1,
       "lens_undistort",
       {{-0.5, 0.5}, {-0.5, 0.5}, kSmall, kSmall, kSmall, kSmall, kSmall, kSmall, kSmall, kSmall},
       5e-6},
      {2,
       "fisheye_project",
       {{-1, 1}, {-1, 1}, {-0.5, 1}, kSmall, kSmall, {-0.01, 0.01}, {-0.005, 0.005}},
       5e-6},
      {3, "fisheye_unproject", {{-1, 1}, {-1, 1}, kSmall, kSmall, {-0.01, 0.01}, {-0.005, 0.005}}, 2e-5},
      {4,
       "vignetting_factor, blur_diameter_px",
       {{-1, 1},
        {-1, 1},
        kUnit,
        {-0.3, 0},
        kSmall,
        kSmall,
        {0.3, 100, true},
        {0.3, 10},
        {0.004, 0.1},
        {1.4, 16},
        {2e-6, 1e-5}},
       4e-6},
      {5,
       "normal_quantile, dark_current_at",
       {{1e-7, 1 - 1e-7}, {0.1, 100}, {-20, 70}, {20, 25}, {6, 9}},
       2e-5},
      {6, "poisson_quantile", {{0.01, 1e5, true}, {1e-6, 1 - 1e-6}}, 1e-6, 1, 0.01},
      {7,
       "emva_mean_electrons, emva_collected_electrons",
       {{0, 1e7},
        {0, 100},
        {0.9, 1.1},
        {1e-4, 0.1},
        {0, 20000},
        {8000, 12000},
        {-5, 5},
        {0, 20},
        {-4, 4},
        {0.01, 10},
        {0, 100}}},
      {8,
       "emva_quantise, emva_response",
       {{-10, 5000}, {255, 4095}, {-50, 6000}, {255, 4095}, {-0.3, 0.3}, {-0.2, 0.2}},
       1e-6,
       1,
       0.001},
      {9,
       "bloom",
       {{0, 1e4}, {0.5, 8}, {1, 3}, {0, 1e5}, {0, 1e5}, {0, 1e5}, {0, 0.1}, {0, 0.1}, {0.01, 30}, {0.1, 1}},
       2e-5},
      {10,
       "processed_dn",
       {{0, 4095}, {0, 64}, {0.5, 2}, {1023, 4095}, {0.4, 1}, {0, 16}},
       2e-5,
       4095,
       0.001},
      {11,
       "lidar_surface_remission, lidar_beam_diameter_m, lidar_received_power",
       {{0.001, 1},
        {0.02, 1},
        kUnit,
        {0.1, 1},
        {0, 0.3},
        {1, 500},
        {0.001, 0.02},
        {0.0005, 0.015},
        {0.05, 300, true},
        {10, 10},
        {0.1, 5}},
       5e-6},
      {12,
       "lidar_least_remission, lidar_range_sigma_m",
       {{0.05, 300, true},
        {0, 0.1},
        {0.05, 0.2},
        {0, 100},
        {0.1, 5},
        {1e-4, 300, true},
        {0, 0.02},
        {0, 0.5},
        {1e-4, 5},
        {0.3, 1.5}},
       2e-5},
      {13,
       "lidar_remission_units, lidar_gaussian_share, lidar_drop_remission",
       {{0, 50},
        {0.05, 300, true},
        {50, 255},
        {0, 5},
        {0, 10},
        {0, 2},
        kUnit,
        {1e-4, 0.01, true},
        {0.001, 0.1},
        {0.02, 1}},
       2e-5},
      {14, "lidar_quantise", {{0, 100}, {0.001, 0.004}}, 1e-6, 1, 0.01},
      {15,
       "lidar_expected_drops, lidar_soft_remission",
       {{0, 10}, {10, 200}, {0.001, 0.02}, {0, 0.01}, {1, 1e4, true}, {1e-4, 0.1, true}, {10, 60}, {0.3, 3}},
       5e-6},
      {16,
       "lidar_nearest_drop_m",
       {{1e-3, 10, true}, {0, 5}, {0.001, 0.02}, {1e-4, 0.01}, {1, 1e4, true}},
       5e-4},
      {17,
       "lidar_refract",
       {{0.9, 1}, {-0.2, 0.2}, {-0.2, 0.2}, {0.95, 1}, {-0.1, 0.1}, {-0.1, 0.1}, {0.6, 1}}},
      {18,
       "lidar_risley_direction",
       {{0.98, 1}, {-0.1, 0.1}, {-0.1, 0.1}, {0.1, 0.4}, {0, 6.28}, {0.1, 0.4}, {0, 6.28}, {1.4, 1.6}},
       2e-4},
      {19, "air extinction", {{50, 50000, true}, {532, 1550}, {0.1, 100, true}}, 2e-5, 1e-6},
      {20,
       "air drops, air_two_way_transmission",
       {{0.1, 100, true}, {1e-5, 0.1, true}, {1e-4, 1e-2, true}, {0, 10}},
       2e-5,
       1e-6},
      {21, "air_way_below_m", {{-50, 50}, {-1, 1}, {0.1, 300}, {-20, 20}}, 1e-5},
      {22, "tof_sincos_turns", {{-100, 100}}},
      {23, "tof_angle_turns", {{-1, 1}, {-1, 1}}, 1e-6, 1, 0.001},
      {24,
       "tof_phasor with harmonics",
       {{-2, 20}, {-0.15, 0.15}, {-0.05, 0.05}, {-0.02, 0.02}, {-0.02, 0.02}, kUnit, kUnit},
       5e-6,
       1,
       0},
      {25,
       "tof_phasor of square waves, tof_active_electrons, tof_range_sigma",
       {{-2, 20},
        {1e3, 1e6, true},
        {0.1, 10},
        {0.1, 10},
        {0.02, 1},
        {0.05, 0.7},
        {10, 1e5, true},
        {0, 1e5},
        {0, 50},
        {0.3, 0.9}},
       5e-6},
      {26, "tof_taps", {{0, 1e5}, {-1e5, 1e5}, {-1e5, 1e5}, {0.3, 0.9}, {0, 1e5}}, 2e-6, 1e5},
      {27, "tof_read_tap", {{0, 1.5e5}, {0, 1e4}, {8e4, 1e5}, {0, 50}, {-4, 4}, {1, 50}}, 1e-6, 1, 0.01},
      // The shader's log is within 2^-21 of the truth near 1, whatever is left of it there.
      {28, "hot_pixel_rate", {{0, 0.5}, {1, 1000}, kUnit, {1e-6, 1}}, 1e-6, 1000},
      {29,
       "tof_demodulate, tof_nearest_range",
       {{0, 1e5}, {0, 1e5}, {0, 1e5}, {0, 1e5}, kUnit, {0.05, 0.7}, {0.1, 30}},
       5e-6,
       1,
       0.002},
      // Where a piece ends, rounding decides which one it is.
      {30,
       "tof_spline, tof_range_error",
       {{0, 6}, {0.3, 1}, {2, 5}, {7, 7}, {-0.1, 0.1}, {-100, 100}, {100, 1e5, true}},
       5e-6,
       1,
       0.001},
      {31,
       "lidar_range_error_m",
       {{0.1, 300, true}, {0.99, 1.01}, {-0.1, 0.1}, {-0.05, 0.05}, {0, 2}, {-0.05, 0.05}, kUnit}},
  };
  return table;
}

double drawn(const Span& span, double u) {
  if (span.decades) return span.from * std::pow(span.to / span.from, u);
  return span.from + (span.to - span.from) * u;
}

template <class REAL>
std::array<double, 4> on_the_cpu(int which, const float* a) {
  REAL p, q, r, s;
  Models<REAL>::model_call(which, REAL(a[0]), REAL(a[1]), REAL(a[2]), REAL(a[3]), REAL(a[4]), REAL(a[5]),
                           REAL(a[6]), REAL(a[7]), REAL(a[8]), REAL(a[9]), REAL(a[10]), REAL(a[11]), p, q, r,
                           s);
  return {double(p), double(q), double(r), double(s)};
}

/// A device with the validation layer where it is installed; any message of it fails the test that caused it.
class ModelShader : public ::testing::Test {
 protected:
  void SetUp() override {
    auto device = render::Device::create({.validation = true});
    if (!device) device = render::Device::create({});
    // Where the lanes run, Mesa's device is installed: tests/skipped.txt does not allow this skip.
    if (!device) GTEST_SKIP() << "no Vulkan device: " << device.error().text();
    device_ = *device;
  }
  void TearDown() override {
    if (!device_) return;
    for (const std::string& message : device_->validation_messages()) ADD_FAILURE() << message;
  }
  std::shared_ptr<render::Device> device_;
};

TEST_F(ModelShader, EachModelOnTheDeviceIsTheModelOnTheCpu) {
  auto kernel = test::ComputeKernel::make(*device_, kSpirv);
  ASSERT_TRUE(kernel) << kernel.error().text();
  ASSERT_EQ(calls().size(), std::size_t{MODEL_CALLS});
  constexpr std::size_t kDraws = 8192;
  for (const Call& call : calls()) {
    ASSERT_LE(call.arguments.size(), 12u);
    std::vector<float> arguments(kDraws * 12);
    for (std::uint32_t n = 0; n < kDraws; ++n)
      for (std::uint32_t k = 0; k < call.arguments.size(); ++k) {
        const auto bits =
            models::philox({n, k, static_cast<std::uint32_t>(call.which), 0}, models::PhiloxKey{7, 1});
        arguments[n * 12 + k] = static_cast<float>(drawn(call.arguments[k], (bits[0] + 0.5) * 0x1p-32));
      }
    const auto results = (*kernel)->run(call.which, arguments);
    ASSERT_TRUE(results) << results.error().text();
    std::size_t other_side = 0;
    double worst = 0, worst_float = 0;
    std::string where;
    bool any = false;
    for (std::size_t n = 0; n < kDraws; ++n) {
      const float* a = &arguments[n * 12];
      const auto cpu = on_the_cpu<float>(call.which, a);
      const auto exact = on_the_cpu<double>(call.which, a);
      for (std::size_t r = 0; r < 4; ++r) {
        const double device = (*results)[n * 4 + r];
        any |= device != 0;
        if (std::isnan(cpu[r]) && std::isnan(device)) continue;
        const double size = std::max(call.magnitude, std::abs(cpu[r]));
        const double off = std::abs(device - cpu[r]) / size;
        // Where float itself is far from double the two may differ by as much.
        const double own = std::abs(cpu[r] - exact[r]) / size;
        if (!(off <= std::max(call.tolerance, 4 * own))) {
          ++other_side;
          if (off > worst || where.empty()) {
            where = "draw " + std::to_string(n) + " result " + std::to_string(r) + ": device " +
                    std::to_string(device) + ", CPU " + std::to_string(cpu[r]) + ", double " +
                    std::to_string(exact[r]);
            worst = off;
          }
        }
        worst_float = std::max(worst_float, off);
      }
    }
    EXPECT_TRUE(any) << call.name << " gave nothing but zeros";
    EXPECT_LE(static_cast<double>(other_side), call.steps * kDraws)
        << call.name << ": " << other_side << " of " << kDraws << " draws differ, worst " << worst << " at "
        << where;
    RecordProperty("largest_" + std::to_string(call.which), std::to_string(worst_float));
  }
}

}  // namespace
}  // namespace rigor
