#include "bench/run/simulated_backend.h"

#include <fmt/format.h>

#include <algorithm>

#include "bench/sensing/changing_device.h"
#include "bench/sensing/inertial.h"
#include "bench/sensing/signal_values.h"
#include "sensor-hal/channel/pair_statistics.h"
#include "sensor-hal/channel/simulated_sink.h"
#include "sensor-hal/channel/simulated_source.h"
#include "sim/platform/platform.h"

namespace rigor {
namespace {

bool emulated(const RigConfig& rig, const std::string& platform) {
  return std::any_of(rig.emulators.begin(), rig.emulators.end(), [&](const EmulatorEntry& e) {
    return e.emulator.params.has("platform") && e.emulator.params.text("platform") == platform;
  });
}

/// A sensor on a platform whose motion the bench does not know would stand still.
void check_platform(const RigConfig& rig, const ConfigNode& params) {
  const char* const key = params.has("platform") ? "platform" : "parent";
  if (!params.has(key)) return;
  const std::string word = params.text(key), name = word.substr(0, word.find('.'));
  for (const PlatformEntry& entry : rig.simulation.platforms)
    if (entry.name == name && entry.channel.empty() && emulated(rig, name))
      throw params.error(
          key, fmt::format("expected `channel` in simulation.platforms.{}: an emulator moves it in the "
                           "devices' world, and the bench knows only what a channel reports of that",
                           name));
}

Result<std::size_t> platform_of(Simulation& simulation, const ConfigNode& params) {
  auto body = simulation.platform(params.text("platform"));
  if (!body) throw params.error("platform", body.error().message);
  return body;
}

Result<AnyProvider> as_any(auto made) {
  if (!made) return tl::unexpected<Error>(made.error());
  return AnyProvider(std::move(*made));
}

/// What measures for one channel, or for the simulated side of a pair.
Result<AnyProvider> make_provider(const SimulatedWorld& world, const ChannelConfig& config) {
  const ConfigNode& params = config.params;
  if (!world.simulation)
    throw params.error("backend",
                       "expected `simulation.world` in the rig for a simulated channel, found none");
  Simulation& simulation = *world.simulation;
  check_platform(world.parts->rig, params);
  if (config.kind == SampleKind::pose) {
    const auto body = platform_of(simulation, params);
    return AnyProvider(make_pose_provider(*body, params.text("platform")));
  }
  SensorOptions options;
  options.times = std::make_shared<SensorTimes>();
  world.parts->sensor_times.emplace_back(config.name, options.times);
  std::string channel = config.name;
  if (const std::string side = std::string(".") + name_of(PairSide::simulated); channel.ends_with(side))
    channel.resize(channel.size() - side.size());
  if (const auto it = world.renderers.find(channel); it != world.renderers.end()) options.choice = it->second;

  const std::uint64_t seed = config.seed;
  if (config.kind == SampleKind::point_cloud || config.kind == SampleKind::range_image)
    return as_any(
        changing_sampler(params, [&](const ConfigNode& keys) -> Result<std::shared_ptr<SampleProvider>> {
          auto made = simulation.sampler(config.kind, keys, seed, config.name, options);
          if (!made) return tl::unexpected<Error>(made.error());
          return std::shared_ptr<SampleProvider>(std::move(*made));
        }));
  if (is_inertial(config.kind))
    return as_any(simulation.inertial(config.kind, params, seed, config.name, config.period, options));
  if (config.kind == SampleKind::register_block)
    return AnyProvider(make_signal_values(params, [&](const ConfigNode& n, std::string_view key) {
      auto index = simulation.joint(n.text(key));
      if (!index) throw n.error(key, index.error().message);
      return *index;
    }));
  if (config.kind != SampleKind::image)
    throw params.error(
        "kind", fmt::format("expected image, range_image, point_cloud, registers, pose, imu, nav_fix or "
                            "odometry, which simulators make, got {}",
                            kind_name(config.kind)));
  return as_any(changing_camera(
      params, [&](const ConfigNode& keys) { return simulation.camera(keys, seed, config.name, options); }));
}

/// The platform of this process that a sink commands.
Result<std::shared_ptr<SignalModel>> find_platform(const SimulatedWorld& world, const ChannelConfig& config) {
  const ConfigNode& params = config.params;
  if (!world.simulation)
    throw params.error("backend",
                       "expected `simulation.world` in the rig for a simulated device, found none");
  const auto body = platform_of(*world.simulation, params);
  if (!moves_here(world.parts->rig, *body))
    throw params.error("platform",
                       "expected a platform that the bench moves, got one that an emulator or a channel "
                       "moves; command that device");
  return std::shared_ptr<SignalModel>(world.simulation->platforms()[*body].model);
}

}  // namespace

bool moves_here(const RigConfig& rig, std::size_t index) {
  const PlatformEntry& entry = rig.simulation.platforms[index];
  return entry.channel.empty() && !emulated(rig, entry.name);
}

Backend simulated_backend(SimulatedWorld world) {
  const auto shared = std::make_shared<const SimulatedWorld>(std::move(world));
  Backend b;
  b.name = kSimulatedBackend;
  b.summary = "sensors that measure in the bench's world, and platforms that move in it";
  b.make_source = [shared] {
    return std::make_unique<SimulatedSource>(
        [shared](const ChannelConfig& config) { return make_provider(*shared, config); },
        &shared->parts->motion, *shared->workers);
  };
  b.make_sink = [shared] {
    return std::make_unique<SimulatedSink>(
        [shared](const ChannelConfig& config) { return find_platform(*shared, config); });
  };
  b.same_in_virtual_time = true;
  b.gives_typed_samples = true;
  return b;
}

}  // namespace rigor
