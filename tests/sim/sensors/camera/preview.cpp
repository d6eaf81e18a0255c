// Makes pictures of a world as a simulated camera takes them, with each effect alone and with all of them, by
// both engines, and says what each costs and how far it is from the rays engine with many samples. To be
// looked at.
//
//   camera_preview WORLD OUT_DIR [--eye x y z] [--target x y z] [--size w h] [--samples n] [--reference n]
//                  [--repeat n] [--only effect,effect] …
#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "bench/world/world_assembly.h"
#include "sim/render/view/tone_map.h"
#include "sim/sensors/camera/camera_optics_picture.h"
#include "sim/sensors/camera_simulator.h"
#include "sim/world/world_yaml.h"

using namespace rigor;

namespace {

/// Says what collecting costs.
struct Timed final : render::ContentSource {
  explicit Timed(render::ContentSource& of) : world(of) {}
  std::shared_ptr<const render::ContentWindow> collect(const render::ContentQuery& query, BenchTime begin,
                                                       BenchTime end, int instants) override {
    const auto t0 = std::chrono::steady_clock::now();
    auto w = world.collect(query, begin, end, instants);
    ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - t0).count();
    return w;
  }
  Eigen::Isometry3d T_world_node(render::NodeId n, BenchTime t) const override {
    return world.T_world_node(n, t);
  }
  std::string type_name(render::NodeId n) const override { return world.type_name(n); }
  render::ContentSource& world;
  double ms = 0;
};

struct Effect {
  const char* name;
  void (*apply)(CameraModel&);
  bool moves;
};

void lens(CameraModel& m) { m.lens = {.k1 = -0.28, .k2 = 0.09, .p1 = 0.0008, .p2 = -0.0005}; }
void fisheye(CameraModel& m) {
  m.projection = Projection::kannala_brandt;
  m.fx_px = m.fy_px = 0.32 * m.width_px;
  m.fisheye = {.k1 = -0.02, .k2 = 0.003};
}
void chromatic(CameraModel& m) { m.chromatic.magnification = {1.004, 1, 0.995}; }
void focus(CameraModel& m) {
  m.depth_of_field = {.focus_distance_m = 2.5, .focal_length_m = 0.012};
  m.optics.f_number = 2;
  m.optics.pixel_pitch_m = 4.8e-6 * 640 / m.width_px;
}
void focus_colours(CameraModel& m) {
  focus(m);
  m.chromatic.focus_shift_m = {0.3, 0, -0.3};
}
void blur(CameraModel& m) { m.shutter.motion_blur = true; }
void rolling(CameraModel& m) { m.shutter.line_time_s = 0.03 / m.height_px; }
void all(CameraModel& m) {
  lens(m);
  chromatic(m);
  focus_colours(m);
  blur(m);
  rolling(m);
}

constexpr Effect kEffects[] = {
    {"ideal", [](CameraModel&) {}, false},
    {"lens", lens, false},
    {"fisheye", fisheye, false},
    {"chromatic", chromatic, false},
    {"focus", focus, false},
    {"focus_colours", focus_colours, false},
    {"blur", blur, true},
    {"rolling", rolling, true},
    {"all", all, true},
};

double cpu_ms() {
  rusage u{};
  getrusage(RUSAGE_SELF, &u);
  return 1e3 * static_cast<double>(u.ru_utime.tv_sec + u.ru_stime.tv_sec) +
         1e-3 * static_cast<double>(u.ru_utime.tv_usec + u.ru_stime.tv_usec);
}

struct Cost {
  double wall_ms = 1e300, cpu = 1e300;
};

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) return std::fprintf(stderr, "camera_preview WORLD OUT_DIR …\n"), 2;
  Eigen::Vector3d eye(-0.2, -2.4, 1.5), target(0, 0, 0.45);
  int width = 640, height = 480, samples = 1, reference = 0, repeat = 3;
  std::string only;
  OpticsOptions options;
  bool device_ok = true, rays_ok = true;
  for (int i = 3; i < argc; ++i) {
    const auto is = [&](const char* name) { return std::strcmp(argv[i], name) == 0; };
    const auto number = [&] { return ++i < argc ? std::atof(argv[i]) : 0.0; };
    if (is("--eye"))
      for (int k = 0; k < 3; ++k) eye[k] = number();
    else if (is("--target"))
      for (int k = 0; k < 3; ++k) target[k] = number();
    else if (is("--size"))
      width = static_cast<int>(number()), height = static_cast<int>(number());
    else if (is("--samples"))
      samples = static_cast<int>(number());
    else if (is("--reference"))
      reference = static_cast<int>(number());
    else if (is("--repeat"))
      repeat = static_cast<int>(number());
    else if (is("--sky-rays"))
      options.sky_rays = static_cast<int>(number());
    else if (is("--instants"))
      options.instants = static_cast<int>(number());
    else if (is("--supersampling"))
      options.supersampling = number();
    else if (is("--view-samples"))
      options.view_samples = static_cast<int>(number());
    else if (is("--no-shadows"))
      options.shadows = false;
    else if (is("--no-vulkan"))
      device_ok = false;
    else if (is("--no-rays"))
      rays_ok = false;
    else if (is("--only"))
      only = ++i < argc ? argv[i] : "";
    else
      return std::fprintf(stderr, "unknown %s\n", argv[i]), 2;
  }
  auto opened = open_world(argv[1]);
  if (!opened) return std::fprintf(stderr, "%s\n", opened.error().text().c_str()), 1;
  const auto picture = make_world_picture(*opened);
  if (eye.z() < 100 && std::isfinite(picture.ground->height_at(eye.x(), eye.y()))) {
    const double z = picture.ground->height_at(eye.x(), eye.y());
    eye.z() += z;
    target.z() += z;
  }
  render::ViewContent view_content(*opened->db, *picture.view);
  Timed content(view_content);
  std::shared_ptr<render::Device> device;
  if (device_ok)
    if (auto made = render::Device::create({})) device = *made;
  std::shared_ptr<render::EmbreeCache> cache;
  if (rays_ok || reference > 0)
    if (auto made = render::EmbreeCache::create()) cache = *made;
  const Eigen::Isometry3d still = look_at(eye, target);
  const render::PoseFunction moving = [&](BenchTime t) {
    const double s = (t - BenchTime(0)).seconds();
    Eigen::Isometry3d T = still;
    T.linear() = still.linear() * Eigen::AngleAxisd(0.8 * s, Eigen::Vector3d::UnitY()).toRotationMatrix();
    T.translation() += 0.5 * s * still.linear().col(0);
    return T;
  };
  double scale = 0;
  std::printf("%-14s %-7s %9s %9s %9s %9s %9s\n", "effect", "renderer", "wall ms", "cpu ms", "collect",
              "rms %", "p95 %");
  for (const Effect& e : kEffects) {
    if (!only.empty() && ("," + only + ",").find(std::string(",") + e.name + ",") == std::string::npos)
      continue;
    CameraModel model;
    model.width_px = width;
    model.height_px = height;
    model.fx_px = model.fy_px = 620.0 * width / 640;
    model.cx_px = 0.5 * (width - 1);
    model.cy_px = 0.5 * (height - 1);
    e.apply(model);
    OpticsRequest request;
    request.exposure_s = 0.02;
    render::SensorView view{content,
                            e.moves ? moving : render::PoseFunction([&](BenchTime) { return still; })};
    std::vector<float> truth;
    const auto shoot = [&](const char* engine, CameraOpticsPicture& optics, int times) {
      OpticsPicture out;
      Cost cost;
      for (int k = 0; k < times; ++k) {
        const auto t0 = std::chrono::steady_clock::now();
        const double c0 = cpu_ms();
        if (auto s = optics.form(request, view, out); !s) {
          std::printf("%-14s %-7s %s\n", e.name, engine, s.error().text().c_str());
          return;
        }
        cost.cpu = std::min(cost.cpu, cpu_ms() - c0);
        cost.wall_ms = std::min(
            cost.wall_ms,
            std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - t0).count());
      }
      render::ViewPicture p{out.width_px, out.height_px, out.radiance, {}, {}};
      if (scale == 0) scale = render::exposure_scale(p);
      auto rgb = render::tone_map(p, {.exposure = render::ToneMapOptions::Exposure::fixed, .scale = scale});
      for (std::size_t i = 0; i + 2 < rgb.size(); i += 3) std::swap(rgb[i], rgb[i + 2]);
      cv::imwrite(std::string(argv[2]) + "/" + e.name + "_" + engine + ".png",
                  cv::Mat(out.height_px, out.width_px, CV_8UC3, rgb.data()));
      if (truth.empty() && std::strcmp(engine, "ref") == 0) truth = out.radiance;
      double sum = 0, mean = 0;
      std::vector<double> off;
      if (truth.size() == out.radiance.size())
        for (std::size_t i = 0; i < truth.size(); ++i) {
          if (i % 4 == 3) continue;
          const double d = static_cast<double>(out.radiance[i]) - static_cast<double>(truth[i]);
          sum += d * d;
          mean += static_cast<double>(truth[i]);
          off.push_back(std::abs(d));
        }
      const auto n = static_cast<double>(off.size());
      std::sort(off.begin(), off.end());
      std::printf("%-14s %-7s %9.1f %9.1f %9.1f %9.2f %9.2f\n", e.name, engine, cost.wall_ms, cost.cpu,
                  content.ms, off.empty() ? 0 : 100 * std::sqrt(sum / n) / (mean / n),
                  off.empty() ? 0 : 100 * off[static_cast<std::size_t>(0.95 * n)] / (mean / n));
      std::fflush(stdout);
    };
    if (reference > 0) {
      OpticsOptions many = options;
      many.samples = PixelSamples::only(reference);
      many.allowed_error_px = 0;
      if (auto o = make_rays_optics(model, many, cache)) shoot("ref", **o, 1);
    }
    if (rays_ok) {
      OpticsOptions o = options;
      o.samples = PixelSamples::only(samples);
      if (auto optics = make_rays_optics(model, o, cache)) shoot("rays", **optics, repeat);
    }
    // The bench's small renderer, lens and sensor included, where the world is a scene of boxes.
    if (!e.moves && std::strcmp(e.name, "ideal") == 0)
      if (auto scene = world::load_world(argv[1])) {
        auto shared = std::make_shared<const world::Scene>(std::move(*scene));
        auto old = CameraSimulator::create({.name = "old", .model = model, .T_parent_sensor = still}, shared);
        world::WorldSnapshot snapshot(*shared);
        if (old) {
          std::vector<std::byte> bytes((*old)->full_region_bytes());
          Cost cost;
          for (int k = 0; k < 10; ++k) {
            const auto t0 = std::chrono::steady_clock::now();
            const double c0 = cpu_ms();
            if (!(*old)->capture({.exposure = milliseconds(4)}, snapshot, bytes)) break;
            cost.cpu = std::min(cost.cpu, cpu_ms() - c0);
            cost.wall_ms = std::min(
                cost.wall_ms,
                std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - t0).count());
          }
          cv::imwrite(std::string(argv[2]) + "/ideal_small.png",
                      cv::Mat(height, width, CV_8UC1, bytes.data()));
          std::printf("%-14s %-7s %9.1f %9.1f\n", e.name, "small", cost.wall_ms, cost.cpu);
        }
      }
    if (device) {
      auto optics = make_vulkan_optics(model, options, device);
      if (optics)
        shoot("vulkan", **optics, repeat);
      else
        std::printf("%s\n", optics.error().text().c_str());
    }
  }
  return 0;
}
