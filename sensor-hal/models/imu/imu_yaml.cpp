#include "sensor-hal/models/imu/imu_yaml.h"

#include <cmath>
#include <numbers>

#include "sensor-hal/models/calibration_section.h"

namespace rigor {
namespace {

using namespace models;

constexpr double kG = 9.80665, kDegree = std::numbers::pi / 180, kHour = 3600;
constexpr Range kNotNegative{.min = 0};

/// Names and units of one kind of triad.
struct Units {
  double rate;              ///< of bias, range, resolution
  const char* rate_suffix;  ///< "_mg"
  const char* full_suffix;  ///< of the range
  double full;
  const char* density;        ///< key
  double density_unit;        ///< one-sided, [x/√Hz]
  const char* integral_walk;  ///< key of N
  double integral_walk_unit;
  const char* instability;
  double instability_unit;
  const char* random_walk;
  double random_walk_unit;
};
constexpr Units kAccelerometer{kG * 1e-3,
                               "_mg",
                               "_g",
                               kG,
                               "noise_density_ug_per_sqrt_hz",
                               kG * 1e-6,
                               "velocity_random_walk_m_per_s_per_sqrt_h",
                               1.0 / 60,
                               "instability_mg",
                               kG * 1e-3,
                               "random_walk_mg_per_sqrt_h",
                               kG * 1e-3 / 60};
constexpr Units kGyroscope{kDegree,
                           "_deg_per_s",
                           "_deg_per_s",
                           kDegree,
                           "noise_density_deg_per_s_per_sqrt_hz",
                           kDegree,
                           "angle_random_walk_deg_per_sqrt_h",
                           kDegree / 60,
                           "instability_deg_per_h",
                           kDegree / kHour,
                           "random_walk_deg_per_h_per_sqrt_h",
                           kDegree / kHour / 60};

template <std::size_t N>
void read_values(const ConfigNode& n, const std::string& key, double unit, std::array<double, N>& values) {
  if (!n.has(key)) return;
  const auto read = n.numbers(key, N);
  for (std::size_t i = 0; i < N; ++i) values[i] = read[i] * unit;
}

ImuTriad read_triad(ConfigNode n, const Units& u, bool gyroscope) {
  ImuTriad t;
  const auto key = [&](const char* name) { return std::string(name) + u.rate_suffix; };
  const auto sigma = [&](const std::string& name, double unit) {
    return n.number_or(name, 0, kNotNegative) * unit;
  };
  read_values(n, key("bias"), u.rate, t.bias);
  t.bias_sigma = sigma(key("bias_sigma"), u.rate);
  read_values(n, key("bias_per_k"), u.rate, t.bias_per_k);
  t.bias_per_k_sigma = sigma(key("bias_per_k_sigma"), u.rate);
  read_values(n, "scale_percent", 0.01, t.scale);
  t.scale_sigma = sigma("scale_sigma_percent", 0.01);
  read_values(n, "misalignment_percent", 0.01, t.misalignment);
  t.misalignment_sigma = sigma("misalignment_sigma_percent", 0.01);
  if (gyroscope) {
    read_values(n, "g_sensitivity_deg_per_s_per_g", kDegree / kG, t.g_sensitivity);
    t.g_sensitivity_sigma = sigma("g_sensitivity_sigma_deg_per_s_per_g", kDegree / kG);
  }
  if (n.has(u.density) && n.has(u.integral_walk))
    throw n.error(u.integral_walk, std::string("expected it or ") + u.density +
                                       ", which say the same (allan_terms.h), got both");
  const bool density = n.has(u.density);
  const char* const white = density ? u.density : u.integral_walk;
  if (n.has(white)) {
    const double unit = density ? u.density_unit / std::numbers::sqrt2 : u.integral_walk_unit;
    // One number stands for three axes.
    const auto read = n.numbers_or(white, {});
    if (read.size() != 1 && read.size() != 3)
      throw n.error(white, "expected one number in brackets or three, got " + std::to_string(read.size()));
    for (std::size_t i = 0; i < 3; ++i) {
      t.white[i] = read[read.size() == 3 ? i : 0] * unit;
      if (t.white[i] < 0) throw n.error(white, "expected numbers that are not negative");
    }
  }
  t.instability = sigma(u.instability, u.instability_unit);
  t.instability_time_s =
      n.number_or("instability_time_s", t.instability_time_s, {.min = 0, .max = 1e6, .exclusive_min = true});
  t.random_walk = sigma(u.random_walk, u.random_walk_unit);
  t.bandwidth_hz = sigma("bandwidth_hz", 1);
  t.range = sigma(std::string("range") + u.full_suffix, u.full);
  t.resolution = sigma(key("resolution"), u.rate);
  n.finish();
  return t;
}

}  // namespace

Result<ImuModel> parse_imu_model(ConfigNode root) {
  return catch_config([&] {
    ImuModel m;
    m.name = root.text_or("name", "imu");
    m.accelerometer = read_triad(root.map("accelerometer"), kAccelerometer, false);
    m.gyroscope = read_triad(root.map("gyroscope"), kGyroscope, true);
    if (ConfigNode t = root.map_or_absent("temperature"); t.present()) {
      m.tells_temperature = t.flag_or("told", m.tells_temperature);
      m.ambient_c = t.number_or("ambient_c", m.ambient_c, {.min = -100, .max = 200});
      m.warm_up_k = t.number_or("warm_up_k", m.warm_up_k, {.min = -100, .max = 200});
      m.warm_up_time_s =
          t.number_or("warm_up_time_s", m.warm_up_time_s, {.min = 0, .max = 1e6, .exclusive_min = true});
      m.temperature_resolution_k = t.number_or("resolution_k", 0, kNotNegative);
      t.finish();
    }
    m.delay_s = root.number_or("delay_ms", 0, {.min = 0, .max = 1000}) * 1e-3;
    m.earth_rate = root.flag_or("earth_rate", m.earth_rate);
    (void)read_calibration(root);
    root.finish();
    return m;
  });
}

Result<ImuModel> load_imu_model(const std::filesystem::path& file) {
  auto document = ConfigDocument::load(file);
  if (!document) return tl::unexpected<Error>(document.error());
  return parse_imu_model(*document);
}

}  // namespace rigor
