#include "bench/sensing/sensors.h"

#include <cmath>
#include <cstring>
#include <optional>
#include <utility>

#include "bench/sensing/yuv_capture.h"
#include "sim/render/view/raster_engine.h"

namespace rigor {
namespace {

/// Either engine behind one face: what has to be set anew for each capture.
struct Engine {
  std::shared_ptr<render::RayEngine> engine;
  std::shared_ptr<render::EmbreeEngine> rays;  ///< `renderer`, where it is one
  render::EmbreeOptions rays_options;

  /// Levels of detail are chosen by what they are off as seen from here.
  void look_from(const Eigen::Vector3d& eye) {
    if (!rays || rays_options.allowed_error_rad == 0) return;
    render::ContentQuery query;
    query.look_from_cell_of(eye);
    rays_options.eye = query.eye;
    rays_options.eye_reach_m = query.eye_reach_m;
    rays->set_options(rays_options);
  }
};

/// Any engine, with the time that it takes.
class TimedEngine final : public render::RayEngine {
 public:
  TimedEngine(std::shared_ptr<render::RayEngine> engine, std::shared_ptr<SensorTimes> times)
      : engine_(std::move(engine)), times_(std::move(times)) {}
  [[nodiscard]] std::string_view name() const override { return engine_->name(); }
  [[nodiscard]] bool own_origins() const override { return engine_->own_origins(); }
  [[nodiscard]] Status prepare(std::shared_ptr<const render::ContentWindow> window) override {
    const StageTime::Scope scope(&times_->prepare);
    return engine_->prepare(std::move(window));
  }
  [[nodiscard]] Status cast(const render::RayQuery& query, std::span<render::Hit> hits) override {
    const StageTime::Scope scope(&times_->light);
    return engine_->cast(query, hits);
  }
  [[nodiscard]] Status cast_layers(const render::RayQuery& query, render::LayeredHits& hits) override {
    const StageTime::Scope scope(&times_->light);
    return engine_->cast_layers(query, hits);
  }
  [[nodiscard]] Status occluded(const render::RayQuery& query, std::span<std::uint8_t> met) override {
    const StageTime::Scope scope(&times_->light);
    return engine_->occluded(query, met);
  }
  [[nodiscard]] render::EngineStatistics statistics() const override { return engine_->statistics(); }

 private:
  std::shared_ptr<render::RayEngine> engine_;
  std::shared_ptr<SensorTimes> times_;
};

std::shared_ptr<render::RayEngine> timed(const Engine& engine, const std::shared_ptr<SensorTimes>& times) {
  if (!times) return engine.engine;
  return std::make_shared<TimedEngine>(engine.engine, times);
}

/// The world at an instant; how long that took counts.
class TimedMoment {
 public:
  TimedMoment(SensorWorld& world, const WorldMotion& motion, SensorTimes* times)
      : scope_(std::in_place, times ? &times->world : nullptr),
        moment_(world, motion, times ? &times->collect : nullptr) {
    scope_.reset();
  }
  [[nodiscard]] SensorWorld::Moment& operator*() { return moment_; }

 private:
  std::optional<StageTime::Scope> scope_;
  SensorWorld::Moment moment_;
};

Result<Engine> make_engine(const EngineChoice& choice, SensingResources& resources) {
  Engine e;
  if (choice.engine == "raster") {
    auto device = resources.device();
    if (!device) return tl::unexpected<Error>(device.error());
    render::RasterOptions options;
    options.allowed_error_rad = choice.allowed_error_rad;
    if (choice.pixels_per_rad > 0) options.pixels_per_rad = choice.pixels_per_rad;
    if (choice.instants > 0) options.instants = choice.instants;
    auto made = render::RasterEngine::create(*device, options);
    if (!made) return tl::unexpected<Error>(made.error());
    e.engine = *made;
    return e;
  }
  auto cache = resources.cache();
  if (!cache) return tl::unexpected<Error>(cache.error());
  e.rays_options.allowed_error_rad = choice.allowed_error_rad;
  auto made = render::EmbreeEngine::create(*cache, e.rays_options);
  if (!made) return tl::unexpected<Error>(made.error());
  e.engine = e.rays = *made;
  return e;
}

class SensedLidar final : public TruthfulSampler {
 public:
  SensedLidar(std::unique_ptr<LidarSimulator> lidar, Engine engine, const SensorSetup& setup,
              SensorWorld& world)
      : lidar_(std::move(lidar)),
        engine_(std::move(engine)),
        mount_(setup.mount),
        world_(world),
        times_(setup.times) {}

  [[nodiscard]] Geometry geometry() const override {
    return {SampleKind::point_cloud, 0, 0, lidar_->max_points() * sizeof(LidarPoint), lidar_->spec().name};
  }
  [[nodiscard]] Status capture(const Request& request, Sample& sample) override {
    const StageTime::Scope scope(times_ ? &times_->whole : nullptr);
    TimedMoment timed_moment(world_, request.motion, times_.get());
    SensorWorld::Moment& moment = *timed_moment;
    render::PoseFunction pose = mount_.T_world_sensor(moment, request.t_start);
    // A scan that begins farther round is the usual one of a sensor that stands turned by that much.
    const Eigen::AngleAxisd turn(request.turn_rad, Eigen::Vector3d::UnitZ());
    if (request.turn_rad != 0)
      pose = [straight = std::move(pose), turn](BenchTime t) { return straight(t) * turn; };
    engine_.look_from(pose(request.t_capture).translation());
    if (auto s = lidar_->capture({request.index, request.t_capture}, {moment, pose}, points_, truth_); !s)
      return s;
    if (request.turn_rad != 0) turn_points(turn);
    const std::size_t size = points_.size() * sizeof(LidarPoint);
    if (size > sample.memory().size())
      return fail(ErrorCode::internal, lidar_->spec().name, "a scan holds more points than it said it would");
    if (size > 0) std::memcpy(sample.memory().data(), points_.data(), size);
    sample.info = PointCloudInfo{static_cast<std::uint32_t>(points_.size())};
    sample.size_bytes = size;
    return {};
  }
  [[nodiscard]] const models::LidarScan* scan() const override { return &lidar_->spec().model.scan; }

 private:
  /// Points and normals from the turned frame to the sensor's.
  void turn_points(const Eigen::AngleAxisd& turn) {
    const Eigen::Matrix3d R = turn.toRotationMatrix();
    for (LidarPoint& p : points_) {
      const Eigen::Vector3f at = (R * Eigen::Vector3d(p.x_m, p.y_m, p.z_m)).cast<float>();
      p.x_m = at.x(), p.y_m = at.y(), p.z_m = at.z();
    }
    if (!truth_) return;
    for (std::size_t i = 0; i + 2 < truth_->normal.size(); i += 3) {
      Eigen::Map<Eigen::Vector3f> normal(&truth_->normal[i]);
      normal = (R.cast<float>() * normal).eval();
    }
  }

  std::unique_ptr<LidarSimulator> lidar_;
  Engine engine_;
  Mount mount_;
  SensorWorld& world_;
  std::shared_ptr<SensorTimes> times_;
  std::vector<LidarPoint> points_;
};

class SensedTof final : public TruthfulSampler {
 public:
  SensedTof(std::unique_ptr<TofSimulator> tof, Engine engine, const SensorSetup& setup, SensorWorld& world)
      : tof_(std::move(tof)),
        engine_(std::move(engine)),
        mount_(setup.mount),
        world_(world),
        times_(setup.times) {}

  [[nodiscard]] Geometry geometry() const override {
    const models::TofModel& m = tof_->spec().model;
    const auto w = static_cast<std::uint32_t>(m.width_px), h = static_cast<std::uint32_t>(m.height_px);
    return {SampleKind::range_image, w, h, std::size_t{w} * h * 2 * sizeof(float),
            tof_->spec().name + "_optical"};
  }
  [[nodiscard]] Status capture(const Request& request, Sample& sample) override {
    const StageTime::Scope scope(times_ ? &times_->whole : nullptr);
    TimedMoment timed_moment(world_, request.motion, times_.get());
    SensorWorld::Moment& moment = *timed_moment;
    const auto pose = mount_.T_world_sensor(moment, request.t_start);
    engine_.look_from(pose(request.t_capture).translation());
    if (auto s = tof_->capture({request.index, request.t_capture}, {moment, pose}, picture_, truth_); !s)
      return s;
    const std::size_t plane = picture_.range_m.size() * sizeof(float);
    if (2 * plane > sample.memory().size() || picture_.amplitude.size() != picture_.range_m.size())
      return fail(ErrorCode::internal, tof_->spec().name, "a range image of another size than it said");
    std::memcpy(sample.memory().data(), picture_.range_m.data(), plane);
    std::memcpy(sample.memory().data() + plane, picture_.amplitude.data(), plane);
    sample.info = RangeImageInfo{picture_.width_px, picture_.height_px};
    sample.size_bytes = 2 * plane;
    return {};
  }
  [[nodiscard]] std::optional<CameraModel> lens() const override { return tof_->spec().model.camera(); }
  [[nodiscard]] std::vector<std::array<float, 3>> directions() const override {
    const CameraModel camera = tof_->spec().model.camera();
    std::vector<std::array<float, 3>> rays;
    rays.reserve(static_cast<std::size_t>(camera.width_px) * static_cast<std::size_t>(camera.height_px));
    for (int v = 0; v < camera.height_px; ++v)
      for (int u = 0; u < camera.width_px; ++u) {
        const auto ray = unproject(camera, {static_cast<double>(u), static_cast<double>(v)});
        const Eigen::Vector3f d = ray ? Eigen::Vector3d(ray->x, ray->y, 1).normalized().cast<float>().eval()
                                      : Eigen::Vector3f::Constant(std::nanf(""));
        rays.push_back({d.x(), d.y(), d.z()});
      }
    return rays;
  }

 private:
  std::unique_ptr<TofSimulator> tof_;
  Engine engine_;
  Mount mount_;
  SensorWorld& world_;
  std::shared_ptr<SensorTimes> times_;
  TofPicture picture_;
};

class SensedCameraOfWorld final : public SensedCamera {
 public:
  SensedCameraOfWorld(std::unique_ptr<SimulatedCamera> camera, PixelFormat format, Duration exposure,
                      const SensorSetup& setup, SensorWorld& world)
      : camera_(std::move(camera)),
        format_(format),
        exposure_(exposure),
        mount_(setup.mount),
        world_(world),
        times_(setup.times) {}

  [[nodiscard]] Geometry geometry() const override {
    const SimulatedCameraSpec& spec = camera_->spec();
    return {static_cast<std::uint32_t>(spec.model.width_px), static_cast<std::uint32_t>(spec.model.height_px),
            format_, exposure_, spec.name + "_optical"};
  }
  [[nodiscard]] Status capture(const ImageRequest& request, std::span<std::byte> pixels) override {
    return capture_converted(
        request, geometry(), pixels, scratch_,
        [this](const ImageRequest& r, std::span<std::byte> out) { return measure(r, out); });
  }
  void set_truth(GroundTruth* truth) override { truth_ = truth; }
  [[nodiscard]] const OpticsPicture& light() const override { return camera_->picture(); }
  [[nodiscard]] const CameraModel& model() const override { return camera_->spec().model; }

 private:
  [[nodiscard]] Status measure(const ImageRequest& request, std::span<std::byte> pixels) {
    const StageTime::Scope scope(times_ ? &times_->whole : nullptr);
    TimedMoment timed_moment(world_, request.motion, times_.get());
    SensorWorld::Moment& moment = *timed_moment;
    CameraCapture c;
    c.measure = {request.index, request.t_capture};
    c.exposure = request.exposure.ns() > 0 ? request.exposure : exposure_;
    c.gain_db = request.gain_db;
    c.format = request.format;
    c.region = {static_cast<int>(request.offset_x_px), static_cast<int>(request.offset_y_px),
                static_cast<int>(request.width_px), static_cast<int>(request.height_px)};
    CaptureTimes spent;
    const std::int64_t collected_ns = times_ ? times_->collect.wall_ns.load() : 0;
    const Status captured = camera_->capture(c, {moment, mount_.T_world_sensor(moment, request.t_start)},
                                             pixels, truth_, times_ ? &spent : nullptr);
    if (times_) {
      const Duration prepare = seconds_from(spent.prepare_ms * 1e-3);
      const Duration collect(times_->collect.wall_ns.load() - collected_ns);
      times_->prepare.add(prepare, Duration(0));
      times_->light.add(seconds_from(spent.optics_ms * 1e-3) - prepare - collect, Duration(0));
    }
    return captured;
  }

  std::unique_ptr<SimulatedCamera> camera_;
  PixelFormat format_;
  std::vector<std::byte> scratch_;
  Duration exposure_;
  Mount mount_;
  SensorWorld& world_;
  std::shared_ptr<SensorTimes> times_;
  GroundTruth* truth_ = nullptr;
};

}  // namespace

Result<std::shared_ptr<render::Device>> SensingResources::device() {
  if (device_) return device_;
  auto opened = render::Device::create({.name_contains = device_name_});
  if (opened) device_ = *opened;
  return opened;
}

Result<std::shared_ptr<render::EmbreeCache>> SensingResources::cache() {
  if (cache_) return cache_;
  auto made = render::EmbreeCache::create();
  if (made) cache_ = *made;
  return made;
}

Result<std::shared_ptr<SharedLight>> SensingResources::light() {
  if (light_) return light_;
  auto meshes = cache();
  if (!meshes) return tl::unexpected<Error>(meshes.error());
  auto made = SharedLight::create(*meshes);
  if (made) light_ = *made;
  return made;
}

std::string SensingResources::text() const {
  std::string t = device_ ? "raster on " + device_->name() : "";
  if (cache_) t += t.empty() ? "rays" : ", rays";
  return t;
}

Result<std::shared_ptr<TruthfulSampler>> make_lidar(const SensorSetup& setup, const models::LidarModel& model,
                                                    SensorWorld& world, SensingResources& resources) {
  auto engine = make_engine(setup.choice, resources);
  if (!engine) return tl::unexpected<Error>(engine.error());
  LidarSpec spec{.name = setup.name,
                 .model = model,
                 .seed = setup.seed,
                 .ideal = setup.ideal,
                 .allowed_error_rad = setup.choice.allowed_error_rad};
  if (setup.choice.sub_rays > 0) {
    spec.model.footprint.sub_rays = setup.choice.sub_rays;
    spec.model.footprint.most_sub_rays = 0;
  }
  auto lidar = LidarSimulator::create(spec, timed(*engine, setup.times));
  if (!lidar) return tl::unexpected<Error>(lidar.error());
  return std::make_shared<SensedLidar>(std::move(*lidar), std::move(*engine), setup, world);
}

Result<std::shared_ptr<TruthfulSampler>> make_tof(const SensorSetup& setup, const models::TofModel& model,
                                                  SensorWorld& world, SensingResources& resources) {
  auto engine = make_engine(setup.choice, resources);
  if (!engine) return tl::unexpected<Error>(engine.error());
  TofSpec spec{.name = setup.name,
               .model = model,
               .seed = setup.seed,
               .ideal = setup.ideal,
               .allowed_error_rad = setup.choice.allowed_error_rad};
  if (setup.choice.samples_per_pixel > 0) spec.model.sampling.samples = setup.choice.samples_per_pixel;
  auto tof = TofSimulator::create(spec, timed(*engine, setup.times));
  if (!tof) return tl::unexpected<Error>(tof.error());
  return std::make_shared<SensedTof>(std::move(*tof), std::move(*engine), setup, world);
}

OpticsOptions optics_of(const EngineChoice& choice, const CameraModel& model) {
  OpticsOptions o;
  if (choice.samples_per_pixel > 0) o.samples = PixelSamples::only(choice.samples_per_pixel);
  o.samples.uneven = choice.uneven_samples.value_or(o.samples.uneven);
  o.samples.sky = choice.sky_samples.value_or(o.samples.sky);
  o.sky_rays = choice.sky_rays;
  if (choice.pixel_step > 0) o.pixel_step = choice.pixel_step;
  if (choice.supersampling > 0) o.supersampling = choice.supersampling;
  if (choice.instants > 0) o.instants = choice.instants;
  // An angle at the centre of the picture, in its pixels.
  if (choice.allowed_error_rad > 0) o.allowed_error_px = choice.allowed_error_rad * model.fx_px;
  return o;
}

Result<std::shared_ptr<SensedCamera>> make_camera(const SensorSetup& setup, const CameraModel& model,
                                                  PixelFormat format, Duration exposure, double supersampling,
                                                  SensorWorld& world, SensingResources& resources) {
  SimulatedCameraSpec spec;
  spec.name = setup.name;
  spec.model = model;
  spec.format = light_format(format);
  spec.seed = setup.seed;
  spec.noise = !setup.ideal;
  spec.engine = setup.choice.engine == "rays" ? CameraEngine::rays : CameraEngine::vulkan;
  spec.optics = optics_of(setup.choice, model);
  if (!(setup.choice.supersampling > 0)) spec.optics.supersampling = supersampling;
  CameraEngines engines;
  auto cache = resources.cache();  // ground truth of both engines
  if (!cache) return tl::unexpected<Error>(cache.error());
  engines.cache = *cache;
  if (spec.engine == CameraEngine::vulkan) {
    auto device = resources.device();
    if (!device) return tl::unexpected<Error>(device.error());
    engines.device = *device;
  } else {
    auto light = resources.light();
    if (!light) return tl::unexpected<Error>(light.error());
    engines.light = *light;
  }
  auto camera = SimulatedCamera::create(spec, engines);
  if (!camera) return tl::unexpected<Error>(camera.error());
  return std::make_shared<SensedCameraOfWorld>(std::move(*camera), format, exposure, setup, world);
}

}  // namespace rigor
