// What a simulated camera costs, effect by effect, and how wrong the fast picture is.
//
//   bench_camera [--rounds N] [--json FILE] [--place NAME] [--renderer rays]
//               [--part effects|stereo|together|small]
//
// 640x480 pixels, two worlds, both engines. `RMS` is that of the picture on the sensor's surface (before
// noise) against brute force: the engine of rays with 32 samples a pixel over area, aperture and exposure,
// relative to the mean radiance; in the forest for no effect and for all of them. How far light itself is
// from the truth is bench_light's question. Then a stereo pair, and stereo pair, time-of-flight camera and 2D
// scanner together, one after the other. `small`, only where it is asked for, is the demo's camera in its
// small scene, 480x360 pixels, while the turntable turns.
#include "benches/sensor_bench.h"
#include "sensor-hal/models/camera_yaml.h"
#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "sensor-hal/models/tof/tof_yaml.h"
#include "sim/sensors/camera/simulated_camera.h"
#include "sim/sensors/camera_simulator.h"
#include "sim/sensors/lidar/lidar_simulator.h"
#include "sim/sensors/tof/tof_simulator.h"
#include "sim/world/world_yaml.h"

namespace {

using namespace rigor;
using namespace rigor::bench;

constexpr int kReferenceSamples = 32;
constexpr const char* kEvery2nd = ", every 2nd pixel";
constexpr double kSpeed_m_per_s = 1.0;  ///< of the camera, to its right, where motion is asked for

struct Effect {
  const char* name;
  bool moving = false;
  bool optics = true;  ///< changes the picture on the sensor's surface
  void (*set)(CameraModel&);
};
void all_effects(CameraModel& m);
const Effect kEffects[] = {
    {"none", false, true, [](CameraModel&) {}},
    {"distortion", false, true, [](CameraModel& m) { m.lens = {.k1 = -0.2, .k2 = 0.06}; }},
    {"chromatic aberration", false, true,
     [](CameraModel& m) {
       m.chromatic.magnification = {1.001, 1, 0.999};
     }},
    {"depth of field", false, true,
     [](CameraModel& m) {
       m.optics.f_number = 2;
       m.depth_of_field.focus_distance_m = 4;
     }},
    {"motion blur", true, true, [](CameraModel& m) { m.shutter.motion_blur = true; }},
    {"rolling shutter", true, true, [](CameraModel& m) { m.shutter.line_time_s = 30e-6; }},
    {"bloom", false, false,
     [](CameraModel& m) {
       m.bloom.fraction = 0.05;
       m.bloom.veiling_glare = 0.01;
     }},
    {"vignetting", false, false, [](CameraModel& m) { m.vignetting.cos4_weight = 1; }},
    {"noise", false, false, [](CameraModel&) {}},
    {"all", true, true, all_effects}};
void all_effects(CameraModel& m) {
  for (const Effect& e : kEffects)
    if (e.set != all_effects) e.set(m);
}

double rms(const OpticsPicture& a, const OpticsPicture& reference) {
  double sum2 = 0, mean = 0;
  for (std::size_t i = 0; i < reference.radiance.size(); ++i) {
    const double d = static_cast<double>(a.radiance[i]) - static_cast<double>(reference.radiance[i]);
    sum2 += d * d;
    mean += static_cast<double>(reference.radiance[i]);
  }
  const auto n = static_cast<double>(std::max<std::size_t>(reference.radiance.size(), 1));
  return mean > 0 ? std::sqrt(sum2 / n) / (mean / n) : 0;
}

class Bench {
 public:
  explicit Bench(const Options& o) : rounds_(std::min(o.rounds, 5)), engine_(o.engine), part_(o.part) {
    engines_.cache = need(render::EmbreeCache::create());
    auto device = render::Device::create();
    if (device) engines_.device = *device;
    out_["machine"] = machine(engines_.device);
    out_["about"] = {
        "640x480 pixels. RMS is that of the radiance on the sensor's surface against the engine of rays with "
        "32 samples a pixel,",
        "relative to the mean. The time is that of the whole picture, from the content to the bytes."};
  }
  nlohmann::json& out() { return out_; }

  void place(const Place& place) {
    StandingWorld world(place);
    std::printf("\n%s\n%-24s %-40s %9s %9s %8s\n", place.name, "", "", "p50 ms", "cpu ms", "RMS");
    const auto wanted = [&](const char* part) { return part_.empty() || part_ == part; };
    if (wanted("effects"))
      for (const Effect& e : kEffects) effect(world, place, e);
    if (wanted("stereo")) stereo(world, place);
    if (wanted("together")) together(world, place);
  }

  void small(int rounds) {
    const std::string configs = std::string(RIGOR_SOURCE_DIR) + "/configs/";
    const auto scene =
        std::make_shared<const world::Scene>(need(world::load_world(configs + "worlds/turntable.yaml")));
    const auto sensor = need(load_camera(configs + "sensors/demo-camera.yaml", 0));
    world::WorldSnapshot snapshot(*scene);
    snapshot.joints[*world::find_node(*scene, "turntable")] = {BenchTime(), 0, 0.5};
    for (const PixelFormat format : {PixelFormat::mono8, PixelFormat::bayer_rg8, PixelFormat::rgb8}) {
      CameraSpec spec;
      spec.name = "right", spec.model = sensor.model, spec.format = format;
      spec.T_parent_sensor = look_at({0.2, -3, 1.6}, {0, 0, 0.4});
      auto camera = need(CameraSimulator::create(spec, scene));
      std::vector<std::byte> pixels(camera->full_region_bytes());
      const Times t = timed(rounds, [&](int i) {
        need(camera->capture({.capture_index = static_cast<std::uint64_t>(i),
                              .t_capture = BenchTime(i * 40'000'000ll),
                              .exposure = milliseconds(4)},
                             snapshot, pixels));
      });
      report({"turntable", "turntable.yaml", 0, 0, 0, 0, 0}, "small scene", "scene",
             std::string(pfnc_name(format)), t, std::nullopt);
    }
  }

 private:
  struct Shot {
    Times times;
    OpticsPicture picture;
  };
  static CameraModel model(const Effect& e) {
    CameraModel m;
    m.noise.full_well_e = 20000;
    e.set(m);
    return m;
  }
  static render::PoseFunction pose(const StandingWorld& world, bool moving, double right_m = 0) {
    const Eigen::Isometry3d at = world.T_world_optical(right_m);
    return [at, moving](BenchTime t) {
      Eigen::Isometry3d p = at;
      if (moving)
        p.translation() += p.linear().col(0) * (kSpeed_m_per_s * static_cast<double>(t.ns()) * 1e-9);
      return p;
    };
  }
  Shot shoot(StandingWorld& world, const Effect& e, CameraEngine engine, const OpticsOptions& optics,
             int rounds) {
    SimulatedCameraSpec spec{.name = "bench", .model = model(e), .engine = engine, .optics = optics};
    spec.noise = std::string_view(e.name) == "noise" || e.set == all_effects;
    auto camera = need(SimulatedCamera::create(spec, engines_));
    CameraCapture capture;
    std::vector<std::byte> pixels(camera->bytes(capture));
    Shot s;
    const render::SensorView view{world, pose(world, e.moving)};
    s.times = timed(rounds, [&](int i) {
      capture.measure.index = static_cast<std::uint64_t>(i);
      need(camera->capture(capture, view, pixels));
    });
    s.picture = camera->picture();
    return s;
  }
  void report(const Place& place, const std::string& question, const std::string& engine,
              const std::string& label, const Times& t, std::optional<double> error) {
    std::printf("%-24s %-40s %9.1f %9.1f %8s\n", question.c_str(), (engine + " " + label).c_str(),
                t.quantile(0.5), t.cpu(), error ? std::to_string(*error).substr(0, 7).c_str() : "");
    nlohmann::json run{
        {"world", place.name},       {"question", question},       {"renderer", engine}, {"knobs", label},
        {"p50_ms", t.quantile(0.5)}, {"p99_ms", t.quantile(0.99)}, {"cpu_ms", t.cpu()},  {"rms", nullptr}};
    if (error) run["rms"] = *error;
    out_["runs"].push_back(run);
  }
  static OpticsOptions by_rays(int samples, int step = 1) {
    OpticsOptions o;
    o.samples = PixelSamples::only(samples);
    o.pixel_step = step;
    return o;
  }

  void effect(StandingWorld& world, const Place& place, const Effect& e) {
    const bool all = e.set == all_effects, none = std::string_view(e.name) == "none";
    const bool indoors = std::string_view(place.name) == "indoor";
    const bool judged = e.optics && (indoors || all || none);
    std::optional<OpticsPicture> reference;
    if (judged) reference = shoot(world, e, CameraEngine::rays, by_rays(kReferenceSamples), 0).picture;
    const auto by = [&](const std::string& label, const OpticsOptions& o,
                        CameraEngine engine = CameraEngine::rays) {
      const Shot s = shoot(world, e, engine, o, rounds_);
      report(place, e.name, engine == CameraEngine::rays ? "rays" : "raster", label, s.times,
             reference ? std::optional(rms(s.picture, *reference)) : std::nullopt);
    };
    by("1 sample", by_rays(1));
    if (judged) by("as by default", {});
    if (judged) by("4 samples", by_rays(4));
    if (all || none) by("1 sample, every 2nd pixel", by_rays(1, 2));
    if (all || std::string_view(e.name) == "chromatic aberration") {
      OpticsOptions o = by_rays(1);
      o.trace_colours = true;
      by("1 sample, colours traced", o);
    }
    // In the forest it takes seconds a picture.
    if (engines_.device && engine_ != "rays" && judged && (indoors || none)) by("", {}, CameraEngine::vulkan);
  }
  struct Pair {
    std::unique_ptr<StereoCamera> cameras;
    std::vector<std::byte> left, right;
    void capture(StandingWorld& world, int i) {
      CameraCapture c;
      c.measure.index = static_cast<std::uint64_t>(i);
      need(cameras->capture(c, world, {pose(world, true, -0.06), left}, {pose(world, true, 0.06), right}));
    }
  };
  Pair pair(int step) {
    SimulatedCameraSpec left{.name = "left",
                             .model = model(kEffects[std::size(kEffects) - 1]),
                             .engine = CameraEngine::rays,
                             .optics = by_rays(1, step)};
    SimulatedCameraSpec right = left;
    right.name = "right";
    Pair p{need(StereoCamera::create(left, right, engines_)), {}, {}};
    p.left.resize(p.cameras->left().bytes({}));
    p.right.resize(p.left.size());
    return p;
  }
  void stereo(StandingWorld& world, const Place& place) {
    for (const int step : {1, 2}) {
      Pair p = pair(step);
      const Times t = timed(rounds_, [&](int i) { p.capture(world, i); });
      report(place, "stereo pair", "rays", std::string("all effects, 1 sample") + (step > 1 ? kEvery2nd : ""),
             t, std::nullopt);
    }
  }
  void together(StandingWorld& world, const Place& place) {
    // As exact as they can be at their number of rays, and as fast as is still about as exact.
    together(world, place, 1, 0, 4, "all effects, moving");
    together(world, place, 2, 0.001, 4, std::string("all effects, moving") + kEvery2nd + ", ToF 1 mrad");
    together(world, place, 2, 0.004, 1,
             std::string("all effects, moving") + kEvery2nd + ", ToF 4 mrad, 1 sample");
  }
  void together(StandingWorld& world, const Place& place, int step, double allowed_rad, int tof_samples,
                const std::string& label) {
    const std::string sensors = std::string(RIGOR_SOURCE_DIR) + "/configs/sensors/";
    const auto engine = [&] {
      return need(render::EmbreeEngine::create(engines_.cache,
                                               {.allowed_error_rad = allowed_rad, .eye = world.eye()}));
    };
    models::TofModel tof_model = need(load_tof_model(sensors + "sr4000.yaml"));
    tof_model.sampling.samples = tof_samples;
    auto tof = need(TofSimulator::create(
        {.name = "tof", .model = tof_model, .seed = 1, .allowed_error_rad = allowed_rad}, engine()));
    auto scanner = need(LidarSimulator::create({.name = "scanner",
                                                .model = need(load_lidar_model(sensors + "sick-lms111.yaml")),
                                                .seed = 1,
                                                .allowed_error_rad = allowed_rad},
                                               engine()));
    Pair p = pair(step);
    TofPicture ranges;
    std::vector<LidarPoint> points;
    const Eigen::Isometry3d mount = world.T_world_lidar();
    const Times t = timed(rounds_, [&](int i) {
      const MeasureRequest request{static_cast<std::uint64_t>(i), {}};
      p.capture(world, i);
      need(tof->capture(request, {world, pose(world, true)}, ranges));
      need(scanner->capture(request, {world, [&](BenchTime) { return mount; }}, points));
    });
    report(place, "stereo, ToF, 2D scanner", "rays", label, t, std::nullopt);
  }

  int rounds_;
  std::string engine_, part_;
  CameraEngines engines_;
  nlohmann::json out_;
};

}  // namespace

int main(int argc, char** argv) {
  auto o = options(argc, argv);
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  Bench bench(o);
  if (o.part == "small") {
    bench.small(std::max(o.rounds, 100));
    write(o.json, bench.out());
    return 0;
  }
  for (const Place* p : {&kPlaces[0], &kPlaces[1]})
    if (o.wants(*p)) {
      bench.place(*p);
      write(o.json, bench.out());
    }
  return 0;
}
