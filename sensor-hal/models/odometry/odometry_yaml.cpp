#include "sensor-hal/models/odometry/odometry_yaml.h"

#include <numbers>

namespace rigor {

Result<models::OdometryModel> parse_odometry_model(ConfigNode root) {
  return catch_config([&] {
    constexpr double kDegree = std::numbers::pi / 180;
    constexpr Range kNotNegative{.min = 0}, kMetres{.min = 0, .max = 100, .exclusive_min = true};
    constexpr Range kPercent{.min = -50, .max = 50};
    models::OdometryModel m;
    m.name = root.text_or("name", "odometry");
    m.wheel_radius_m = root.number("wheel_radius_m", kMetres);
    m.track_m = root.number("track_m", kMetres);
    m.ticks_per_turn = root.number_or("ticks_per_turn", 0, {.min = 0, .max = 1e9});
    const auto radius = root.numbers_or("radius_error_percent", {0, 0});
    m.radius_error = {radius[0] * 0.01, radius[1] * 0.01};
    for (const double percent : radius)
      if (!(percent >= -50 && percent <= 50))
        throw root.error("radius_error_percent", "expected two numbers from -50 to 50");
    m.radius_error_sigma = root.number_or("radius_error_sigma_percent", 0, {.min = 0, .max = 10}) * 0.01;
    m.track_error = root.number_or("track_error_percent", 0, kPercent) * 0.01;
    m.track_error_sigma = root.number_or("track_error_sigma_percent", 0, {.min = 0, .max = 10}) * 0.01;
    ConfigNode c = root.map_or_absent("claimed");
    m.position_per_m = c.number_or("position_percent_of_way", 0, kNotNegative) * 0.01;
    m.yaw_rad_per_m = c.number_or("yaw_deg_per_m", 0, kNotNegative) * kDegree;
    m.yaw_per_rad = c.number_or("yaw_percent_of_turn", 0, kNotNegative) * 0.01;
    m.speed_mps = c.number_or("speed_mps", 0, kNotNegative);
    m.turn_rate_radps = c.number_or("turn_deg_per_s", 0, kNotNegative) * kDegree;
    c.finish();
    root.finish();
    return m;
  });
}

Result<models::OdometryModel> load_odometry_model(const std::filesystem::path& file) {
  auto document = ConfigDocument::load(file);
  if (!document) return tl::unexpected<Error>(document.error());
  return parse_odometry_model(*document);
}

}  // namespace rigor
