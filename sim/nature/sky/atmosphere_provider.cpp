// Place, Atmosphere and StudioLight as light and air for the engines.
#include <algorithm>
#include <cmath>
#include <deque>
#include <numbers>
#include <optional>

#include "sim/nature/providers.h"
#include "sim/nature/sky/air.h"
#include "sim/nature/sky/sky_light.h"
#include "sim/nature/sky/solar_position.h"
#include "sim/nature/sky/weather.h"

namespace rigor::nature {
namespace {

using world::NodeId;
using world::Snapshot;

/// How far the world may go on before the sky is drawn anew. The state is put on this grid, so that a sky
/// hangs on the world and the time alone and not on what was asked before. A sun that goes its way stands
/// still meanwhile, up to 0.04° from its place, a thirteenth of its disc: else light that is kept from one
/// picture to the next would be that of another sun.
constexpr double kStepTime_s = 20;
constexpr double kStepDrift_m = 10;  // of the clouds: half a texel at the zenith
constexpr double kStepElevation_deg = 0.02, kStepTurbidity = 0.02, kStepCover = 0.005;
constexpr double kStepTemperature_c = 1, kStepFogDepth_m = 10, kStepSnow_m = 0.005;
constexpr double kStepSight = 0.02;  // relative, of a visibility
constexpr std::size_t kSkiesKept = 4;

/// The middle of the step.
double stepped(double utc_s) { return (std::floor(utc_s / kStepTime_s) + 0.5) * kStepTime_s; }
double to_grid(double x, double step) { return std::round(x / step) * step; }
double sight_to_grid(double visibility_m) {
  return std::isfinite(visibility_m) ? std::exp(to_grid(std::log(visibility_m), kStepSight)) : visibility_m;
}

struct AirState {
  double utc_s = 0, utc_rate = 0, turbidity = 3, cloud_cover = 0, visibility_m = 0, fog_visibility_m = 0,
         fog_top_m = 0, rain_mm_per_h = 0, snow_mm_per_h = 0, snow_depth_m = 0, wetness = 0,
         wind_speed_m_per_s = 0, wind_from_deg = 0, temperature_c = 15;
  bool fixed_sun = false;
  double sun_azimuth_deg = 180, sun_elevation_deg = 45;
};

AirState read_air(const Snapshot& world, NodeId node, std::vector<std::string>& warnings) {
  const world::types::Atmosphere a(world.schema());
  const auto any = [&](world::Attribute<double> x) { return world.get_or_default(node, x); };
  const auto get = [&](world::Attribute<double> x) {
    const double v = any(x);
    if (std::isfinite(v)) return v;
    const auto& spec = world.schema().attribute(x.id).spec;
    warnings.push_back("Atmosphere " + std::to_string(node.value) + ", " + spec.name +
                       ": expected a finite number; its default is taken");
    return std::get<double>(spec.default_value);
  };
  AirState s;
  s.utc_s = get(a.utc_s);
  s.utc_rate = get(a.utc_rate);
  s.turbidity = get(a.turbidity);
  s.cloud_cover = get(a.cloud_cover);
  s.visibility_m = any(a.visibility_m);
  s.fog_visibility_m = any(a.fog_visibility_m);
  s.fog_top_m = any(a.fog_top_m);
  s.rain_mm_per_h = get(a.rain_mm_per_h);
  s.snow_mm_per_h = get(a.snow_mm_per_h);
  s.snow_depth_m = get(a.snow_depth_m);
  s.wetness = get(a.wetness);
  s.wind_speed_m_per_s = get(a.wind_speed_m_per_s);
  s.wind_from_deg = get(a.wind_from_deg);
  s.temperature_c = get(a.temperature_c);
  s.fixed_sun = world.get_or_default(node, a.fixed_sun);
  s.sun_azimuth_deg = get(a.sun_azimuth_deg);
  s.sun_elevation_deg = get(a.sun_elevation_deg);
  return s;
}

/// All that a drawn sky hangs on.
using SkyKey = std::array<double, 13>;
SkyKey key_of(const SkyState& s) {
  return {s.sun_azimuth_deg,   s.sun_elevation_deg, s.sun_distance_au,  s.air.turbidity,
          s.air.temperature_c, s.air.height_m,      s.cloud_cover,      s.cloud_drift_m.x(),
          s.cloud_drift_m.y(), s.visibility_m,      s.fog_visibility_m, s.fog_depth_m,
          s.snow_depth_m};
}

/// The last few of what is dear to make, newest first.
template <class Key, class T>
class Kept {
 public:
  explicit Kept(std::size_t most) : most_(most) {}
  template <class Make>
  const T& get(const Key& key, Make make) {
    const auto it = std::find_if(all_.begin(), all_.end(), [&](const auto& e) { return e.first == key; });
    if (it != all_.end()) {
      std::rotate(all_.begin(), it, it + 1);
    } else {
      all_.emplace_front(key, make());
      if (all_.size() > most_) all_.pop_back();
    }
    return all_.front().second;
  }

 private:
  std::size_t most_;
  std::deque<std::pair<Key, T>> all_;
};

/// Clouds stand where the present wind has carried them since bench time 0, so that a sky is a function of
/// the world and the time alone; a change of wind moves them at once.
class AtmosphereProvider final : public render::ContentProvider {
 public:
  [[nodiscard]] std::string_view name() const override { return "atmosphere"; }
  void rebuild(const Snapshot& world) override { read(world); }
  void apply(const world::ChangeSet& changes) override {
    const auto& schema = changes.after.schema();
    for (const auto* type : {"Atmosphere", "Place", "StudioLight", "WeatherSeries"})
      if (const auto t = schema.find_type(type))
        for (const auto& c : changes.changes)
          if (schema.is_a(c.type, *t)) return read(changes.after);
  }
  void collect(const render::ContentQuery& query, render::ContentFrame& frame) override;
  [[nodiscard]] std::vector<std::string> warnings() const override { return warnings_; }

 private:
  void read(const Snapshot& world);
  void read_studio(const Snapshot& world, NodeId node);
  [[nodiscard]] SkyState state_at(double time_s, double eye_z_m) const;
  void set_sun(SkyState& s, double utc_s) const;
  const SkyLight& sky(const SkyState& s);

  AirState air_{};
  std::optional<GeodeticPlace> place_;
  std::optional<render::Light> studio_;
  std::vector<std::string> warnings_;
  Kept<std::pair<double, double>, std::shared_ptr<const ClearSky>> clear_{2};
  Kept<SkyKey, SkyLight> skies_{kSkiesKept};
};

void AtmosphereProvider::read(const Snapshot& world) {
  warnings_.clear();
  place_.reset();
  studio_.reset();
  std::vector<NodeId> airs, studios, places, series;
  const auto& schema = world.schema();
  if (const auto t = schema.find_type("Atmosphere")) airs = nodes_by_id(world, *t);
  if (const auto t = schema.find_type("StudioLight")) studios = nodes_by_id(world, *t);
  if (const auto t = schema.find_type("Place")) places = nodes_by_id(world, *t);
  if (const auto t = schema.find_type("WeatherSeries")) series = nodes_by_id(world, *t);
  const auto several = [&](const std::vector<NodeId>& nodes, const std::string& what) {
    if (nodes.size() > 1)
      warnings_.push_back("the world has " + std::to_string(nodes.size()) + " nodes of " + what +
                          "; the one of the lowest id, " + std::to_string(nodes.front().value) + ", counts");
  };
  several(airs, "Atmosphere");
  several(studios, "StudioLight");
  several(places, "Place");

  const double infinity = std::numeric_limits<double>::infinity();
  air_ = AirState{};
  air_.visibility_m = air_.fog_visibility_m = air_.fog_top_m = infinity;
  air_.fixed_sun = true;
  if (!airs.empty())
    air_ = read_air(world, airs.front(), warnings_);
  else if (studios.empty())
    warnings_.push_back("the world has no Atmosphere: a clear noon, sun in the south at 45 degrees");
  if (!places.empty()) {
    const world::types::Place p(schema);
    place_ = GeodeticPlace{world.get_or_default(places.front(), p.latitude_deg),
                           world.get_or_default(places.front(), p.longitude_deg),
                           world.get_or_default(places.front(), p.height_m)};
  }
  if (!air_.fixed_sun && !place_ && studios.empty())
    warnings_.push_back(
        "the world has no Place, so date and time give no sun: it stands at sun_azimuth_deg and "
        "sun_elevation_deg of the Atmosphere");
  if (!studios.empty()) read_studio(world, studios.front());
  for (const NodeId node : series) {
    const auto table = WeatherTable::of(world, node);
    if (!table)
      warnings_.push_back(table.error().text());
    else if (!airs.empty() && table->row_count() > 0 && !table->covers(air_.utc_s))
      warnings_.push_back(
          "weather series " + std::to_string(node.value) + " has no row for the Atmosphere's utc_s " +
          std::to_string(static_cast<std::int64_t>(air_.utc_s)) + ": the nearest row is held");
  }
}

void AtmosphereProvider::read_studio(const Snapshot& world, NodeId node) {
  const world::types::StudioLight t(world.schema());
  const auto spectrum = [&](world::Attribute<world::Numbers> a) {
    const auto& n = world.get_or_default(node, a);
    Spectrum s{};
    if (n.size() == s.size())
      for (std::size_t b = 0; b < s.size(); ++b) s[b] = static_cast<float>(n[b]);
    else
      warnings_.push_back("StudioLight " + std::to_string(node.value) + ", " +
                          world.schema().attribute(a.id).spec.name + ": expected " +
                          std::to_string(kBandCount) + " numbers, got " + std::to_string(n.size()) +
                          "; taken as dark");
    return s;
  };
  render::Light light;
  const world::Vector3 direction = world.get_or_default(node, t.direction_to_sun);
  if (direction.allFinite() && direction.norm() > 0)
    light.direction_to_sun = direction.normalized();
  else
    warnings_.push_back("StudioLight " + std::to_string(node.value) +
                        ", direction_to_sun: expected a direction; the sun is put overhead");
  light.sun_irradiance = spectrum(t.sun_irradiance_w_per_m2);
  const Spectrum zenith = spectrum(t.zenith_radiance_w_per_m2_sr);
  const Spectrum horizon = spectrum(t.horizon_radiance_w_per_m2_sr);
  auto map = std::make_shared<render::SkyMap>();
  map->width = 4;
  map->height = 128;
  for (int row = 0; row < map->height; ++row) {
    const auto up = static_cast<float>(std::sin((row + 0.5) * std::numbers::pi / 2 / map->height));
    Spectrum s{};
    for (std::size_t b = 0; b < s.size(); ++b) s[b] = horizon[b] * (1 - up) + zenith[b] * up;
    map->radiance.insert(map->radiance.end(), static_cast<std::size_t>(map->width), s);
  }
  light.sky = std::move(map);
  light.ground_albedo = ground_albedo(air_.snow_depth_m);
  studio_ = std::move(light);
}

void AtmosphereProvider::set_sun(SkyState& s, double utc_s) const {
  if (air_.fixed_sun || !place_) {
    s.sun_azimuth_deg = air_.sun_azimuth_deg;
    s.sun_elevation_deg = air_.sun_elevation_deg;
    return;
  }
  const auto sun = sun_position(utc_s, *place_, air_.temperature_c);
  s.sun_azimuth_deg = sun.azimuth_deg;
  s.sun_elevation_deg = sun.elevation_deg;
  s.sun_distance_au = sun.distance_au;
}

SkyState AtmosphereProvider::state_at(double time_s, double eye_z_m) const {
  SkyState s;
  set_sun(s, air_.utc_rate != 0 ? stepped(air_.utc_s + air_.utc_rate * time_s) : air_.utc_s);
  s.air = {.turbidity = air_.turbidity,
           .temperature_c = air_.temperature_c,
           .height_m = place_ ? place_->height_m : 0};
  s.cloud_cover = air_.cloud_cover;
  s.cloud_drift_m = time_s * wind_velocity(air_.wind_speed_m_per_s, air_.wind_from_deg).head<2>();
  s.visibility_m = air_.visibility_m;
  s.fog_visibility_m = air_.fog_visibility_m;
  if (std::isfinite(air_.fog_visibility_m))
    s.fog_depth_m = air_.fog_top_m < std::numeric_limits<double>::infinity()
                        ? std::max(air_.fog_top_m - eye_z_m, 0.0)
                        : kEndlessFogDepth_m;
  s.snow_depth_m = air_.snow_depth_m;
  return s;
}

const SkyLight& AtmosphereProvider::sky(const SkyState& s) {
  return skies_.get(key_of(s), [&] {
    const auto clear = clear_.get(std::pair{s.air.turbidity, s.snow_depth_m}, [&] {
      return std::make_shared<const ClearSky>(s.air.turbidity, ground_albedo(s.snow_depth_m));
    });
    return make_sky_light(*clear, s);
  });
}

void AtmosphereProvider::collect(const render::ContentQuery& query, render::ContentFrame& frame) {
  const double time_s = static_cast<double>(query.t.ns()) * 1e-9;
  const double eye_z_m = std::isfinite(query.eye.z()) ? query.eye.z() : 0;
  const SkyState now = state_at(time_s, eye_z_m);

  SkyState drawn = now;
  set_sun(drawn, stepped(air_.utc_s + air_.utc_rate * time_s));
  drawn.sun_elevation_deg = to_grid(drawn.sun_elevation_deg, kStepElevation_deg);
  if (drawn.sun_elevation_deg < -19) {
    drawn.sun_elevation_deg = -20;  // night is night
    drawn.sun_azimuth_deg = 0;
    drawn.sun_distance_au = 1;
  }
  drawn.air.turbidity = to_grid(now.air.turbidity, kStepTurbidity);
  drawn.air.temperature_c = to_grid(now.air.temperature_c, kStepTemperature_c);
  drawn.cloud_cover = to_grid(now.cloud_cover, kStepCover);
  const bool drifts = drawn.cloud_cover > 0 && drawn.cloud_cover < 1;
  for (int i = 0; i < 2; ++i)
    drawn.cloud_drift_m[i] = drifts ? to_grid(now.cloud_drift_m[i], kStepDrift_m) : 0;
  drawn.visibility_m = sight_to_grid(now.visibility_m);
  drawn.fog_visibility_m = sight_to_grid(now.fog_visibility_m);
  drawn.fog_depth_m = to_grid(now.fog_depth_m, kStepFogDepth_m);
  drawn.snow_depth_m = to_grid(now.snow_depth_m, kStepSnow_m);

  Spectrum haze_radiance{}, fog_radiance{};
  if (studio_) {
    frame.light = *studio_;
    haze_radiance = fog_radiance = studio_->sky->radiance.front();
  } else {
    const SkyLight& light = sky(drawn);
    frame.light.direction_to_sun =
        SunPosition{now.sun_azimuth_deg, now.sun_elevation_deg, now.sun_distance_au}.direction();
    frame.light.sun_irradiance = sun_irradiance(now);
    frame.light.sun_angular_radius_rad = static_cast<float>(0.004652 / now.sun_distance_au);
    frame.light.sky = light.map;
    frame.light.ground_albedo = ground_albedo(now.snow_depth_m);
    haze_radiance = light.haze_radiance;
    fog_radiance = light.fog_radiance;
  }
  if (std::isfinite(now.visibility_m))
    frame.hazes.push_back({.extinction_per_m = haze_extinction_per_m(now.visibility_m),
                           .top_m = eye_z_m + kHazeDepth_m,
                           .inscattered_radiance = haze_radiance});
  if (std::isfinite(now.fog_visibility_m))
    frame.hazes.push_back({.extinction_per_m = haze_extinction_per_m(now.fog_visibility_m),
                           .top_m = air_.fog_top_m,
                           .inscattered_radiance = fog_radiance});
  const auto wind = wind_velocity(air_.wind_speed_m_per_s, air_.wind_from_deg);
  frame.precipitation = precipitation(air_.rain_mm_per_h, air_.snow_mm_per_h, wind);
  frame.surface = {.wetness = static_cast<float>(air_.wetness),
                   .snow_depth_m = static_cast<float>(air_.snow_depth_m)};
  frame.wind.velocity_m_per_s = wind.cast<float>();
}

}  // namespace

std::unique_ptr<render::ContentProvider> make_atmosphere_provider() {
  return std::make_unique<AtmosphereProvider>();
}

}  // namespace rigor::nature
