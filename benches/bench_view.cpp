// What the view renderer's means of drawing less save, and what they cost in the picture; and how long a
// change takes.
//
//   bench_view [--world FILE] [--eye-north M] [--trees N] [--width PX] [--height PX] [--error PX] [--rounds
//   N] [--json FILE]
//
// A world (default: the hectare of forest in configs/worlds) is drawn at width x height, 4 samples, with
// everything in full, with each means alone turned off, and with all on. Beside each time stands how far the
// picture is from the one in full: RMS and 99.9th percentile of the difference in radiance, relative to the
// mean, and the share of pixels that differ by more than 5 % of themselves. Then a world file of N trees is
// loaded, and single trees of it change.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "bench/world/world_assembly.h"
#include "sim/render/view/view_renderer.h"
#include "sim/world/semantic_types.h"
#include "sim/world/store/world_file.h"

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
  std::string world = RIGOR_SOURCE_DIR "/configs/worlds/forest.import.yaml";
  std::size_t trees = 100000;
  double eye_north_m = -75, error_px = 1;
  int width_px = 640, height_px = 480, rounds = 1;
  std::string json;
};

Options parse(int argc, char** argv) {
  Options o;
  for (int i = 1; i < argc; ++i) {
    const std::string key = argv[i];
    if (i + 1 >= argc) give_up(key + ": expected a value after it");
    const char* const value = argv[++i];
    const double number = std::atof(value);
    if (key == "--json")
      o.json = value;
    else if (key == "--world")
      o.world = value;
    else if (key == "--eye-north")
      o.eye_north_m = number;
    else if (!(number > 0))
      give_up(key + ": expected a number above 0, got " + value);
    else if (key == "--trees")
      o.trees = static_cast<std::size_t>(number);
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
  double collect_ms = 0;  ///< once the providers have what they need
  std::vector<double> ms;
};
/// `rounds` 0: once, with what the first time costs. Else after two, in which shadows are drawn that are
/// kept.
Timed draw(ViewRenderer& view, WorldView& world, const ViewRequest& request, int rounds) {
  Timed t;
  const auto query = ViewRenderer::query_for(request);
  constexpr int kUncounted = 2;
  for (int i = rounds == 0 ? kUncounted : 0; i < kUncounted + std::max(rounds, 1); ++i) {
    auto begun = Clock::now();
    const ContentFrame frame = world.collect(query);
    t.collect_ms = ms_since(begun);
    begun = Clock::now();
    if (const Status s = view.draw(frame, request, t.picture, &t.statistics); !s) give_up(s.error().text());
    if (i >= kUncounted) t.ms.push_back(ms_since(begun));
  }
  std::sort(t.ms.begin(), t.ms.end());
  return t;
}

double median(std::vector<double> v) {
  std::sort(v.begin(), v.end());
  return v.empty() ? 0 : v[v.size() / 2];
}

/// A flat world of n trees of eight species, on disk.
void write_forest(const std::filesystem::path& file, std::size_t n) {
  auto db = world::Database::create();
  if (const auto s = world::define_semantic_types(*db); !s) give_up(s.error().text());
  const world::types::Tree tree(db->schema());
  const char* const species[] = {"TSHE", "PSME", "THPL", "ABAM", "PIAB", "FASY", "QURO", "BEPE"};
  auto tx = db->begin("plant");
  const auto side = static_cast<std::size_t>(std::ceil(std::sqrt(static_cast<double>(n))));
  for (std::size_t i = 0; i < n; ++i) {
    const auto id = tx.create(tree.type);
    if (!id) give_up(id.error().text());
    const double x = 6.0 * (static_cast<double>(i % side) - 0.5 * static_cast<double>(side)),
                 y = 6.0 * (static_cast<double>(i / side) - 0.5 * static_cast<double>(side));
    Status s = tx.set(*id, tree.position, world::Vector3(x, y, 0));
    if (s) s = tx.set(*id, tree.species, std::string(species[i * 7 % 8]));
    if (s) s = tx.set(*id, tree.dbh_m, 0.15 + 0.05 * static_cast<double>(i * 13 % 12));
    if (!s) give_up(s.error().text());
  }
  if (const auto s = tx.commit(); !s) give_up(s.error().text());
  auto out = world::WorldFile::create(file, *db);
  if (!out) give_up(out.error().text());
  if (const auto s = (*out)->persist(); !s) give_up(s.error().text());
}

struct Changes {
  double open_ms = 0, build_ms = 0, first_ms = 0, first_upload_ms = 0;
  std::vector<double> commit_ms, upload_ms, collect_ms, idle_upload_ms;
};
Changes change_trees(const std::shared_ptr<Device>& device, std::size_t n, ViewRequest request) {
  const auto file = std::filesystem::temp_directory_path() / "rigor-bench-view.rigor";
  std::filesystem::remove(file);
  write_forest(file, n);
  Changes c;
  auto begun = Clock::now();
  auto opened = open_world(file);
  if (!opened) give_up(opened.error().text());
  c.open_ms = ms_since(begun);
  begun = Clock::now();
  const auto content = make_world_picture(*opened);
  c.build_ms = ms_since(begun);
  request.T_world_camera = look({0, 0, 60}, {0, 300, 0});
  request.allowed_error_px = 4;
  request.switches = {.shadows = false};
  auto view = ViewRenderer::create(device);
  if (!view) give_up(view.error().text());
  ViewPicture picture;
  ViewStatistics s;
  const auto query = ViewRenderer::query_for(request);
  const auto show = [&] {
    const auto start = Clock::now();
    const auto frame = content.view->collect(query);
    c.collect_ms.push_back(ms_since(start));
    if (const Status ok = (*view)->draw(frame, request, picture, &s); !ok) give_up(ok.error().text());
  };
  begun = Clock::now();
  show();
  c.first_ms = ms_since(begun);
  c.first_upload_ms = s.upload_ms;
  const world::types::Tree tree(opened->db->schema());
  auto seen = opened->db->snapshot().in_radius(tree.type, {0, 150, 0}, 60);
  for (std::size_t i = 0; i < 20 && i < seen.size(); ++i) {
    show();
    c.idle_upload_ms.push_back(s.upload_ms);
    begun = Clock::now();
    auto tx = opened->db->begin("fell");
    if (const auto ok = tx.remove(seen[i * 31 % seen.size()]); !ok) continue;
    if (const auto ok = tx.commit(); !ok) give_up(ok.error().text());
    c.commit_ms.push_back(ms_since(begun));
    show();
    c.upload_ms.push_back(s.upload_ms);
  }
  std::filesystem::remove(file);
  return c;
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

  auto opened = open_world(o.world);
  if (!opened) give_up(opened.error().text());
  const auto content = make_world_picture(*opened);
  const double ground_m = content.ground->height_at(0, o.eye_north_m);
  const double base_m = std::isfinite(ground_m) ? ground_m : 0.0;
  ViewRequest request;
  request.pinhole = {o.width_px,
                     o.height_px,
                     0.8 * o.width_px,
                     0.8 * o.width_px,
                     0.5 * (o.width_px - 1),
                     0.5 * (o.height_px - 1),
                     0.05};
  request.T_world_camera = look({0, o.eye_north_m, base_m + 2}, {5, 0, base_m + 8});
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
  std::printf("%s, %dx%d, 4 samples, %.1f px allowed, %s\n",
              std::filesystem::path(o.world).filename().c_str(), o.width_px, o.height_px, o.error_px,
              (*device)->name().c_str());
  std::printf("%-22s %9s %9s %9s %10s %6s %9s %8s %8s %8s\n", "", "p50 ms", "max ms", "collect", "triangles",
              "calls", "instances", "RMS", "p99.9", ">5 %");
  ViewPicture reference;
  for (const Case& c : cases) {
    request.switches = c.switches;
    const Timed t = draw(**view, *content.view, request, reference.radiance.empty() ? 0 : o.rounds);
    if (reference.radiance.empty()) reference = t.picture;
    const Difference d = difference(t.picture, reference);
    const ViewStatistics& s = t.statistics;
    std::printf("%-22s %9.1f %9.1f %9.1f %10zu %6zu %9zu %8.4f %8.3f %7.2f%%\n", c.name,
                t.ms[t.ms.size() / 2], t.ms.back(), t.collect_ms, s.triangles_drawn, s.draw_calls,
                s.instances_drawn, d.rms, d.p999, 100 * d.share);
    out["cases"].push_back({{"name", c.name},
                            {"p50_ms", t.ms[t.ms.size() / 2]},
                            {"max_ms", t.ms.back()},
                            {"collect_ms", t.collect_ms},
                            {"triangles", s.triangles_drawn},
                            {"draw_calls", s.draw_calls},
                            {"instances", s.instances_drawn},
                            {"impostors", s.impostors_drawn},
                            {"rms", d.rms},
                            {"p999", d.p999},
                            {"differ_5_percent", d.share}});
  }

  const Changes c = change_trees(*device, o.trees, request);
  const double load_ms = c.open_ms + c.build_ms;
  const double upload_ms = std::max(0.0, median(c.upload_ms) - median(c.idle_upload_ms));
  std::printf(
      "\n%zu trees: loaded in %.0f ms (file %.0f, view %.0f), first picture %.0f ms more (upload %.0f)\n"
      "one tree felled: commit, rules and signals to the new batch p50 %.3f ms, max %.3f; upload p50 %.3f ms "
      "(%.3f, and "
      "%.3f where nothing changed)\n"
      "asking for a frame's content, changed or not: p50 %.1f ms\n",
      o.trees, load_ms, c.open_ms, c.build_ms, c.first_ms, c.first_upload_ms, median(c.commit_ms),
      *std::max_element(c.commit_ms.begin(), c.commit_ms.end()), upload_ms, median(c.upload_ms),
      median(c.idle_upload_ms), median(c.collect_ms));
  out["world"] = {{"trees", o.trees},
                  {"open_ms", c.open_ms},
                  {"build_ms", c.build_ms},
                  {"first_picture_ms", c.first_ms},
                  {"commit_p50_ms", median(c.commit_ms)},
                  {"commit_max_ms", *std::max_element(c.commit_ms.begin(), c.commit_ms.end())},
                  {"upload_p50_ms", median(c.upload_ms)},
                  {"upload_nothing_changed_p50_ms", median(c.idle_upload_ms)},
                  {"collect_p50_ms", median(c.collect_ms)}};
  if (!o.json.empty()) {
    std::ofstream file(o.json);
    file << out.dump(2) << '\n';
    if (!file) give_up(o.json + ": cannot be written");
  }
  return 0;
}
