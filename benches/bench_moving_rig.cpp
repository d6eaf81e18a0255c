// Where the time of a moving rig's simulated sensors goes: a robot drives along a way, and its cameras,
// time-of-flight cameras and scanners measure when the rig has them do so. Nothing is kept that a run would
// not keep.
//
//   bench_moving_rig [--rig FILE] [--way FILE] [--duration SECONDS] [--speed M_PER_S] [--json FILE]
//
// Stages of a capture: world (bringing the world to the instant), collect (asking it for its content),
// prepare (what is new in that: structures of meshes, batches, the scene), trace (walks of rays through the
// scene), shade (the rest of the light: materials, textures, sun, gathering), sensor (the sensor stage; of a
// LiDAR echoes, of a time-of-flight camera taps). CPU is that of all threads. Rays are traced and shaded in
// turn: the wall time of the two is shared out by their CPU.
#include <charconv>

#include "bench/motion/platforms.h"
#include "bench/sensing/engine_choice.h"
#include "bench/sensing/mount.h"
#include "bench/sensing/sensor_world.h"
#include "bench/sensing/sensors.h"
#include "benches/sensor_bench.h"
#include "sensor-hal/models/camera_yaml.h"
#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "sensor-hal/models/tof/tof_yaml.h"
#include "sensor-hal/rig/rig.h"
#include "sim/render/rays/embree_engine.h"
#include "sim/sensors/camera/simulated_camera.h"
#include "sim/sensors/lidar/lidar_simulator.h"
#include "sim/sensors/tof/tof_simulator.h"

namespace {

using namespace rigor;
using namespace rigor::bench;

struct RigOptions {
  std::string rig = std::string(RIGOR_SOURCE_DIR) + "/configs/rigs/seekurjr-forest.yaml";
  std::string way = std::string(RIGOR_SOURCE_DIR) + "/configs/worlds/data/forest-way.csv";
  std::string json;
  double duration_s = 20, speed_mps = 0.6;
};

double number(const std::string& word, const std::string& text, double low, double high) {
  double v = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), v);
  if (error != std::errc{} || end != text.data() + text.size() || !(v >= low && v <= high))
    give_up(word + ": expected a number from " + std::to_string(low) + " to " + std::to_string(high) +
            ", got " + text);
  return v;
}

RigOptions rig_options(int argc, char** argv) {
  RigOptions o;
  for (int i = 1; i < argc; i += 2) {
    const std::string word = argv[i], value = i + 1 < argc ? argv[i + 1] : "";
    if (word == "--rig")
      o.rig = value;
    else if (word == "--way")
      o.way = value;
    else if (word == "--json")
      o.json = value;
    else if (word == "--duration")
      o.duration_s = number(word, value, 0.1, 3600);
    else if (word == "--speed")
      o.speed_mps = number(word, value, 0, 100);
    else
      give_up(word + ": expected --rig FILE, --way FILE, --duration SECONDS, --speed M_PER_S or --json FILE");
  }
  return o;
}

/// Time that was spent, ms.
struct Spent {
  double wall = 0, cpu = 0;
  Spent& operator+=(const Spent& o) { return wall += o.wall, cpu += o.cpu, *this; }
  friend Spent operator-(Spent a, const Spent& b) { return {a.wall - b.wall, a.cpu - b.cpu}; }
};
/// What `work` takes is added to `to`.
template <class F>
auto spend(Spent& to, F&& work) {
  struct Scope {
    Spent& to;
    Clock::time_point begun = Clock::now();
    double cpu = cpu_ms();
    ~Scope() { to += Spent{bench::ms_since(begun), cpu_ms() - cpu}; }
  } scope{to};
  return work();
}

/// Of one capture.
struct Stages {
  Spent world, collect, prepare, light;
};

class TimedContent final : public render::ContentSource {
 public:
  TimedContent(render::ContentSource& world, Stages& stages) : world_(world), stages_(stages) {}
  std::shared_ptr<const render::ContentWindow> collect(const render::ContentQuery& query, BenchTime begin,
                                                       BenchTime end, int instants) override {
    return spend(stages_.collect, [&] { return world_.collect(query, begin, end, instants); });
  }
  Eigen::Isometry3d T_world_node(world::NodeId node, BenchTime t) const override {
    return world_.T_world_node(node, t);
  }
  std::string type_name(world::NodeId node) const override { return world_.type_name(node); }

 private:
  render::ContentSource& world_;
  Stages& stages_;
};

class TimedEngine final : public render::RayEngine {
 public:
  TimedEngine(std::shared_ptr<render::RayEngine> engine, Stages& stages)
      : engine_(std::move(engine)), stages_(stages) {}
  std::string_view name() const override { return engine_->name(); }
  bool own_origins() const override { return engine_->own_origins(); }
  Status prepare(std::shared_ptr<const render::ContentWindow> window) override {
    return spend(stages_.prepare, [&] { return engine_->prepare(std::move(window)); });
  }
  Status cast(const render::RayQuery& query, std::span<render::Hit> hits) override {
    return spend(stages_.light, [&] { return engine_->cast(query, hits); });
  }
  Status cast_layers(const render::RayQuery& query, render::LayeredHits& hits) override {
    return spend(stages_.light, [&] { return engine_->cast_layers(query, hits); });
  }
  Status occluded(const render::RayQuery& query, std::span<std::uint8_t> hidden) override {
    return spend(stages_.light, [&] { return engine_->occluded(query, hidden); });
  }
  render::EngineStatistics statistics() const override { return engine_->statistics(); }

 private:
  std::shared_ptr<render::RayEngine> engine_;
  Stages& stages_;
};

/// Puts what forming a picture takes, but for the collecting in it, to `prepare` and `light`.
class TimedOptics final : public CameraOpticsPicture {
 public:
  TimedOptics(std::unique_ptr<CameraOpticsPicture> optics, Stages& stages,
              std::shared_ptr<render::RayProfile> profile)
      : optics_(std::move(optics)), stages_(stages), profile_(std::move(profile)) {}
  std::string_view engine() const override { return optics_->engine(); }
  double prepare_ms() const override { return optics_->prepare_ms(); }
  Status form(const OpticsRequest& request, const render::SensorView& view, OpticsPicture& out,
              GroundTruth* truth) override {
    const Spent collected = stages_.collect;
    const std::int64_t prepared_ns = profile_->prepare_ns;
    Spent all;
    const Status s = spend(all, [&] { return optics_->form(request, view, out, truth); });
    const Spent prepare{optics_->prepare_ms(),
                        1e-6 * static_cast<double>(profile_->prepare_ns - prepared_ns)};
    stages_.prepare += prepare;
    stages_.light += all - prepare - (stages_.collect - collected);
    return s;
  }

 private:
  std::unique_ptr<CameraOpticsPicture> optics_;
  Stages& stages_;
  std::shared_ptr<render::RayProfile> profile_;
};

/// A way of straight pieces, driven at an even speed, on the ground.
class Way {
 public:
  explicit Way(const std::string& file) {
    std::ifstream in(file);
    std::string line;
    std::getline(in, line);
    while (std::getline(in, line)) {
      double x = 0, y = 0;
      if (std::sscanf(line.c_str(), "%lf,%lf", &x, &y) != 2 || !std::isfinite(x) || !std::isfinite(y))
        give_up(file + ": expected lines of x_m,y_m, got " + line);
      points_.emplace_back(x, y);
    }
    if (points_.size() < 2) give_up(file + ": expected a way of two points or more");
  }
  /// At a way from its begin; beyond its end, the end.
  [[nodiscard]] BodyState at(double s_m, double speed_mps, BenchTime t, const SensorWorld& world,
                             double above_ground_m) const {
    std::size_t i = 0;
    double length_m = (points_[1] - points_[0]).norm();
    while (s_m > length_m && i + 2 < points_.size()) {
      s_m -= length_m;
      ++i;
      length_m = (points_[i + 1] - points_[i]).norm();
    }
    const Eigen::Vector2d along = (points_[i + 1] - points_[i]).normalized();
    const Eigen::Vector2d p = points_[i] + std::min(s_m, length_m) * along;
    const double yaw = std::atan2(along.y(), along.x());
    BodyState body;
    body.t_ref = t;
    body.T_world_body.position_m = {p.x(), p.y(), world.ground_z_m(p.x(), p.y()) + above_ground_m};
    body.T_world_body.orientation_wxyz = {std::cos(yaw / 2), 0, 0, std::sin(yaw / 2)};
    body.velocity_mps = {speed_mps * along.x(), speed_mps * along.y(), 0};
    return body;
  }

 private:
  std::vector<Eigen::Vector2d> points_;
};

/// A sensor of the rig; `measure` does one capture.
struct RigSensor {
  std::string name;
  Duration period, phase;
  std::unique_ptr<Stages> stages = std::make_unique<Stages>();
  std::shared_ptr<render::RayProfile> profile = std::make_shared<render::RayProfile>();
  std::function<void(const MeasureRequest&, const render::SensorView&)> measure{};
  Mount mount{};
  std::uint64_t captures = 0;
  std::map<std::string, std::vector<Spent>> spent{};
};

class MovingRig {
 public:
  explicit MovingRig(const RigOptions& o)
      : o_(o), rig_(need(load_rig(o.rig))), way_(o.way), cache_(need(render::EmbreeCache::create())) {
    world_ = need(SensorWorld::open(rig_.simulation.world, rig_.simulation.weather, rig_.simulation.plugins));
    platforms_ = need(
        make_platforms(rig_.simulation, world_->ground(), world_->stems(), world_->joint_names().size()));
    if (platforms_.empty()) give_up(o.rig + ": expected a platform");
    for (const WorldPlatform& p : platforms_) need(world_->add_platform(p));
    add_platform_motion(rest_, platforms_.front(), 0, BenchTime());
    const auto& start = rest_.body[0].T_world_body.position_m;
    above_ground_m_ = start[2] - world_->ground_z_m(start[0], start[1]);
    light_ = need(SharedLight::create(cache_));
    for (const ChannelEntry& channel : rig_.channels)
      if (channel.source.backend == "simulated" &&
          (channel.kind == SampleKind::image || channel.kind == SampleKind::range_image ||
           channel.kind == SampleKind::point_cloud))
        add(channel);
    if (sensors_.empty()) give_up(o.rig + ": expected a simulated camera, time-of-flight camera or LiDAR");
  }

  void run() {
    // Before the clock: every sensor once, so that meshes are built which any run builds at its start.
    for (RigSensor& s : sensors_) capture(s, BenchTime(), false);
    while (true) {
      RigSensor* next = nullptr;
      BenchTime when{};
      for (RigSensor& s : sensors_) {
        const BenchTime t = BenchTime() + s.phase + s.period * static_cast<std::int64_t>(s.captures);
        if (!next || t < when) next = &s, when = t;
      }
      if (static_cast<double>(when.ns()) * 1e-9 > o_.duration_s) break;
      capture(*next, when, true);
    }
  }

  void report(nlohmann::json& out) const {
    for (const RigSensor& s : sensors_) {
      if (s.captures == 0) continue;
      std::printf("\n%s: %zu captures at %.1f m/s\n  %-10s %9s %9s %9s %9s %9s\n", s.name.c_str(),
                  s.spent.at("whole").size(), o_.speed_mps, "", "p50 ms", "p99 ms", "CPU ms", "CPU p99",
                  "CPU most");
      for (const char* stage : {"whole", "world", "collect", "prepare", "trace", "shade", "sensor"}) {
        std::vector<double> wall, cpu;
        double cpu_sum = 0;
        for (const Spent& c : s.spent.at(stage)) {
          wall.push_back(c.wall), cpu.push_back(c.cpu);
          cpu_sum += c.cpu;
        }
        const double mean = cpu_sum / static_cast<double>(cpu.size());
        std::printf("  %-10s %9.2f %9.2f %9.2f %9.2f %9.2f\n", stage, Times::quantile(wall, 0.5),
                    Times::quantile(wall, 0.99), mean, Times::quantile(cpu, 0.99), Times::quantile(cpu, 1));
        out["runs"].push_back({{"sensor", s.name},
                               {"stage", stage},
                               {"captures", cpu.size()},
                               {"speed_mps", o_.speed_mps},
                               {"p50_ms", Times::quantile(wall, 0.5)},
                               {"p99_ms", Times::quantile(wall, 0.99)},
                               {"cpu_ms", mean},
                               {"cpu_p99_ms", Times::quantile(cpu, 0.99)},
                               {"cpu_most_ms", Times::quantile(cpu, 1)}});
      }
    }
  }

 private:
  void add(const ChannelEntry& channel) {
    const ConfigNode& params = channel.source.params;
    RigSensor s;
    s.name = channel.name;
    s.period = channel.period;
    s.phase = Duration(static_cast<std::int64_t>(1e3 * params.number_or("phase_us", 0)));
    const auto file = params.base_dir() / params.text("sensor");
    const EngineChoice choice = read_engine_choice(params, channel.kind);
    if (!choice.engine.empty() && choice.engine != "rays")
      give_up(channel.name + ": expected renderer: rays, got " + choice.engine);
    s.mount = read_mount(params, *world_,
                         channel.kind == SampleKind::point_cloud ? SensorAxes::forward : SensorAxes::optical);
    if (channel.kind == SampleKind::image)
      add_camera(s, need(load_camera(file)), choice, params);
    else
      add_sampler(s, channel.kind, file, choice);
    sensors_.push_back(std::move(s));
  }
  void add_camera(RigSensor& s, const CameraSensorModel& sensor, const EngineChoice& choice,
                  const ConfigNode& params) {
    SimulatedCameraSpec spec{.name = s.name, .model = sensor.model, .seed = rig_.seed};
    spec.engine = CameraEngine::rays;
    spec.optics = optics_of(choice, sensor.model);
    if (!light_profile_) {
      light_profile_ = s.profile;
      light_->engine->set_profile(light_profile_);
    }
    s.profile = light_profile_;  // one engine draws for all cameras, one after the other
    std::shared_ptr<SimulatedCamera> camera = need(SimulatedCamera::create(
        spec, std::make_unique<TimedOptics>(need(make_rays_optics(spec.model, spec.optics, light_)),
                                            *s.stages, s.profile)));
    const Duration exposure = seconds_from(params.number_or("exposure_us", 1e6 * sensor.exposure_s) * 1e-6);
    s.measure = [camera, exposure, pixels = std::vector<std::byte>()](
                    const MeasureRequest& request, const render::SensorView& view) mutable {
      CameraCapture c;
      c.measure = request;
      c.exposure = exposure;
      pixels.resize(camera->bytes(c));
      need(camera->capture(c, view, pixels));
    };
  }
  void add_sampler(RigSensor& s, SampleKind kind, const std::filesystem::path& file,
                   const EngineChoice& choice) {
    if (choice.allowed_error_rad > 0)
      give_up(s.name + ": expected everything in full, got allowed_error_rad");
    const auto rays = need(render::EmbreeEngine::create(cache_));
    rays->set_profile(s.profile);
    const auto engine = std::make_shared<TimedEngine>(rays, *s.stages);
    if (kind == SampleKind::point_cloud) {
      LidarSpec spec{.name = s.name, .model = need(load_lidar_model(file)), .seed = rig_.seed};
      if (choice.sub_rays > 0) {
        spec.model.footprint.sub_rays = choice.sub_rays;
        spec.model.footprint.most_sub_rays = 0;
      }
      const std::shared_ptr<LidarSimulator> lidar = need(LidarSimulator::create(spec, engine));
      s.measure = [lidar, points = std::vector<LidarPoint>()](const MeasureRequest& request,
                                                              const render::SensorView& view) mutable {
        need(lidar->capture(request, view, points));
      };
      return;
    }
    TofSpec spec{.name = s.name, .model = need(load_tof_model(file)), .seed = rig_.seed};
    if (choice.samples_per_pixel > 0) spec.model.sampling.samples = choice.samples_per_pixel;
    const std::shared_ptr<TofSimulator> tof = need(TofSimulator::create(spec, engine));
    s.measure = [tof, picture = TofPicture()](const MeasureRequest& request,
                                              const render::SensorView& view) mutable {
      need(tof->capture(request, view, picture));
    };
  }

  void capture(RigSensor& s, BenchTime t, bool counts) {
    *s.stages = {};
    const std::int64_t walked_ns = s.profile->walk_ns;
    Spent whole;
    spend(whole, [&] {
      WorldMotion motion = rest_;
      motion.body[0] = way_.at(o_.speed_mps * static_cast<double>(t.ns()) * 1e-9, o_.speed_mps, t, *world_,
                               above_ground_m_);
      std::optional<SensorWorld::Moment> moment;
      spend(s.stages->world, [&] { moment.emplace(*world_, motion); });
      TimedContent content(*moment, *s.stages);
      s.measure({s.captures, t}, {content, s.mount.T_world_sensor(*moment, BenchTime())});
    });
    if (!counts) return;
    ++s.captures;
    const Stages& of = *s.stages;
    const double trace_cpu =
        std::min(1e-6 * static_cast<double>(s.profile->walk_ns - walked_ns), of.light.cpu);
    const double share = of.light.cpu > 0 ? trace_cpu / of.light.cpu : 0;
    const Spent trace{share * of.light.wall, trace_cpu};
    s.spent["whole"].push_back(whole);
    s.spent["world"].push_back(of.world);
    s.spent["collect"].push_back(of.collect);
    s.spent["prepare"].push_back(of.prepare);
    s.spent["trace"].push_back(trace);
    s.spent["shade"].push_back(of.light - trace);
    s.spent["sensor"].push_back(whole - of.world - of.collect - of.prepare - of.light);
  }

  RigOptions o_;
  RigConfig rig_;
  Way way_;
  std::shared_ptr<render::EmbreeCache> cache_;
  std::unique_ptr<SensorWorld> world_;
  std::vector<WorldPlatform> platforms_;
  WorldMotion rest_;
  double above_ground_m_ = 0;
  std::shared_ptr<SharedLight> light_;
  std::shared_ptr<render::RayProfile> light_profile_;
  std::vector<RigSensor> sensors_;
};

}  // namespace

int main(int argc, char** argv) {
  const RigOptions o = rig_options(argc, argv);
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  MovingRig rig(o);
  nlohmann::json out;
  out["machine"] = machine(nullptr);
  rig.run();
  rig.report(out);
  write(o.json, out);
  return 0;
}
