#include "bench/devices/device_world.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "bench/devices/device_sensors.h"
#include "bench/plant/plants.h"
#include "bench/sensing/device_signals.h"
#include "bench/sensing/inertial.h"
#include "bench/sensing/sensor_model_kind.h"
#include "sensor-hal/config/did_you_mean.h"
#include "sensor-hal/config/rate.h"
#include "sim/platform/platform.h"
#include "sim/platform/turntable.h"

namespace rigor {
namespace {

/// The motion of all joints, each from the device model that moves it.
class DeviceMotion final : public MotionSource {
 public:
  std::vector<std::shared_ptr<const MotionSource>> joints;  ///< null: at rest at zero
  const std::vector<WorldPlatform>* platforms = nullptr;
  [[nodiscard]] WorldMotion motion_at(BenchTime t) const noexcept override {
    WorldMotion m;
    m.count = static_cast<std::uint32_t>(joints.size());
    for (std::size_t i = 0; i < joints.size(); ++i)
      if (joints[i]) m.joint[i] = joints[i]->motion_at(t).joint[0];
    if (platforms)
      for (std::size_t i = 0; i < platforms->size(); ++i) add_platform_motion(m, (*platforms)[i], i, t);
    return m;
  }
};

TurntableConfig read_turntable(ConfigNode n) {
  TurntableConfig c;
  n = n.map_or_absent("turntable");
  constexpr double kRadPerDeg = 0.017453292519943295;
  c.max_rate_radps =
      n.number_or("max_rate_degps", c.max_rate_radps / kRadPerDeg, {.min = 0, .exclusive_min = true}) *
      kRadPerDeg;
  c.max_acceleration_radps2 = n.number_or("max_acceleration_degps2", c.max_acceleration_radps2 / kRadPerDeg,
                                          {.min = 0, .exclusive_min = true}) *
                              kRadPerDeg;
  n.finish();
  return c;
}

}  // namespace

struct DeviceWorld::Impl {
  RigConfig copy;
  std::unique_ptr<Simulation> simulation;
  std::shared_ptr<DeviceMotion> motion = std::make_shared<DeviceMotion>();
  std::map<std::string, std::shared_ptr<Turntable>, std::less<>> turntables;
  std::map<std::string, std::shared_ptr<SignalModel>, std::less<>> signals;
  std::map<std::string, std::shared_ptr<Platform>, std::less<>> carriers;  ///< by emulator
  std::map<std::string, std::shared_ptr<DeviceSensors>, std::less<>> sensors;
  plant::Plants plants;
  std::map<std::string, std::shared_ptr<plant::Plant>, std::less<>> shown;  ///< by emulator
  bool set_out = false;

  /// Device models first: cameras look at what they move.
  Status make_models() {
    if (simulation) {
      motion->joints.resize(simulation->joint_count());
      motion->platforms = &simulation->platforms();
    }
    for (const EmulatorEntry& e : copy.emulators) {
      const ConfigNode& n = e.emulator.params;
      const bool bus = e.emulator.backend == "modbus" || e.emulator.backend == "can";
      if (n.has("sensors") && bus) {
        if (auto s = make_sensors(e); !s) return s;
        continue;
      }
      if (n.has("platform") && bus) {
        if (auto s = take_platform(e); !s) return s;
        continue;
      }
      if (n.has("plant") && bus) {
        if (auto s = take_plant(e); !s) return s;
        continue;
      }
      if (!n.has("model") || !bus) continue;
      auto made = catch_config([&]() -> Status {
        (void)n.choice("model", {"turntable"});
        auto table = std::make_shared<Turntable>(read_turntable(n));
        if (n.has("joint")) {
          if (!simulation) throw n.error("joint", "expected `simulation.world` in the rig, found none");
          auto index = simulation->joint(n.text("joint"));
          if (!index) return tl::unexpected<Error>(index.error());
          motion->joints[*index] = table;
        }
        turntables[e.name] = std::move(table);
        return {};
      });
      if (!made) return tl::unexpected<Error>(made.error());
      if (!*made) return *made;
    }
    return {};
  }

  /// The device measures how it moves.
  Status make_sensors(const EmulatorEntry& e) {
    const ConfigNode& n = e.emulator.params;
    if (!simulation)
      return tl::unexpected<Error>(
          n.error("sensors", "expected `simulation.world` in the rig, found none").error());
    auto made = DeviceSensors::make(
        n, e.name + ".device", motion,
        [this](SampleKind kind, const ConfigNode& keys, const std::string& name, Duration period) {
          return simulation->inertial(kind, keys, copy.seed, name, period);
        });
    if (!made) return tl::unexpected<Error>(made.error());
    sensors[e.name] = std::move(*made);
    return {};
  }

  /// The device is a platform of its world.
  Status take_platform(const EmulatorEntry& e) {
    const ConfigNode& n = e.emulator.params;
    auto name = catch_config([&] { return n.text("platform"); });
    if (!name) return tl::unexpected<Error>(name.error());
    if (!simulation)
      return tl::unexpected<Error>(
          n.error("platform", "expected `simulation.world` in the rig, found none").error());
    auto index = simulation->platform(*name);
    if (!index) return tl::unexpected<Error>(n.error("platform", index.error().message).error());
    carriers[e.name] = simulation->platforms()[*index].model;
    return {};
  }

  /// The device is an FMU, and may move a joint of its world.
  Status take_plant(const EmulatorEntry& e) {
    auto taken = catch_config([&]() -> Status {
      const ConfigNode& n = e.emulator.params;
      auto plant = plants.of(n);
      shown[e.name] = plant;
      if (!n.has("joint")) return {};
      if (!simulation) throw n.error("joint", "expected `simulation.world` in the rig, found none");
      auto index = simulation->joint(n.text("joint"));
      if (!index) return tl::unexpected<Error>(index.error());
      const std::string name = n.text("position");
      std::vector<std::string> names;
      for (const auto& signal : plant->signals()) names.push_back(signal.name);
      const auto at = std::ranges::find(names, name);
      if (at == names.end())
        throw n.error("position", fmt::format("expected a signal of the plant ({}), got \"{}\"{}",
                                              fmt::join(names, ", "), name, did_you_mean(name, names)));
      const auto signal = static_cast<std::size_t>(at - names.begin());
      const std::string& unit = plant->signals()[signal].unit;
      if (unit != "deg" && unit != "rad" && unit != "m")
        throw n.error("position",
                      fmt::format("expected a signal in deg, rad or m, got {} in \"{}\"; give the signal "
                                  "a `unit` in plants.{}.signals",
                                  name, unit, plant->settings().name));
      constexpr double kRadPerDeg = 0.017453292519943295;
      motion->joints[*index] =
          std::make_shared<plant::PlantJoint>(std::move(plant), signal, unit == "deg" ? kRadPerDeg : 1.0);
      return {};
    });
    if (!taken) return tl::unexpected<Error>(taken.error());
    return *taken;
  }

  /// Then what they say on a bus: their own signals and those that the rig gives them.
  Status make_signals() {
    const JointFinder find = [this](const ConfigNode& n, std::string_view key) {
      if (!simulation) throw n.error(key, "expected `simulation.world` in the rig, found none");
      auto index = simulation->joint(n.text(key));
      if (!index) throw n.error(key, index.error().message);
      return *index;
    };
    for (const EmulatorEntry& e : copy.emulators) {
      if (e.emulator.backend != "can") continue;
      const auto table = turntables.find(e.name);
      std::shared_ptr<SignalModel> base;
      if (table != turntables.end()) base = table->second;
      if (const auto it = carriers.find(e.name); it != carriers.end()) base = it->second;
      if (const auto it = sensors.find(e.name); it != sensors.end()) base = it->second;
      if (const auto it = shown.find(e.name); it != shown.end()) base = it->second;
      auto made = catch_config([&] { return read_device_signals(e.emulator.params, base, motion, find); });
      if (!made) return tl::unexpected<Error>(made.error());
      signals[e.name] = std::move(*made);
    }
    return {};
  }

  /// What the device measures: a picture, or samples, as its sensor model says.
  Status add_sensor(const EmulatorEntry& entry, DeviceParts& parts) {
    const ConfigNode& n = entry.emulator.params;
    if (!simulation)
      return tl::unexpected<Error>(
          n.error("sensor", "expected `simulation.world` in the rig for a sensor to look at, found none")
              .error());
    if (n.has("motion"))
      return tl::unexpected<Error>(
          n.error("motion",
                  "expected no `motion` of an emulated device: it runs beside the bench and knows "
                  "no start of a run")
              .error());
    const auto kind = catch_config([&] { return kind_of_sensor_model(n); });
    if (!kind) return tl::unexpected<Error>(kind.error());
    // The device's own noise: its draws are keyed apart from those of its simulated side.
    const std::string name = entry.name + ".device";
    if (*kind == SampleKind::image) {
      auto camera = simulation->camera(n, copy.seed, name);
      if (!camera) return tl::unexpected<Error>(camera.error());
      parts.image = std::move(*camera);
    } else if (is_inertial(*kind)) {
      // Errors that drift are keyed by the capture's index: they have to know how far captures lie apart.
      const auto period = catch_config(
          [&] { return read_rate_or(n, "rate_hz", milliseconds(100), {.min = 1e-3, .max = 1e5}); });
      if (!period) return tl::unexpected<Error>(period.error());
      auto sensor = simulation->inertial(*kind, n, copy.seed, name, *period);
      if (!sensor) return tl::unexpected<Error>(sensor.error());
      parts.samples = std::move(*sensor);
    } else {
      auto sampler = simulation->sampler(*kind, n, copy.seed, name);
      if (!sampler) return tl::unexpected<Error>(sampler.error());
      parts.samples = std::move(*sampler);
    }
    return {};
  }
};

DeviceWorld::DeviceWorld(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
DeviceWorld::~DeviceWorld() = default;

Result<std::unique_ptr<DeviceWorld>> DeviceWorld::open(const RigConfig& rig) {
  auto impl = std::make_unique<Impl>();
  impl->copy = rig;
  if (!rig.simulation.world.empty() && !rig.emulators.empty()) {
    auto simulation = Simulation::open(rig.simulation);
    if (!simulation) return tl::unexpected<Error>(simulation.error());
    impl->simulation = std::move(*simulation);
  }
  auto shown = catch_config([&] { return plant::plants_of_emulators(rig); });
  if (!shown) return tl::unexpected<Error>(shown.error());
  auto plants = plant::Plants::open(
      rig, [&](const std::string& name) { return std::ranges::find(*shown, name) != shown->end(); });
  if (!plants) return tl::unexpected<Error>(plants.error());
  impl->plants = std::move(*plants);
  if (auto s = impl->make_models(); !s) return tl::unexpected<Error>(s.error());
  if (auto s = impl->make_signals(); !s) return tl::unexpected<Error>(s.error());
  return std::unique_ptr<DeviceWorld>(new DeviceWorld(std::move(impl)));
}

std::vector<std::shared_ptr<Platform>> DeviceWorld::platforms() const {
  std::vector<std::shared_ptr<Platform>> all;
  if (impl_->simulation)
    for (const WorldPlatform& p : impl_->simulation->platforms()) all.push_back(p.model);
  return all;
}

std::vector<std::shared_ptr<plant::Plant>> DeviceWorld::plants() const { return impl_->plants.used(); }

Result<DeviceParts> DeviceWorld::parts(std::string_view emulator_name) {
  const EmulatorEntry* entry = impl_->copy.emulator(emulator_name);
  if (!entry)
    return fail(ErrorCode::bad_input, "emulators",
                fmt::format("expected an emulator `{}`, found none", emulator_name));
  DeviceParts parts;
  parts.motion = impl_->motion;
  if (const auto it = impl_->turntables.find(emulator_name); it != impl_->turntables.end())
    parts.registers = it->second;
  if (const auto it = impl_->carriers.find(emulator_name); it != impl_->carriers.end())
    parts.registers = it->second;
  if (const auto it = impl_->sensors.find(emulator_name); it != impl_->sensors.end())
    parts.registers = it->second;
  if (const auto it = impl_->shown.find(emulator_name); it != impl_->shown.end())
    parts.registers = it->second;
  if (const auto it = impl_->signals.find(emulator_name); it != impl_->signals.end())
    parts.signals = it->second;
  const ConfigNode& n = entry->emulator.params;
  if (n.has("sensor"))
    if (auto s = impl_->add_sensor(*entry, parts); !s) return tl::unexpected<Error>(s.error());
  return parts;
}

Result<std::unique_ptr<Emulator>> DeviceWorld::start_emulator(const EmulatorEntry& entry,
                                                              const Registry& registry, BenchTime t0) {
  const Backend* backend = registry.find(entry.emulator.backend);
  if (!backend || !backend->make_emulator) {
    std::vector<std::string> names;
    for (const auto& [name, b] : registry.all())
      if (b.make_emulator) names.push_back(name);
    return tl::unexpected<Error>(
        entry.node
            .error("backend", fmt::format("expected a backend with an emulator ({}), got \"{}\"{}",
                                          fmt::join(names, ", "), entry.emulator.backend,
                                          did_you_mean(entry.emulator.backend, names)))
            .error());
  }
  auto device_parts = parts(entry.name);
  if (!device_parts) return tl::unexpected<Error>(device_parts.error());
  if (!std::exchange(impl_->set_out, true)) {
    for (const auto& plant : plants()) {
      plant->announce_faults();
      if (auto s = plant->arm(false); !s) return tl::unexpected<Error>(s.error());
    }
    for (const auto& plant : plants()) plant->start(bench_now());
    for (const auto& platform : platforms()) platform->start(t0);
  }
  auto emulator = backend->make_emulator();
  emulator->attach(std::move(*device_parts));
  ChannelConfig config;
  config.name = entry.name;
  config.seed = impl_->copy.seed;
  config.params = entry.emulator.params;
  const auto first_error = [&]() -> Status {
    if (auto s = emulator->configure(config); !s) return s;
    if (auto s = emulator->arm({}); !s) return s;
    return emulator->start(t0);
  };
  if (auto s = first_error(); !s) return tl::unexpected<Error>(s.error());
  return emulator;
}

}  // namespace rigor
