#include "bench/run/pair_watches.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sensor-hal/config/value_or_throw.h"
#include "sensor-hal/models/camera_yaml.h"
#include "sensor-hal/models/lidar/lidar_math.h"
#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "sensor-hal/models/tof/tof_yaml.h"

namespace rigor {
namespace {

using pair_watch::PairWatch;
using pair_watch::WatchOptions;

/// Below this a sensor model's noise is taken for left away: a window's own scatter needs a scale.
constexpr double kLeastSigma_m = 1e-4;

std::filesystem::path sensor_model_file_of(const ConfigNode& params) {
  return params.base_dir() / params.text("sensor");
}
std::uint64_t draw_of(const ConfigNode& params) {
  return static_cast<std::uint64_t>(params.integer_or("calibration_draw", 0, {.min = 0}));
}

Result<PairWatch> of_images(const ConfigNode& params, const ChannelDescription& simulated,
                            const WatchOptions& watch) {
  const auto sensor_model = value_or_throw(load_camera(sensor_model_file_of(params), draw_of(params)));
  ImageInfo shape;
  shape.format = simulated.format;
  shape.width_px = simulated.width_px, shape.height_px = simulated.height_px;
  if (const ConfigNode region = params.map_or_absent("region"); region.present()) {
    shape.offset_x_px = static_cast<std::uint32_t>(region.integer("x_px", {.min = 0}));
    shape.offset_y_px = static_cast<std::uint32_t>(region.integer("y_px", {.min = 0}));
  }
  return PairWatch::of_images(sensor_model.model, shape, {}, watch);
}

Result<PairWatch> of_clouds(const ConfigNode& params, const WatchOptions& watch) {
  const auto model = value_or_throw(load_lidar_model(sensor_model_file_of(params), draw_of(params)));
  const models::LidarNoise& n = model.noise;
  pair_watch::CloudChangeOptions o;
  o.rings = static_cast<std::uint32_t>(std::max<std::size_t>(1, model.scan.beams.size()));
  o.points = std::clamp<std::size_t>(2 * model.firings(), 64, 1'000'000);
  // Of a surface of middling remission; what is left of its course over remission is in the baseline.
  o.sigma_m = std::max(kLeastSigma_m, models::LidarMath<double>::lidar_range_sigma_m(
                                          0.3, n.floor_m, n.scale_m, n.offset, n.exponent));
  o.remission_max = model.remission.maximum > 0 ? model.remission.maximum : model.remission.scale;
  return PairWatch::of_clouds(o, watch);
}

/// Shot noise and read noise of the phase from four samples, each of E/2 + r² variance, at amplitude A = E
/// C/2 (Lange and Seitz, IEEE J. Quantum Electronics 37, 2001, eq. 18): σ_φ² = (E/2 + r²) / (2 A²).
Result<PairWatch> of_range_images(const ConfigNode& params, const ChannelDescription& simulated,
                                  const WatchOptions& watch) {
  const auto model = value_or_throw(load_tof_model(sensor_model_file_of(params), draw_of(params)));
  const double range_m = std::min(2.0, model.unambiguous_range_m() / 2);
  const double e = std::min(model.pixel.full_well_e, model.active_electrons(range_m, 0.5));
  const double amplitude = e * model.modulation.contrast / 2;
  const double read = model.pixel.trembling ? model.pixel.read_noise_e : 0;
  const double highest_hz =
      *std::max_element(model.modulation.frequencies_hz.begin(), model.modulation.frequencies_hz.end());
  constexpr double kLight_mps = 299'792'458;
  pair_watch::RangeImageChangeOptions o;
  if (model.pixel.trembling && amplitude > 0)
    o.sigma_m =
        kLight_mps / (4 * std::numbers::pi * highest_hz) * std::sqrt((e / 2 + read * read) / 2) / amplitude;
  o.sigma_m = std::clamp(o.sigma_m, kLeastSigma_m, 0.2);
  if (amplitude > 0) o.amplitude_max = 2 * amplitude, o.noise_exponent = 0.5;
  return PairWatch::of_range_images({simulated.width_px, simulated.height_px}, o, watch);
}

Result<PairWatch> of_registers(const ConfigNode& keys, const ChannelDescription& real,
                               const ChannelDescription& simulated, const WatchOptions& watch) {
  if (real.names != simulated.names)
    throw keys.error("", fmt::format("expected the same numbers of both sides in the same order, got {} of "
                                     "the real one, {} of the simulated one",
                                     fmt::join(real.names, ", "), fmt::join(simulated.names, ", ")));
  std::vector<pair_watch::WatchedRegister> registers;
  for (std::size_t i = 0; i < simulated.names.size(); ++i)
    registers.push_back({static_cast<std::uint32_t>(i),
                         {simulated.names[i], i < simulated.units.size() ? simulated.units[i] : "", 0}});
  if (registers.empty() || registers.size() > 10)
    throw keys.error(
        "", fmt::format("expected one to ten numbers to watch, the channel has {}", registers.size()));
  return PairWatch::of_registers(registers, watch);
}

}  // namespace

Result<PairWatch> make_pair_watch(const ChannelEntry& entry, const ChannelDescription& real,
                                  const ChannelDescription& simulated) {
  auto made = catch_config([&]() -> Result<PairWatch> {
    const ConfigNode keys = entry.pair.map_or_absent("watch");
    const WatchOptions watch{.window_s = entry.watch->window_s,
                             .baseline_windows = entry.watch->baseline_windows,
                             .false_alarms_per_h = entry.watch->false_alarms_per_h};
    const auto at_keys = [&](Result<PairWatch> result) {
      if (!result) throw keys.error("", result.error().text());
      return result;
    };
    switch (entry.kind) {
      case SampleKind::image:
        return at_keys(of_images(entry.simulated.params, simulated, watch));
      case SampleKind::point_cloud:
        return at_keys(of_clouds(entry.simulated.params, watch));
      case SampleKind::range_image:
        return at_keys(of_range_images(entry.simulated.params, simulated, watch));
      case SampleKind::register_block:
        return at_keys(of_registers(keys, real, simulated, watch));
      case SampleKind::imu:
      case SampleKind::nav_fix:
      case SampleKind::odometry:
        return at_keys(PairWatch::of_numbers(entry.kind, watch));
      default:
        throw entry.pair.error("watch",
                               fmt::format("expected no watch of a pair of kind {}: image, point_cloud, "
                                           "range_image, registers, imu, nav_fix and odometry can be watched",
                                           kind_name(entry.kind)));
    }
  });
  if (!made) return tl::unexpected<Error>(made.error());
  return std::move(*made);
}

}  // namespace rigor
