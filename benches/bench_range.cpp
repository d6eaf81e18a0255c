// Speed against error of simulated LiDARs and time-of-flight cameras, on three worlds, both engines, over
// their knobs.
//
//   bench_range [--rounds N] [--json FILE] [--place NAME] [--sensor MODEL] [--renderer rays|raster]
//
// The reference is the engine of rays over everything in full, with the most sub-rays (LiDAR: 61, time of
// flight: 16 samples a pixel), without noise. Beside each time stands what the same sensor without noise
// gives: RMSE of range of those that lie within 0.2 m of the reference, share of those farther off, of
// returns that are missing, of returns where the reference has none, and the RMS of remission (amplitude)
// relative to the mean. `x bare` is CPU time over that of Embree alone for one ray a beam or pixel, with the
// same test of leaves, on the same threads.
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <cstdint>

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

constexpr double kOutlier_m = 0.2;

struct Errors {
  double range_rmse_m = 0, outlier_rate = 0, missed_rate = 0, false_rate = 0, remission_error = 0;
};
/// One element of a measurement: NaN is no return.
struct Element {
  float range_m, remission;
};
Errors compare(const std::vector<Element>& got, const std::vector<Element>& reference) {
  std::size_t both = 0, outliers = 0, missed = 0, invented = 0, there = 0, inliers = 0;
  double sum2 = 0, remission2 = 0, remission = 0;
  for (std::size_t i = 0; i < reference.size(); ++i) {
    const bool a = std::isfinite(got[i].range_m), b = std::isfinite(reference[i].range_m);
    there += b;
    missed += b && !a;
    invented += a && !b;
    if (!a || !b) continue;
    ++both;
    const double d = static_cast<double>(got[i].range_m) - static_cast<double>(reference[i].range_m);
    if (std::abs(d) > kOutlier_m) {
      ++outliers;
      continue;
    }
    ++inliers;
    sum2 += d * d;
    const double r = static_cast<double>(got[i].remission) - static_cast<double>(reference[i].remission);
    remission2 += r * r;
    remission += static_cast<double>(reference[i].remission);
  }
  const auto share = [](std::size_t n, std::size_t of) {
    return of > 0 ? static_cast<double>(n) / static_cast<double>(of) : 0.0;
  };
  const double n = static_cast<double>(std::max<std::size_t>(inliers, 1));
  return {std::sqrt(sum2 / n), share(outliers, both), share(missed, there), share(invented, got.size()),
          remission > 0 ? std::sqrt(remission2 / n) / (remission / n) : 0};
}

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

struct Knobs {
  std::string label;
  bool vulkan = false;
  int rays = 1;  ///< sub-rays or samples
  double allowed_error_rad = 0;
  double pixels_per_rad = 500;
  bool motion = false;
};

class Bench {
 public:
  explicit Bench(const Options& o)
      : rounds_(o.rounds), engine_(o.engine), sensor_(o.sensor), cache_(need(render::EmbreeCache::create())) {
    auto device = render::Device::create();
    if (device) device_ = *device;
    out_["machine"] = machine(device_);
    out_["about"] = {
        "Error is against the engine of rays over everything in full with the most sub-rays (LiDAR 61, time "
        "of flight 16",
        "samples a pixel), both without noise: range RMSE of those within 0.2 m, outliers beyond that, "
        "returns missing and",
        "invented, RMS of remission (or amplitude) relative to its mean. `× bare` is CPU time over that "
        "of Embree alone for",
        "one ray a beam or pixel with the same test of leaves. Content that stands still is collected once."};
  }
  void place(const Place& place) {
    StandingWorld world(place);
    std::printf("\n%s\n%-16s %-28s %9s %9s %7s %9s %8s %8s %8s %8s\n", place.name, "", "", "p50 ms", "cpu ms",
                "x bare", "RMSE mm", "outl %", "miss %", "false %", "remis %");
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
      for (const double error : {0.0, 0.001, 0.004})
        all.push_back(
            {std::to_string(rays) + (tof ? " samples" : " sub-rays") +
                 (error > 0 ? ", " + std::to_string(static_cast<int>(1000 * error)) + " mrad" : ", in full"),
             false, rays, error});
    if (tof) {
      all.push_back({"1 samples, in full, four instants", false, 1, 0, 0, true});
      all.push_back({"1 samples, 4 mrad, four instants", false, 1, 0.004, 0, true});
      all.push_back({"4 samples, in full, four instants", false, 4, 0, 0, true});
      all.push_back({"4 samples, 4 mrad, four instants", false, 4, 0.004, 0, true});
    }
    if (device_ && engine_ != "rays")
      for (const int pixels : {250, 500, 1000})
        for (const int rays : tof ? std::vector<int>{1, 4} : std::vector<int>{1, 5})
          all.push_back({std::to_string(rays) + (tof ? " samples, " : " sub-rays, ") +
                             std::to_string(pixels) + " px/rad",
                         true, rays, 1.0 / pixels, static_cast<double>(pixels)});
    return all;
  }
  void report(const Place& place, const std::string& sensor, const Knobs& k, const Times& t, double bare,
              const Errors& e) {
    std::printf("%-16s %-28s %9.2f %9.2f %7.2f %9.2f %8.3f %8.3f %8.3f %8.2f\n", sensor.c_str(),
                ((k.vulkan ? "raster " : "rays ") + k.label).c_str(), t.quantile(0.5), t.cpu(),
                t.cpu() / bare, 1e3 * e.range_rmse_m, 100 * e.outlier_rate, 100 * e.missed_rate,
                100 * e.false_rate, 100 * e.remission_error);
    out_["runs"].push_back({{"world", place.name},
                            {"sensor", sensor},
                            {"renderer", k.vulkan ? "raster" : "rays"},
                            {"knobs", k.label},
                            {"p50_ms", t.quantile(0.5)},
                            {"p99_ms", t.quantile(0.99)},
                            {"cpu_ms", t.cpu()},
                            {"bare_cpu_ms", bare},
                            {"times_bare", t.cpu() / bare},
                            {"range_rmse_m", e.range_rmse_m},
                            {"outlier_rate", e.outlier_rate},
                            {"missed_rate", e.missed_rate},
                            {"false_rate", e.false_rate},
                            {"remission_error", e.remission_error}});
  }

  void lidar(StandingWorld& world, const Place& place, const std::string& sensor) {
    const auto model =
        need(load_lidar_model(std::string(RIGOR_SOURCE_DIR) + "/configs/sensors/" + sensor + ".yaml"));
    const Eigen::Isometry3d pose = world.T_world_lidar();
    const render::SensorView view{world, [&](BenchTime) { return pose; }};
    const auto element_of = [&](const std::vector<LidarPoint>& points) {
      std::vector<Element> all(model.firings(), {std::nanf(""), 0});
      const double column_ns = 1e9 * model.scan.column_period_s;
      for (const LidarPoint& p : points) {
        if (p.return_index != 0) continue;
        const auto column = static_cast<std::size_t>((p.t_offset_ns + 0.5) / std::max(column_ns, 1.0));
        const std::size_t i =
            std::min<std::size_t>(column, model.scan.columns - 1) * model.scan.beams.size() + p.ring;
        if (i < all.size()) all[i] = {std::sqrt(p.x_m * p.x_m + p.y_m * p.y_m + p.z_m * p.z_m), p.remission};
      }
      return all;
    };
    const auto without_noise = [&](int sub_rays) {
      models::LidarModel m = model;
      m.noise = {};
      m.remission.noise = m.remission.step = m.range.step_m = 0;
      m.footprint.sub_rays = sub_rays;
      return m;
    };
    std::vector<LidarPoint> points;
    const auto measure = [&](const models::LidarModel& m, const Knobs& k, int rounds, Times* times) {
      auto simulator = need(LidarSimulator::create(
          {.name = sensor, .model = m, .seed = 1, .allowed_error_rad = k.allowed_error_rad},
          engine(k, world.eye())));
      const Times t = timed(rounds, [&](int i) {
        need(simulator->capture({static_cast<std::uint64_t>(i), {}}, view, points));
      });
      if (times) *times = t;
      return element_of(points);
    };
    const auto reference = measure(without_noise(61), {}, 0, nullptr);

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
        const Eigen::Vector3f d =
            (pose.linear() * Eigen::Vector3d(aim.direction[0], aim.direction[1], aim.direction[2]))
                .cast<float>();
        directions.push_back({d.x(), d.y(), d.z()});
      }
    const double bare = bare_time(*bare_engine, world.eye(), directions, rounds_);
    for (const Knobs& k : knobs(false)) {
      models::LidarModel full = model;
      full.footprint.sub_rays = k.rays;
      Times times;
      measure(full, k, rounds_, &times);
      report(place, sensor, k, times, bare,
             compare(measure(without_noise(k.rays), k, 0, nullptr), reference));
    }
  }

  void tof(StandingWorld& world, const Place& place, const std::string& sensor) {
    const auto model =
        need(load_tof_model(std::string(RIGOR_SOURCE_DIR) + "/configs/sensors/" + sensor + ".yaml"));
    const Eigen::Isometry3d pose = world.T_world_optical();
    const auto measure = [&](const models::TofModel& m, const Knobs& k, int rounds, Times* times) {
      const render::SensorView view{world, [&](BenchTime t) {
                                      Eigen::Isometry3d p = pose;
                                      if (k.motion)
                                        p.translation().x() += 0.5 * static_cast<double>(t.ns()) * 1e-9;
                                      return p;
                                    }};
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
    const auto without_noise = [&](int samples) {
      models::TofModel m = model;
      m.pixel.trembling = false;
      m.pixel.range_offset_sigma_m = m.pixel.gain_sigma = m.pixel.read_noise_e = 0;
      m.pixel.adc_bits = 0;
      m.sampling.samples = samples;
      return m;
    };
    const auto reference = measure(without_noise(16), {}, 0, nullptr);
    Knobs motion;
    motion.motion = true;
    const auto moving = measure(without_noise(16), motion, 0, nullptr);
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
      report(place, sensor, k, times, bare,
             compare(measure(without_noise(k.rays), k, 0, nullptr), k.motion ? moving : reference));
    }
  }

  int rounds_;
  std::string engine_, sensor_;
  std::shared_ptr<render::EmbreeCache> cache_;
  std::shared_ptr<render::Device> device_;
  nlohmann::json out_;
};

}  // namespace

int main(int argc, char** argv) {
  const auto o = options(argc, argv);
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  Bench bench(o);
  for (const Place& p : kPlaces)
    if (o.wants(p)) {
      bench.place(p);
      write(o.json, bench.out());
    }
  return 0;
}
