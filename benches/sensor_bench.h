// What the benches of simulated sensors share: the three worlds and where a sensor stands in them, quantiles
// of times, what machine this is.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "bench/world/world_assembly.h"
#include "sim/render/device.h"
#include "sim/render/engine/content_window.h"

namespace rigor::bench {

using Clock = std::chrono::steady_clock;
inline double ms_since(Clock::time_point t0) {
  return std::chrono::duration<double, std::milli>(Clock::now() - t0).count();
}

[[noreturn]] inline void give_up(const std::string& what) {
  std::fprintf(stderr, "bench: %s\n", what.c_str());
  std::exit(1);
}
template <class T>
T need(Result<T> r) {
  if (!r) give_up(r.error().text());
  return std::move(*r);
}
inline void need(const Status& s) {
  if (!s) give_up(s.error().text());
}

struct Times {
  std::vector<double> ms, cpu_ms;
  [[nodiscard]] static double quantile(std::vector<double> v, double q) {
    std::sort(v.begin(), v.end());
    return v.empty() ? 0 : v[static_cast<std::size_t>(q * static_cast<double>(v.size() - 1) + 0.5)];
  }
  [[nodiscard]] double quantile(double q) const { return quantile(ms, q); }
  /// Of all threads, median.
  [[nodiscard]] double cpu() const { return quantile(cpu_ms, 0.5); }
};
inline double cpu_ms() {
  timespec t{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return 1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec);
}
/// Runs once to warm up, then until the middle half of the times lies within a twentieth of the median, at
/// least 5 times (fewer where `rounds` says so), at most `rounds` times, and no longer than kEnough_ms once
/// there are three, or twice that at all.
inline constexpr double kEnough_ms = 1500;
template <class F>
Times timed(int rounds, F&& work) {
  Times t;
  double all_ms = 0;
  for (int i = 0; i <= rounds; ++i) {
    const auto begun = Clock::now();
    const double cpu = cpu_ms();
    work(i);
    if (i == 0) continue;
    t.cpu_ms.push_back(cpu_ms() - cpu);
    t.ms.push_back(ms_since(begun));
    all_ms += t.ms.back();
    if (all_ms > (i >= 3 ? kEnough_ms : 2 * kEnough_ms)) break;
    if (i >= 5 && t.quantile(0.75) - t.quantile(0.25) < 0.05 * t.quantile(0.5)) break;
  }
  return t;
}

/// Where a sensor stands: x, y, height above the ground, and which way it looks.
struct Place {
  const char* name;
  const char* world;  ///< in configs/worlds
  double x, y, above_ground_m, azimuth_rad, elevation_rad;
};
inline constexpr Place kPlaces[] = {{"indoor", "testbed.yaml", -3.0, -2.0, 1.2, 0.6, 0},
                                    {"forest", "forest.import.yaml", 0, -30, 1.8, 1.5, 0.02},
                                    {"landscape", "hills.import.yaml", -60, -120, 2.5, 1.0, 0.0}};

/// A world whose content is collected once for each query: what a rig's sensors do where nothing moves.
class StandingWorld final : public render::ContentSource {
 public:
  explicit StandingWorld(const Place& place) : place_(place) {
    opened_ = need(open_world(std::string(RIGOR_SOURCE_DIR) + "/configs/worlds/" + place.world));
    picture_ = make_world_picture(opened_);
    const double ground = picture_.ground->height_at(place.x, place.y);
    eye_ = {place.x, place.y, (std::isfinite(ground) ? ground : 0.0) + place.above_ground_m};
  }
  [[nodiscard]] const Eigen::Vector3d& eye() const { return eye_; }
  /// LiDAR: x forward, y left, z up.
  [[nodiscard]] Eigen::Isometry3d T_world_lidar() const {
    Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
    t.linear() = Eigen::AngleAxisd(place_.azimuth_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    t.translation() = eye_;
    return t;
  }
  /// Camera: x right, y down, z forward; `right_m` to its right.
  [[nodiscard]] Eigen::Isometry3d T_world_optical(double right_m = 0) const {
    const Eigen::Vector3d forward(std::cos(place_.azimuth_rad) * std::cos(place_.elevation_rad),
                                  std::sin(place_.azimuth_rad) * std::cos(place_.elevation_rad),
                                  std::sin(place_.elevation_rad));
    const Eigen::Vector3d right = forward.cross(Eigen::Vector3d::UnitZ()).normalized();
    Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
    t.linear() << right, forward.cross(right), forward;
    t.translation() = eye_ + right * right_m;
    return t;
  }

  [[nodiscard]] std::shared_ptr<const render::ContentWindow> collect(const render::ContentQuery& query,
                                                                     BenchTime begin, BenchTime end,
                                                                     int) override {
    auto& kept = windows_[key(query)];
    if (!kept) {
      const auto begun = Clock::now();
      render::ContentQuery at = query;
      at.t = BenchTime{};
      kept = std::make_shared<const render::ContentFrame>(picture_.view->collect(at));
      collect_ms_ = ms_since(begun);
    }
    auto window = std::make_shared<render::ContentWindow>();
    window->begin = begin;
    window->end = end;
    window->frames = {kept};
    return window;
  }
  [[nodiscard]] Eigen::Isometry3d T_world_node(world::NodeId, BenchTime) const override {
    return Eigen::Isometry3d::Identity();
  }
  [[nodiscard]] std::string type_name(world::NodeId) const override { return ""; }
  /// Of the last query that was new.
  [[nodiscard]] double collect_ms() const { return collect_ms_; }

 private:
  /// What is asked for, to a metre: a moving eye asks anew when it has gone that far.
  static std::string key(const render::ContentQuery& q) {
    std::string k;
    char text[64];
    for (const double v : {q.eye.x(), q.eye.y(), q.eye.z()}) {
      std::snprintf(text, sizeof text, "%.0f ", v);
      k += text;
    }
    for (const auto& plane : q.frustum) {
      std::snprintf(text, sizeof text, "%.2f %.2f %.2f ", plane.normal().x(), plane.normal().y(),
                    plane.normal().z());
      k += text;
    }
    std::snprintf(text, sizeof text, "%.9f %.0f %.0f", q.allowed_error_rad, q.far_m, q.shadow_reach_m);
    return k + text;
  }
  Place place_;
  OpenedWorld opened_;
  WorldPicture picture_;
  Eigen::Vector3d eye_ = Eigen::Vector3d::Zero();
  std::map<std::string, std::shared_ptr<const render::ContentFrame>> windows_;
  double collect_ms_ = 0;
};

inline nlohmann::json machine(const std::shared_ptr<render::Device>& device) {
  std::string cpu = "unknown";
  std::ifstream info("/proc/cpuinfo");
  for (std::string line; std::getline(info, line);)
    if (line.rfind("model name", 0) == 0) {
      cpu = line.substr(line.find(':') + 2);
      break;
    }
  return {{"cpu", cpu},
          {"threads", std::thread::hardware_concurrency()},
          {"vulkan", device ? device->name() : "none"}};
}

/// `--json FILE`, `--rounds N`, `--place NAME`, `--sensor MODEL`, `--part NAME`, `--renderer rays|raster`;
/// all of them without it.
struct Options {
  std::string json, place, engine, part, sensor;
  int rounds = 20;
  [[nodiscard]] bool wants(const Place& p) const { return place.empty() || place == p.name; }
};
inline Options options(int argc, char** argv) {
  Options o;
  for (int i = 1; i + 1 < argc; i += 2) {
    if (std::string(argv[i]) == "--json")
      o.json = argv[i + 1];
    else if (std::string(argv[i]) == "--place")
      o.place = argv[i + 1];
    else if (std::string(argv[i]) == "--part")
      o.part = argv[i + 1];
    else if (std::string(argv[i]) == "--sensor")
      o.sensor = argv[i + 1];
    else if (std::string(argv[i]) == "--renderer")
      o.engine = argv[i + 1];
    else if (std::string(argv[i]) == "--rounds" && std::atoi(argv[i + 1]) > 0)
      o.rounds = std::atoi(argv[i + 1]);
    else
      give_up(std::string(argv[i]) +
              ": expected --json FILE, --rounds N, --place NAME, --part NAME or --renderer rays|raster");
  }
  return o;
}
inline void write(const std::string& name, const nlohmann::json& out) {
  if (name.empty()) return;
  std::ofstream file(name);
  file << out.dump(2) << '\n';
  if (!file) give_up(name + ": cannot be written");
}

}  // namespace rigor::bench
