// What the view renderer's means of drawing less save, and what they cost in the picture.
//
//   bench_view [--trees N] [--side M] [--world N] [--width PX] [--height PX] [--error PX] [--rounds N]
//              [--json FILE]
//
// A wood of N trees on M x M metres (each tree: trunk and 240 alpha-tested leaves, two coarser levels) is
// drawn at width x height, 4 samples, with everything in full, with each means alone turned off, and with all
// on. Beside each time stands how far the picture is from the one in full: RMS and 99.9th percentile of the
// difference in radiance, relative to the mean, and the share of pixels that differ by more than 5 % of
// themselves. Then a world of many trees is loaded, and one tree of it felled.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "sim/render/view/view_renderer.h"
#include "tests/sim/render/view/synthetic_forest.h"

namespace {

using namespace rigor;
using namespace rigor::render;
using Clock = std::chrono::steady_clock;
double ms_since(Clock::time_point t0) {
  return std::chrono::duration<double, std::milli>(Clock::now() - t0).count();
}

[[noreturn]] void give_up(const std::string& what) {
  std::fprintf(stderr, "bench_view: %s\n", what.c_str());
  std::exit(1);
}

struct Options {
  std::size_t trees = 400, world = 100000;
  double side_m = 100, error_px = 1;
  int width_px = 640, height_px = 480, rounds = 5;
  std::string json;
};

Options parse(int argc, char** argv) {
  Options o;
  for (int i = 1; i < argc; ++i) {
    const std::string key = argv[i];
    if (i + 1 >= argc) give_up(key + ": expected a value after it");
    const char* const value = argv[++i];
    const double number = std::atof(value);
    if (key == "--json") {
      o.json = value;
      continue;
    }
    if (!(number > 0)) give_up(key + ": expected a number above 0, got " + value);
    if (key == "--trees")
      o.trees = static_cast<std::size_t>(number);
    else if (key == "--world")
      o.world = static_cast<std::size_t>(number);
    else if (key == "--side")
      o.side_m = number;
    else if (key == "--error")
      o.error_px = number;
    else if (key == "--width")
      o.width_px = static_cast<int>(number);
    else if (key == "--height")
      o.height_px = static_cast<int>(number);
    else if (key == "--rounds")
      o.rounds = static_cast<int>(number);
    else
      give_up(key + ": expected one of the options at the top of bench_view.cpp");
  }
  return o;
}

Eigen::Isometry3d look(const Eigen::Vector3d& eye, const Eigen::Vector3d& to) {
  Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
  const Eigen::Vector3d forward = (to - eye).normalized(),
                        right = forward.cross(Eigen::Vector3d::UnitZ()).normalized();
  t.linear() << right, forward.cross(right), forward;
  t.translation() = eye;
  return t;
}

ContentFrame frame_of(const test::SyntheticForest& f) {
  ContentFrame frame;
  frame.batches = {f.ground};
  frame.batches.insert(frame.batches.end(), f.trees.begin(), f.trees.end());
  auto sky = std::make_shared<SkyMap>();
  sky->width = 32;
  sky->height = 8;
  sky->radiance.assign(256, Spectrum{0.2F, 0.3F, 0.5F, 0.1F, 0.1F, 0.05F});
  frame.light.sky = sky;
  frame.light.direction_to_sun = Eigen::Vector3d(1, -1, 1.2).normalized();
  frame.light.sun_irradiance = {3, 3, 2.8F, 2, 2, 1};
  return frame;
}

struct Difference {
  double rms = 0, p999 = 0, share = 0;
};
Difference difference(const ViewPicture& a, const ViewPicture& full) {
  double sum2 = 0, mean = 0;
  std::size_t pixels_off = 0;
  std::vector<float> all;
  for (std::size_t i = 0; i < a.radiance.size(); i += 4) {
    bool off = false;
    for (std::size_t c = 0; c < 4; ++c) {
      const float d = std::abs(a.radiance[i + c] - full.radiance[i + c]);
      all.push_back(d);
      sum2 += static_cast<double>(d) * static_cast<double>(d);
      mean += static_cast<double>(full.radiance[i + c]);
      off = off || d > 0.05F * full.radiance[i + c];
    }
    pixels_off += off ? 1 : 0;
  }
  const auto n = static_cast<double>(all.size());
  mean /= n;
  const auto k = static_cast<std::size_t>(0.999 * (n - 1));
  std::nth_element(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(k), all.end());
  return {std::sqrt(sum2 / n) / mean, static_cast<double>(all[k]) / mean,
          static_cast<double>(pixels_off) / (n / 4)};
}

struct Timed {
  ViewPicture picture;
  ViewStatistics statistics;
  std::vector<double> ms;
};
Timed draw(ViewRenderer& view, const ContentFrame& frame, const ViewRequest& request, int rounds) {
  Timed t;
  for (int i = 0; i <= rounds; ++i) {  // the first compiles shaders
    const auto begun = Clock::now();
    if (const Status s = view.draw(frame, request, t.picture, &t.statistics); !s) give_up(s.error().text());
    if (i > 0) t.ms.push_back(ms_since(begun));
  }
  std::sort(t.ms.begin(), t.ms.end());
  return t;
}

}  // namespace

int main(int argc, char** argv) {
  const Options o = parse(argc, argv);
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  auto device = Device::create();
  if (!device) give_up(device.error().text());
  auto view = ViewRenderer::create(*device);
  if (!view) give_up(view.error().text());
  nlohmann::json out;
  out["device"] = (*device)->name();

  const ContentFrame wood = frame_of(test::make_forest(o.trees, o.side_m, 32));
  ViewRequest request;
  request.pinhole = {o.width_px,
                     o.height_px,
                     0.8 * o.width_px,
                     0.8 * o.width_px,
                     0.5 * (o.width_px - 1),
                     0.5 * (o.height_px - 1),
                     0.05};
  request.T_world_camera = look({0, -0.5 * o.side_m, 5}, {0, 0, 5});
  request.allowed_error_px = o.error_px;
  const ViewSwitches full{.frustum_culling = false,
                          .occlusion_culling = false,
                          .levels_of_detail = false,
                          .impostors = false,
                          .instancing = false};
  struct Case {
    const char* name;
    ViewSwitches switches;
  };
  std::vector<Case> cases{{"in full", full}, {"all on", {}}};
  cases.push_back({"no frustum culling", {.frustum_culling = false}});
  cases.push_back({"no occlusion culling", {.occlusion_culling = false}});
  cases.push_back({"no levels of detail", {.levels_of_detail = false}});
  cases.push_back({"no impostors", {.impostors = false}});
  cases.push_back({"no instancing", {.instancing = false}});
  cases.push_back({"no shadows", {.shadows = false}});
  std::printf("%zu trees on %.0f x %.0f m, %dx%d, 4 samples, %.1f px allowed, %s\n", o.trees, o.side_m,
              o.side_m, o.width_px, o.height_px, o.error_px, (*device)->name().c_str());
  std::printf("%-22s %8s %8s %10s %6s %9s %8s %8s %8s\n", "", "p50 ms", "max ms", "triangles", "calls",
              "instances", "RMS", "p99.9", ">5 %");
  ViewPicture reference;
  for (const Case& c : cases) {
    request.switches = c.switches;
    const Timed t = draw(**view, wood, request, o.rounds);
    if (reference.radiance.empty()) reference = t.picture;
    const Difference d = difference(t.picture, reference);
    const ViewStatistics& s = t.statistics;
    std::printf("%-22s %8.1f %8.1f %10zu %6zu %9zu %8.4f %8.3f %7.2f%%\n", c.name, t.ms[t.ms.size() / 2],
                t.ms.back(), s.triangles_drawn, s.draw_calls, s.instances_drawn, d.rms, d.p999,
                100 * d.share);
    out["cases"].push_back({{"name", c.name},
                            {"p50_ms", t.ms[t.ms.size() / 2]},
                            {"max_ms", t.ms.back()},
                            {"triangles", s.triangles_drawn},
                            {"draw_calls", s.draw_calls},
                            {"instances", s.instances_drawn},
                            {"impostors", s.impostors_drawn},
                            {"rms", d.rms},
                            {"p999", d.p999},
                            {"differ_5_percent", d.share}});
  }

  // A large world: loaded, then changed by one tree.
  const auto forest = test::make_forest(o.world, 20 * std::sqrt(static_cast<double>(o.world)) / 3, 64);
  ContentFrame world = frame_of(forest);
  request.switches = {.shadows = false};
  request.allowed_error_px = 4;
  request.T_world_camera = look({0, 0, 40}, {0, 200, 0});
  auto fresh = ViewRenderer::create(*device);
  if (!fresh) give_up(fresh.error().text());
  ViewPicture picture;
  ViewStatistics s;
  const auto begun = Clock::now();
  if (const Status ok = (*fresh)->draw(world, request, picture, &s); !ok) give_up(ok.error().text());
  const double load_ms = ms_since(begun), upload_ms = s.upload_ms;
  const std::size_t loaded = s.uploaded_bytes;
  std::vector<double> changes, unchanged;
  for (std::size_t i = 0; i < 20; ++i) {
    if (const Status ok = (*fresh)->draw(world, request, picture, &s); !ok) give_up(ok.error().text());
    unchanged.push_back(s.upload_ms);
    const std::size_t k = 1 + (i * 37) % forest.trees.size();
    auto changed = std::make_shared<Batch>(*world.batches[k]);
    changed->serial = next_serial();
    changed->instances.pop_back();
    changed->nodes.pop_back();
    if (changed->instances.empty()) continue;
    world.batches[k] = changed;
    if (const Status ok = (*fresh)->draw(world, request, picture, &s); !ok) give_up(ok.error().text());
    changes.push_back(s.upload_ms);
  }
  std::sort(changes.begin(), changes.end());
  std::sort(unchanged.begin(), unchanged.end());
  std::printf(
      "\n%zu trees: first picture %.0f ms (upload %.0f ms, %.1f MB); one tree changed reaches the draw data "
      "in p50 %.3f, max %.3f ms "
      "(nothing changed: %.3f ms); %zu instances in view\n",
      o.world, load_ms, upload_ms, static_cast<double>(loaded) / 1e6, changes[changes.size() / 2],
      changes.back(), unchanged[unchanged.size() / 2], s.instances_drawn);
  out["world"] = {{"trees", o.world},
                  {"load_ms", load_ms},
                  {"upload_ms", upload_ms},
                  {"uploaded_bytes", loaded},
                  {"change_p50_ms", changes[changes.size() / 2]},
                  {"change_max_ms", changes.back()},
                  {"no_change_p50_ms", unchanged[unchanged.size() / 2]}};
  if (!o.json.empty()) {
    std::ofstream file(o.json);
    file << out.dump(2) << '\n';
    if (!file) give_up(o.json + ": cannot be written");
  }
  return 0;
}
