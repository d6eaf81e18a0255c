#include "bench/sensing/simulation.h"

#include <fmt/format.h>

#include <atomic>
#include <map>
#include <mutex>

#include "bench/sensing/inertial.h"
#include "bench/sensing/sensor_model_kind.h"
#include "bench/sensing/tolerance.h"
#include "bench/sensing/yuv_capture.h"
#include "sensor-hal/config/value_or_throw.h"
#include "sensor-hal/models/camera_effects.h"
#include "sensor-hal/models/camera_yaml.h"
#include "sensor-hal/models/lidar/lidar_effects.h"
#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "sensor-hal/models/tof/tof_model_effects.h"
#include "sensor-hal/models/tof/tof_yaml.h"
#include "sim/platform/harvester.h"
#include "sim/sensors/camera_simulator.h"
#include "sim/world/scene_graph.h"

namespace rigor {
namespace {

/// Where the time of a camera of the renderer `scene` goes.
class TimedCamera final : public ImageProvider {
 public:
  TimedCamera(std::shared_ptr<ImageProvider> camera, std::shared_ptr<SensorTimes> times)
      : camera_(std::move(camera)), times_(std::move(times)) {}
  [[nodiscard]] Geometry geometry() const override { return camera_->geometry(); }
  [[nodiscard]] Status capture(const ImageRequest& request, std::span<std::byte> pixels) override {
    const StageTime::Scope scope(&times_->whole);
    return camera_->capture(request, pixels);
  }

 private:
  std::shared_ptr<ImageProvider> camera_;
  std::shared_ptr<SensorTimes> times_;
};

/// Which device of those that a fitted sensor model describes the channel is.
std::uint64_t draw_of(const ConfigNode& params, const SensorOptions& options) {
  const auto draw = static_cast<std::uint64_t>(params.integer_or("calibration_draw", 0, {.min = 0}));
  return options.draw.value_or(draw);
}

/// Hinged nodes of the scene, in its order: joint i of WorldMotion is node nodes[i].
std::vector<std::size_t> hinged_nodes(const world::Scene& scene) {
  std::vector<std::size_t> nodes;
  for (std::size_t i = 0; i < scene.nodes.size(); ++i)
    if (scene.nodes[i].hinge) nodes.push_back(i);
  return nodes;
}

/// What the renderer `scene` draws: replaced as a whole when the world is edited.
class SharedScene {
 public:
  void store(std::shared_ptr<const world::Scene> scene) {
    const std::lock_guard lock(mutex_);
    scene_ = std::move(scene);
    version_.fetch_add(1, std::memory_order_release);
  }
  [[nodiscard]] std::shared_ptr<const world::Scene> load() const {
    const std::lock_guard lock(mutex_);
    return scene_;
  }
  [[nodiscard]] std::uint64_t version() const { return version_.load(std::memory_order_acquire); }

 private:
  mutable std::mutex mutex_;
  std::shared_ptr<const world::Scene> scene_;
  std::atomic<std::uint64_t> version_{0};
};

/// A camera of a small scene behind the HAL's interface. A renderer is made for one pixel format, so there is
/// one for each format that was ever asked for; the default one is ready from the beginning.
class SceneCamera final : public ImageProvider {
 public:
  SceneCamera(CameraSpec spec, Duration exposure, std::shared_ptr<const SharedScene> shared)
      : spec_(std::move(spec)),
        exposure_(exposure),
        shared_(std::move(shared)),
        version_(shared_->version()),
        scene_(shared_->load()),
        joints_(hinged_nodes(*scene_)),
        snapshot_(*scene_) {}

  Status prepare(PixelFormat format) {
    auto camera = camera_for(light_format(format));
    return camera ? Status{} : Status(tl::unexpected<Error>(camera.error()));
  }

  [[nodiscard]] Geometry geometry() const override {
    return {static_cast<std::uint32_t>(spec_.model.width_px),
            static_cast<std::uint32_t>(spec_.model.height_px), spec_.format, exposure_,
            spec_.name + "_optical"};
  }

  [[nodiscard]] Status capture(const ImageRequest& request, std::span<std::byte> pixels) override {
    return capture_converted(
        request, geometry(), pixels, scratch_,
        [this](const ImageRequest& r, std::span<std::byte> out) { return draw(r, out); });
  }

 private:
  /// After an edit of the world: its renderers are made anew.
  void take_up_edits() {
    const std::uint64_t version = shared_->version();
    if (version == version_) return;
    version_ = version;
    cameras_.clear();
    scene_ = shared_->load();
    joints_ = hinged_nodes(*scene_);
    snapshot_ = world::WorldSnapshot(*scene_);
  }

  [[nodiscard]] Status draw(const ImageRequest& request, std::span<std::byte> pixels) {
    take_up_edits();
    auto camera = camera_for(request.format);
    if (!camera) return tl::unexpected<Error>(camera.error());
    for (std::size_t i = 0; i < joints_.size(); ++i) {
      const JointState j = i < request.motion.count ? request.motion.joint[i] : JointState{};
      snapshot_.joints[joints_[i]] = {j.t_ref, j.position_rad, j.rate_radps, j.acceleration_radps2};
    }
    CaptureRequest r;
    r.capture_index = request.index;
    r.t_capture = request.t_capture;
    r.exposure = request.exposure.ns() > 0 ? request.exposure : exposure_;
    r.gain_db = request.gain_db;
    r.region = {static_cast<int>(request.offset_x_px), static_cast<int>(request.offset_y_px),
                static_cast<int>(request.width_px), static_cast<int>(request.height_px)};
    return (*camera)->capture(r, snapshot_, pixels);
  }

  Result<CameraSimulator*> camera_for(PixelFormat format) {
    auto& camera = cameras_[format];
    if (!camera) {
      CameraSpec spec = spec_;
      spec.format = format;
      auto made = CameraSimulator::create(spec, scene_);
      if (!made) return tl::unexpected<Error>(made.error());
      camera = std::move(*made);
    }
    return camera.get();
  }

  CameraSpec spec_;
  Duration exposure_;
  std::shared_ptr<const SharedScene> shared_;
  std::uint64_t version_ = 0;
  std::shared_ptr<const world::Scene> scene_;
  std::vector<std::size_t> joints_;
  world::WorldSnapshot snapshot_;
  std::map<PixelFormat, std::unique_ptr<CameraSimulator>> cameras_;
  std::vector<std::byte> scratch_;
};

/// What of this sensor model the renderer `scene` does not draw, the first of it; empty where it draws all.
std::string beyond_scene(const CameraModel& m) {
  const ImageProcessing& p = m.processing;
  if (m.projection != Projection::opencv) return "the projection of this lens";
  if (m.chromatic.lateral() || m.chromatic.longitudinal()) return "chromatic aberration";
  if (m.depth_of_field.active()) return "depth of field";
  if (m.shutter.motion_blur) return "motion blur";
  if (m.shutter.line_time_s != 0) return "a rolling shutter";
  if (m.bloom.active()) return "bloom";
  if (m.noise.hot_pixel_share != 0) return "hot pixels";
  if (p.median_filter || p.demosaic || p.subtract_black || p.gamma != 1 ||
      p.white_balance != ImageProcessing{}.white_balance)
    return "the camera's image processing";
  return {};
}

/// The keys that all simulated sensors share. Throws ConfigError.
SensorSetup read_setup(const ConfigNode& params, SampleKind kind, const SensorWorld& world,
                       const std::string& name, std::uint64_t seed, const SensorOptions& options) {
  SensorSetup setup;
  setup.name = name;
  setup.seed = seed;
  setup.ideal = options.ideal;
  setup.times = options.times;
  setup.mount =
      read_mount(params, world, kind == SampleKind::point_cloud ? SensorAxes::forward : SensorAxes::optical);
  setup.choice = read_engine_choice(params, kind);
  (void)read_tolerance(params, kind);
  if (options.choice) setup.choice = *options.choice;
  if (setup.choice.engine.empty()) setup.choice.engine = "rays";
  if (options.mount) setup.mount = *options.mount;
  return setup;
}

/// As asked for, and `ideal: true` of the channel itself. Throws ConfigError.
SensorOptions with_keys(SensorOptions options, const ConfigNode& params) {
  options.ideal |= params.flag_or("ideal", false);
  return options;
}

}  // namespace

struct Simulation::Impl {
  explicit Impl(const SimulationConfig& c) : config(c), resources(c.device) {}
  SimulationConfig config;
  std::unique_ptr<SensorWorld> world;
  std::vector<WorldPlatform> platforms;
  std::shared_ptr<SharedScene> scene;  ///< what the renderer `scene` draws; null: the world is none
  SensingResources resources;
  bool scene_cameras = false;  ///< any camera of the renderer `scene`

  /// Why the renderer `scene` cannot draw this camera; empty where it can. Throws ConfigError.
  [[nodiscard]] std::string not_by_scene(const ConfigNode& params, const SensorOptions& asked) const {
    if (!scene) return "a world other than of boxes, cylinders and flat ground";
    if (!platforms.empty()) return "platforms";
    if (!config.weather.empty()) return "weather";
    if (params.has("motion")) return "a camera that moves";
    if (params.flag_or("ideal", false) && !asked.ideal) return "a camera without its lens (`ideal`)";
    if (!asked.only.empty()) return "single effects";
    return beyond_scene(
        value_or_throw(load_camera(params.base_dir() / params.text("sensor"), draw_of(params, asked))).model);
  }
};

Simulation::Simulation(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Simulation::~Simulation() = default;

Result<std::unique_ptr<Simulation>> Simulation::open(const SimulationConfig& config) {
  auto impl = std::make_unique<Impl>(config);
  auto world = SensorWorld::open(config.world, config.weather, config.plugins);
  if (!world) return tl::unexpected<Error>(world.error());
  impl->world = std::move(*world);
  if (impl->world->is_scene()) {
    auto scene = world::scene_of(impl->world->snapshot());
    if (!scene) return tl::unexpected<Error>(scene.error());
    impl->scene = std::make_shared<SharedScene>();
    impl->scene->store(std::make_shared<const world::Scene>(std::move(*scene)));
  }
  if (!config.platforms.empty()) {
    auto platforms = make_platforms(config, impl->world->ground(), impl->world->stems(),
                                    impl->world->joint_names().size());
    if (!platforms) return tl::unexpected<Error>(platforms.error());
    impl->platforms = std::move(*platforms);
    for (const WorldPlatform& p : impl->platforms)
      if (auto s = impl->world->add_platform(p); !s) return tl::unexpected<Error>(s.error());
  }
  return std::unique_ptr<Simulation>(new Simulation(std::move(impl)));
}

Result<std::shared_ptr<ImageProvider>> Simulation::camera(ConfigNode params, std::uint64_t seed,
                                                          const std::string& name,
                                                          const SensorOptions& asked) {
  const auto by_scene = catch_config([&] {
    expect_sensor_model(params, SampleKind::image);
    const EngineChoice choice = asked.choice ? *asked.choice : read_engine_choice(params, SampleKind::image);
    if (!choice.engine.empty() && choice.engine != kSceneRenderer) return false;
    const std::string why_not = impl_->not_by_scene(params, asked);
    if (!why_not.empty() && choice.engine == kSceneRenderer)
      throw params.error("renderer", "expected rays or raster: the renderer scene does not draw " + why_not);
    return why_not.empty();
  });
  if (!by_scene) return tl::unexpected<Error>(by_scene.error());
  if (!*by_scene) {
    auto made = sensed_camera(std::move(params), seed, name, asked);
    if (!made) return tl::unexpected<Error>(made.error());
    return std::shared_ptr<ImageProvider>(std::move(*made));
  }
  auto made = catch_config([&]() -> Result<std::shared_ptr<ImageProvider>> {
    const SensorOptions options = with_keys(asked, params);
    const auto sensor_model =
        value_or_throw(load_camera(params.base_dir() / params.text("sensor"), draw_of(params, options)));
    const SensorSetup setup = read_setup(params, SampleKind::image, *impl_->world, name, seed, options);
    CameraSpec spec;
    spec.name = name;
    spec.model = sensor_model.model;
    spec.format = pixel_format_from(params.text_or("pixel_format", "Mono8")).value_or(PixelFormat::mono8);
    spec.noise = !options.ideal;
    spec.seed = seed;
    if (setup.mount.parent) spec.parent_node = params.text("parent");
    spec.T_parent_sensor = setup.mount.T_parent_sensor;
    auto provider = std::make_shared<SceneCamera>(spec, seconds_from(sensor_model.exposure_s), impl_->scene);
    if (auto s = provider->prepare(spec.format); !s) return tl::unexpected<Error>(s.error());
    impl_->scene_cameras = true;
    if (!options.times) return std::shared_ptr<ImageProvider>(std::move(provider));
    return std::shared_ptr<ImageProvider>(std::make_shared<TimedCamera>(std::move(provider), options.times));
  });
  if (!made) return tl::unexpected<Error>(made.error());
  return *made;
}

Result<std::shared_ptr<SensedCamera>> Simulation::sensed_camera(ConfigNode params, std::uint64_t seed,
                                                                const std::string& name,
                                                                const SensorOptions& asked) {
  auto made = catch_config([&] {
    expect_sensor_model(params, SampleKind::image);
    const SensorOptions options = with_keys(asked, params);
    const auto sensor_model =
        value_or_throw(load_camera(params.base_dir() / params.text("sensor"), draw_of(params, options)));
    SensorSetup setup = read_setup(params, SampleKind::image, *impl_->world, name, seed, options);
    if (setup.choice.engine == kSceneRenderer)
      throw params.error("renderer",
                         "expected rays or raster where true depth or nodes are asked for: scene has none");
    CameraModel model = sensor_model.model;
    if (options.ideal || !options.only.empty()) model = value_or_throw(only_effects(model, options.only));
    const auto format =
        pixel_format_from(params.text_or("pixel_format", "Mono8")).value_or(PixelFormat::mono8);
    return make_camera(setup, model, format, seconds_from(sensor_model.exposure_s),
                       sensor_model.supersampling, *impl_->world, impl_->resources);
  });
  if (!made) return tl::unexpected<Error>(made.error());
  return *made;
}

Result<std::shared_ptr<TruthfulSampler>> Simulation::sampler(SampleKind kind, ConfigNode params,
                                                             std::uint64_t seed, const std::string& name,
                                                             const SensorOptions& asked) {
  if (kind != SampleKind::point_cloud && kind != SampleKind::range_image)
    return tl::unexpected<Error>(
        params.error("", "expected a channel of kind point_cloud or range_image, got another one").error());
  auto made = catch_config([&]() -> Result<std::shared_ptr<TruthfulSampler>> {
    expect_sensor_model(params, kind);
    const SensorOptions options = with_keys(asked, params);
    const std::filesystem::path file = params.base_dir() / params.text("sensor");
    SensorSetup setup = read_setup(params, kind, *impl_->world, name, seed, options);
    if (kind == SampleKind::point_cloud) {
      auto model = value_or_throw(load_lidar_model(file, draw_of(params, options)));
      if (!options.only.empty()) model = value_or_throw(models::only_effects(model, options.only));
      return make_lidar(setup, model, *impl_->world, impl_->resources);
    }
    auto model = value_or_throw(load_tof_model(file, draw_of(params, options)));
    if (!options.only.empty()) model = value_or_throw(models::only_effects(model, options.only));
    return make_tof(setup, model, *impl_->world, impl_->resources);
  });
  if (!made) return tl::unexpected<Error>(made.error());
  return *made;
}

Result<std::shared_ptr<SampleProvider>> Simulation::inertial(SampleKind kind, ConfigNode params,
                                                             std::uint64_t seed, const std::string& name,
                                                             Duration period, const SensorOptions& asked) {
  const auto options = catch_config([&] { return with_keys(asked, params); });
  if (!options) return tl::unexpected<Error>(options.error());
  return make_inertial(
      kind, params,
      {name, seed, period, options->ideal, [this](const std::string& wanted) { return joint(wanted); }},
      *impl_->world);
}

Result<std::size_t> Simulation::joint(const std::string& name) const {
  const auto& joints = impl_->world->joint_names();
  std::string names;
  for (std::size_t i = 0; i < joints.size(); ++i) {
    if (joints[i] == name) return i;
    names += (names.empty() ? "" : ", ") + joints[i];
  }
  for (const WorldPlatform& p : impl_->platforms)
    for (std::size_t i = 0; i < p.model->joint_names().size(); ++i) {
      const std::string full = p.name + "." + p.model->joint_names()[i];
      if (full == name) return p.first_joint + i;
      names += (names.empty() ? "" : ", ") + full;
    }
  return fail(ErrorCode::bad_input, impl_->config.world.string(),
              fmt::format("expected a hinged node of this world ({}), got \"{}\"",
                          names.empty() ? "it has none" : names, name));
}

std::size_t Simulation::joint_count() const {
  std::size_t count = impl_->world->joint_names().size();
  for (const WorldPlatform& p : impl_->platforms) count += p.model->joint_names().size();
  return count;
}

const std::vector<WorldPlatform>& Simulation::platforms() const { return impl_->platforms; }

Result<std::size_t> Simulation::platform(const std::string& name) const {
  std::string names;
  for (std::size_t i = 0; i < impl_->platforms.size(); ++i) {
    if (impl_->platforms[i].name == name) return i;
    names += (names.empty() ? "" : ", ") + impl_->platforms[i].name;
  }
  return fail(ErrorCode::bad_input, "",
              fmt::format("expected one of `simulation.platforms` ({}), got \"{}\"",
                          names.empty() ? "there is none" : names, name));
}

WorldMotion Simulation::motion_at_rest() const {
  WorldMotion motion;
  motion.count = static_cast<std::uint32_t>(joint_count());
  for (std::size_t i = 0; i < impl_->platforms.size(); ++i)
    add_platform_motion(motion, impl_->platforms[i], i, BenchTime());
  return motion;
}

Status Simulation::edit(world::NodeId node, const std::string& attribute, world::Value value) {
  return impl_->world->edit(node, attribute, std::move(value),
                            [this](const world::Snapshot& after) -> Status {
                              if (!impl_->scene) return {};
                              auto scene = world::scene_of(after);
                              if (!scene) return tl::unexpected<Error>(scene.error());
                              impl_->scene->store(std::make_shared<const world::Scene>(std::move(*scene)));
                              return {};
                            });
}

Status Simulation::assign(const std::vector<std::string>& assignments) {
  return impl_->world->assign(assignments);
}

Eigen::Isometry3d Simulation::T_world_sensor(const Mount& mount, const WorldMotion& motion) {
  const SensorWorld::Moment moment(*impl_->world, motion);
  return mount.T_world_sensor(moment, BenchTime())(BenchTime());
}

Result<std::unique_ptr<ClearanceProbe>> Simulation::clearance_probe() {
  auto cache = impl_->resources.cache();
  if (!cache) return tl::unexpected<Error>(cache.error());
  return ClearanceProbe::create(*impl_->world, *cache);
}

std::string Simulation::engine() const {
  const std::string engines = impl_->resources.text();
  if (!impl_->scene_cameras) return engines;
  return engines.empty() ? kSceneRenderer : std::string(kSceneRenderer) + ", " + engines;
}
const SensorWorld& Simulation::world() const { return *impl_->world; }

std::vector<DoctorFinding> Simulation::doctor() {
  using Level = DoctorFinding::Level;
  const auto devices = render::Device::list();
  if (!devices || devices->empty())
    return {{Level::note,
             (devices ? "no Vulkan device" : devices.error().text()) +
                 ": sensors with `renderer: raster` cannot be drawn",
             "apt-get install mesa-vulkan-drivers (a software device), or the driver of your GPU"}};
  std::vector<DoctorFinding> out;
  for (const std::string& name : *devices) {
    const bool software = name.find("llvmpipe") != std::string::npos;
    out.push_back({software ? Level::note : Level::good,
                   "Vulkan device " + name + (software ? ": renders on the CPU, beside the loop" : ""), ""});
  }
  return out;
}

}  // namespace rigor
