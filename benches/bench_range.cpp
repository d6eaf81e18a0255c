// Speed against error of simulated LiDARs and time-of-flight cameras, on three worlds, both engines, over
// their knobs.
//
//   bench_range [--rounds N] [--json FILE] [--place NAME] [--sensor MODEL] [--renderer rays|raster]
//               [--knobs TEXT] [--out DIR]
//   bench_range --out DIR --reference PASSES [--place NAME] [--sensor MODEL]
//
// --knobs: only the rows whose name has this text, as "5 sub-rays, in full".
//
// With --out, what the quick sensors measure without errors goes to NPY files, which range_error.py compares
// with references by 1024 rays a beam or pixel in each pass; --reference makes these
// (benches/range_reference.h).
//
// How wrong the quick sensors are is range_error.py's to say. `x bare` is CPU time over that of Embree alone
// for one ray a beam or pixel, with the same test of leaves, on the same threads.
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <cstdint>
#include <filesystem>

#include "bench/dataset/npy.h"
#include "benches/range_reference.h"
#include "benches/sensor_bench.h"
#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "sensor-hal/models/tof/tof_yaml.h"
#include "sim/render/rays/embree_engine_impl.h"
#include "sim/render/view/raster_engine.h"
#include "sim/sensors/lidar/lidar_simulator.h"
#include "sim/sensors/tof/tof_simulator.h"

namespace {

using namespace rigor;
using namespace rigor::bench;

/// Embree alone: one ray each, first meetings, no more.
double bare_time(render::EmbreeEngine& engine, const Eigen::Vector3d& eye,
                 const std::vector<std::array<float, 3>>& directions, int rounds) {
  const auto scene = need(engine.impl().scene_at(eye));
  const Eigen::Vector3f origin = (eye - scene->origin()).cast<float>();
  std::vector<float> range(directions.size());
  const auto cast = [&](int) {
    engine.impl().arena().execute([&] {
      const std::size_t chunks = (directions.size() + render::kPacketRays - 1) / render::kPacketRays;
      tbb::parallel_for(std::size_t{0}, chunks, [&](std::size_t c) {
        render::RayPackets rays;
        const std::size_t first = c * render::kPacketRays;
        const auto n =
            static_cast<unsigned>(std::min<std::size_t>(render::kPacketRays, directions.size() - first));
        for (unsigned i = 0; i < (n + 7) / 8 * 8; ++i)
          if (i < n)
            rays.set(i, origin.data(), directions[first + i].data(), 0.001F,
                     std::numeric_limits<float>::infinity(), 0);
          else
            rays.skip(i);
        scene->intersect(rays, n, true);
        for (unsigned i = 0; i < n; ++i) range[first + i] = rays.intersection(i).range_m;
      });
    });
  };
  return timed(rounds, cast).cpu();
}

/// What goes to NPY files.
struct Files {
  std::filesystem::path out;  ///< empty: nothing
  int passes = 0;             ///< of references; 0: quick sensors
  std::string knobs;          ///< part of the names of rows that are wanted
};

struct Knobs {
  std::string label;
  bool vulkan = false;
  int rays = 1;  ///< sub-rays or samples
  double allowed_error_rad = 0;
  double pixels_per_rad = 500;
  bool motion = false;
  int most_rays = 0;  ///< where echoes are not clear
};

class Bench {
 public:
  Bench(const Options& o, Files files)
      : rounds_(o.rounds),
        engine_(o.engine),
        sensor_(o.sensor),
        files_(std::move(files)),
        cache_(need(render::EmbreeCache::create())) {
    auto device = render::Device::create();
    if (device) device_ = *device;
    out_["machine"] = machine(device_);
  }
  void place(const Place& place) {
    StandingWorld world(place);
    if (files_.passes > 0) return references(world, place);
    std::printf("\n%s\n%-16s %-36s %9s %9s %7s\n", place.name, "", "", "p50 ms", "cpu ms", "x bare");
    for (const char* sensor : {"velodyne-vlp16", "sick-lms111"})
      if (sensor_.empty() || sensor_ == sensor) lidar(world, place, sensor);
    if (sensor_.empty() || sensor_ == "sr4000") tof(world, place, "sr4000");
  }
  nlohmann::json& out() { return out_; }

 private:
  std::shared_ptr<render::RayEngine> engine(const Knobs& k, const Eigen::Vector3d& eye) {
    if (k.vulkan)
      return need(render::RasterEngine::create(
          device_, {.pixels_per_rad = k.pixels_per_rad, .allowed_error_rad = k.allowed_error_rad}));
    return need(render::EmbreeEngine::create(cache_, {.allowed_error_rad = k.allowed_error_rad, .eye = eye}));
  }
  std::vector<Knobs> knobs(bool tof) const {
    std::vector<Knobs> all;
    for (const int rays : tof ? std::vector<int>{1, 4, 16} : std::vector<int>{1, 5, 13})
      for (const double error : {0.0, 0.004})
        all.push_back(
            {std::to_string(rays) + (tof ? " sample" : " sub-ray") + (rays > 1 ? "s" : "") +
                 (error > 0 ? ", " + std::to_string(static_cast<int>(1000 * error)) + " mrad" : ", in full"),
             false, rays, error});
    if (!tof)
      for (const auto& [few, most] : {std::pair{4, 16}, {4, 32}, {5, 40}})
        all.push_back({.label = std::to_string(few) + " to " + std::to_string(most) + " sub-rays, in full",
                       .rays = few,
                       .most_rays = most});
    if (tof) {
      all.push_back({"1 sample, in full, four instants", false, 1, 0, 0, true});
      all.push_back({"1 sample, 4 mrad, four instants", false, 1, 0.004, 0, true});
      all.push_back({"4 samples, in full, four instants", false, 4, 0, 0, true});
      all.push_back({"4 samples, 4 mrad, four instants", false, 4, 0.004, 0, true});
    }
    if (device_ && engine_ != "rays")
      for (const int rays : tof ? std::vector<int>{1, 4} : std::vector<int>{1, 5})
        all.push_back(
            {std::to_string(rays) + (tof ? " sample" : " sub-ray") + (rays > 1 ? "s" : "") + ", 500 px/rad",
             true, rays, 1.0 / 500, 500});
    std::erase_if(all, [&](const Knobs& k) { return k.label.find(files_.knobs) == std::string::npos; });
    return all;
  }
  void report(const Place& place, const std::string& sensor, const Knobs& k, const Times& t, double bare) {
    std::printf("%-16s %-36s %9.2f %9.2f %7.2f\n", sensor.c_str(),
                ((k.vulkan ? "raster " : "rays ") + k.label).c_str(), t.quantile(0.5), t.cpu(),
                t.cpu() / bare);
    out_["runs"].push_back({{"world", place.name},
                            {"sensor", sensor},
                            {"renderer", k.vulkan ? "raster" : "rays"},
                            {"knobs", k.label},
                            {"p50_ms", t.quantile(0.5)},
                            {"p99_ms", t.quantile(0.99)},
                            {"cpu_ms", t.cpu()},
                            {"times_bare", t.cpu() / bare}});
  }

  static models::LidarModel lidar_model(const std::string& sensor) {
    return need(load_lidar_model(std::string(RIGOR_SOURCE_DIR) + "/configs/sensors/" + sensor + ".yaml"));
  }
  static models::TofModel tof_model(const std::string& sensor) {
    return need(load_tof_model(std::string(RIGOR_SOURCE_DIR) + "/configs/sensors/" + sensor + ".yaml"));
  }
  /// Of a file: "rays-5-sub-rays-1-mrad".
  static std::string name_of(const Knobs& k) {
    std::string name = (k.vulkan ? "raster-" : "rays-") + k.label;
    std::erase(name, ',');
    std::replace(name.begin(), name.end(), '/', '-');
    std::replace(name.begin(), name.end(), ' ', '-');
    return name;
  }
  /// Range (NaN: no return), remission, echoes.
  void write_elements(const Place& place, const std::string& sensor, const std::string& name,
                      const std::vector<Element>& elements, std::vector<std::size_t> shape) const {
    std::vector<float> values;
    for (const Element& e : elements) values.insert(values.end(), {e.range_m, e.remission, e.echoes});
    shape.push_back(3);
    const auto file = files_.out / (std::string(place.name) + "-" + sensor + "-" + name + ".npy");
    const std::string bytes = npy::floats(values, shape);
    std::ofstream out(file, std::ios::binary);
    out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    if (!out) give_up(file.string() + ": cannot be written");
  }

  static std::size_t firing_of(const models::LidarModel& m, const LidarPoint& p) {
    const double column_ns = 1e9 * m.scan.column_period_s;
    const auto column = static_cast<std::size_t>((p.t_offset_ns + 0.5) / std::max(column_ns, 1.0));
    return std::min<std::size_t>(column, m.scan.columns - 1) * m.scan.beams.size() + p.ring;
  }
  /// First returns by firing.
  static std::vector<Element> elements_of(const models::LidarModel& m,
                                          const std::vector<LidarPoint>& points) {
    std::vector<Element> all(m.firings(), {std::nanf(""), 0});
    for (const LidarPoint& p : points) {
      if (p.return_index != 0) continue;
      // Beams of these sensors start on the axis.
      const float z_m = p.z_m - static_cast<float>(m.scan.beams[p.ring].vertical_offset_m);
      all[firing_of(m, p)] = {std::sqrt(p.x_m * p.x_m + p.y_m * p.y_m + z_m * z_m), p.remission};
    }
    return all;
  }
  std::vector<LidarPoint> measure_lidar(StandingWorld& world, const std::string& sensor,
                                        const models::LidarModel& m, const Knobs& k, int rounds,
                                        Times* times) {
    const Eigen::Isometry3d pose = world.T_world_lidar();
    const render::SensorView view{world, [&](BenchTime) { return pose; }};
    auto simulator = need(LidarSimulator::create(
        {.name = sensor, .model = m, .seed = 1, .allowed_error_rad = k.allowed_error_rad},
        engine(k, world.eye())));
    std::vector<LidarPoint> points;
    const Times t = timed(rounds, [&](int i) {
      need(simulator->capture({static_cast<std::uint64_t>(i), {}}, view, points));
    });
    if (times) *times = t;
    return points;
  }

  void references(StandingWorld& world, const Place& place) {
    const auto engine = need(render::EmbreeEngine::create(cache_));
    const auto look = [&](double far_m) {
      render::ContentQuery query;
      query.look_from_cell_of(world.eye());
      query.allowed_error_rad = 0;
      query.far_m = far_m;
      need(engine->prepare(world.collect(query, {}, {}, 1)));
    };
    const auto finish = [&](const std::string& sensor, const Reference& r,
                            const std::vector<std::size_t>& shape, double cpu_before_ms) {
      for (std::size_t pass = 0; pass < r.passes.size(); ++pass)
        write_elements(place, sensor, "reference-" + std::to_string(pass), r.passes[pass], shape);
      write_elements(place, sensor, "reference", r.all, shape);
      std::printf("%-10s %-16s %d passes, %.1f s of CPU\n", place.name, sensor.c_str(), files_.passes,
                  (cpu_ms() - cpu_before_ms) / 1e3);
    };
    for (const char* sensor : {"velodyne-vlp16", "sick-lms111"}) {
      if (!sensor_.empty() && sensor_ != sensor) continue;
      const models::LidarModel model = lidar_model(sensor);
      look(model.range.max_m);
      const double before = cpu_ms();
      check_against_simulator(world, sensor, model, *engine);
      finish(sensor, need(lidar_reference(model, world.T_world_lidar(), *engine, files_.passes)),
             kept_shape(model), before);
    }
    if (!sensor_.empty() && sensor_ != "sr4000") return;
    const models::TofModel model = tof_model("sr4000");
    look(std::numeric_limits<double>::infinity());
    double before = cpu_ms();
    std::vector<tof::Instant> instants{{world.T_world_optical(), 0}};
    finish("sr4000", need(tof_reference(model, instants, *engine, files_.passes)), kept_shape(model), before);
    before = cpu_ms();
    instants.clear();
    for (int m = 0; m < model.exposures(); ++m)
      instants.push_back({moving_pose(world, seconds_from(model.exposure_offset_s(m)).ns()), 0});
    finish("sr4000-moving", need(tof_reference(model, instants, *engine, files_.passes)), kept_shape(model),
           before);
  }
  /// With the rays of the simulator, the reference says what the simulator says; else it would measure
  /// another device.
  void check_against_simulator(StandingWorld& world, const std::string& sensor,
                               const models::LidarModel& model, render::EmbreeEngine& engine) {
    const models::LidarModel few = without_errors(model, 13);
    const auto simulated = elements_of(few, measure_lidar(world, sensor, few, {}, 0, nullptr));
    const auto mine = need(lidar_reference(model, world.T_world_lidar(), engine, 1,
                                           models::footprint_pattern(few.footprint)))
                          .all;
    const auto theirs = kept_firings(model, simulated);
    std::size_t apart = 0;
    for (std::size_t i = 0; i < mine.size(); ++i) {
      const bool a = std::isfinite(mine[i].range_m), b = std::isfinite(theirs[i].range_m);
      apart +=
          a != b || (a && (std::abs(mine[i].range_m - theirs[i].range_m) > 0.001F ||
                           std::abs(mine[i].remission - theirs[i].remission) > 0.01F * theirs[i].remission));
    }
    // Rays that are rounded otherwise pass an edge on its other side.
    if (apart > mine.size() / 200)
      give_up(sensor + ": with the rays of the simulator, " + std::to_string(apart) + " of " +
              std::to_string(mine.size()) + " beams measure something else than it does");
  }

  void lidar(StandingWorld& world, const Place& place, const std::string& sensor) {
    const models::LidarModel model = lidar_model(sensor);
    const auto measure = [&](const models::LidarModel& m, const Knobs& k, int rounds, Times* times) {
      return elements_of(m, measure_lidar(world, sensor, m, k, rounds, times));
    };
    auto bare_engine = need(render::EmbreeEngine::create(cache_, {.eye = world.eye()}));
    render::ContentQuery query;
    query.eye = world.eye();
    query.allowed_error_rad = 0;
    query.far_m = model.range.max_m;
    need(bare_engine->prepare(world.collect(query, {}, {}, 1)));
    std::vector<std::array<float, 3>> directions;
    for (const auto& beam : model.scan.beams)
      for (std::uint32_t c = 0; c < model.scan.columns; ++c) {
        const auto aim = models::rotor_aim(beam, model.scan.azimuth_rad(c));
        const Eigen::Vector3f d = (world.T_world_lidar().linear() *
                                   Eigen::Vector3d(aim.direction[0], aim.direction[1], aim.direction[2]))
                                      .cast<float>();
        directions.push_back({d.x(), d.y(), d.z()});
      }
    const double bare = bare_time(*bare_engine, world.eye(), directions, rounds_);
    for (const Knobs& k : knobs(false)) {
      models::LidarModel full = model;
      full.footprint.sub_rays = k.rays;
      full.footprint.most_sub_rays = k.most_rays;
      Times times;
      measure(full, k, rounds_, &times);
      report(place, sensor, k, times, bare);
      if (files_.out.empty()) continue;
      std::vector<Element> ideal = measure(without_errors(model, k.rays, k.most_rays), k, 0, nullptr);
      models::LidarModel dual = without_errors(model, k.rays, k.most_rays);
      dual.echoes.returns = models::LidarReturns::dual;
      for (const LidarPoint& p : measure_lidar(world, sensor, dual, k, 0, nullptr))
        ideal[firing_of(dual, p)].echoes += 1;
      write_elements(place, sensor, name_of(k), kept_firings(model, ideal), kept_shape(model));
    }
  }

  /// Of a time-of-flight camera that moves: 0.5 m/s along the world's x.
  static Eigen::Isometry3d moving_pose(const StandingWorld& world, std::int64_t t_ns) {
    Eigen::Isometry3d p = world.T_world_optical();
    p.translation().x() += 0.5 * static_cast<double>(t_ns) * 1e-9;
    return p;
  }

  void tof(StandingWorld& world, const Place& place, const std::string& sensor) {
    const models::TofModel model = tof_model(sensor);
    const Eigen::Isometry3d pose = world.T_world_optical();
    const auto measure = [&](const models::TofModel& m, const Knobs& k, int rounds, Times* times) {
      const render::SensorView view{
          world, [&](BenchTime t) { return k.motion ? moving_pose(world, t.ns()) : pose; }};
      auto simulator = need(TofSimulator::create(
          {.name = sensor, .model = m, .seed = 1, .allowed_error_rad = k.allowed_error_rad},
          engine(k, world.eye())));
      TofPicture picture;
      const Times t = timed(rounds, [&](int i) {
        need(simulator->capture({static_cast<std::uint64_t>(i), {}}, view, picture));
      });
      if (times) *times = t;
      std::vector<Element> all;
      for (std::size_t i = 0; i < picture.range_m.size(); ++i)
        all.push_back({picture.range_m[i], picture.amplitude[i]});
      return all;
    };
    auto bare_engine = need(render::EmbreeEngine::create(cache_, {.eye = world.eye()}));
    render::ContentQuery query;
    query.eye = world.eye();
    query.allowed_error_rad = 0;
    need(bare_engine->prepare(world.collect(query, {}, {}, 1)));
    std::vector<std::array<float, 3>> directions;
    for (int v = 0; v < model.height_px; ++v)
      for (int u = 0; u < model.width_px; ++u) {
        const Eigen::Vector3f d = (pose.linear() * Eigen::Vector3d((u - model.cx_px) / model.fx_px,
                                                                   (v - model.cy_px) / model.fy_px, 1)
                                                       .normalized())
                                      .cast<float>();
        directions.push_back({d.x(), d.y(), d.z()});
      }
    const double bare = bare_time(*bare_engine, world.eye(), directions, rounds_);
    for (const Knobs& k : knobs(true)) {
      models::TofModel full = model;
      full.sampling.samples = k.rays;
      Times times;
      measure(full, k, rounds_, &times);
      const std::string named = k.motion ? sensor + "-moving" : sensor;
      report(place, named, k, times, bare);
      if (!files_.out.empty())
        write_elements(place, named, name_of(k),
                       kept_pixels(model, measure(without_errors(model, k.rays), k, 0, nullptr)),
                       kept_shape(model));
    }
  }

  int rounds_;
  std::string engine_, sensor_;
  Files files_;
  std::shared_ptr<render::EmbreeCache> cache_;
  std::shared_ptr<render::Device> device_;
  nlohmann::json out_;
};

}  // namespace

int main(int argc, char** argv) {
  Files files;
  std::vector<char*> others{argv[0]};
  for (int i = 1; i < argc; i += 2) {
    const std::string word = argv[i], value = i + 1 < argc ? argv[i + 1] : "";
    if (word == "--out") {
      files.out = value;
    } else if (word == "--knobs") {
      files.knobs = value;
    } else if (word == "--reference") {
      files.passes = std::atoi(value.c_str());
      if (files.passes < 2) give_up("--reference: expected 2 passes or more, got " + value);
    } else {
      for (int k = i; k < std::min(i + 2, argc); ++k) others.push_back(argv[k]);
    }
  }
  if (files.passes > 0 && files.out.empty()) give_up("--reference: expected --out DIR with it");
  if (!files.out.empty()) std::filesystem::create_directories(files.out);
  const auto o = options(static_cast<int>(others.size()), others.data());
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  Bench bench(o, files);
  for (const Place& p : kPlaces)
    if (o.wants(p)) {
      bench.place(p);
      write(o.json, bench.out());
    }
  return 0;
}
