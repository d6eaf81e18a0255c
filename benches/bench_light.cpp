// Light of the quick renderers beside a path-traced reference: pictures as NPY files, which light_error.py
// compares.
//
//   bench_light --out DIR [--place indoor|forest|ground] [--only NAME] [--reference PASSES] [--rounds N]
//               [--json FILE]
//
// A window of 160x120 pixels in the middle of a 640x480 picture. The reference has every level of detail at
// its finest, area samples on a 16 x 16 grid in each pixel, the sun's disc, sky light by cosine-weighted
// paths of up to 64 reflections, which chance ends earlier, and light through leaves, and is the mean of
// PASSES passes with other draws: 4 make 1024 paths a pixel. Each pass is a file of its own, so that the
// reference's error is known from the passes' differences. Quick pictures are those of the camera's optics,
// without noise, at a still eye and at one that is turned by a quarter of a pixel; they are timed at an eye
// that drives.
#include <filesystem>

#include "bench/dataset/npy.h"
#include "benches/sensor_bench.h"
#include "sim/render/rays/light_picture.h"
#include "sim/sensors/camera/camera_optics_picture.h"

namespace {

using namespace rigor;
using namespace rigor::bench;

constexpr int kWidth_px = 640, kHeight_px = 480, kFocal_px = 500;
constexpr OpticsRequest::Region kWindow{.x_px = 240, .y_px = 180, .width_px = 160, .height_px = 120};
constexpr int kSamplesASide = 16, kBounces = 64;

struct LightOptions {
  std::filesystem::path out;
  std::string place, json, only;
  int passes = 0, rounds = 5;
};

LightOptions light_options(int argc, char** argv) {
  LightOptions o;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    const char* value = i + 1 < argc ? argv[++i] : "";
    if (word == "--out")
      o.out = value;
    else if (word == "--place")
      o.place = value;
    else if (word == "--json")
      o.json = value;
    else if (word == "--only")
      o.only = value;
    else if (word == "--reference" && std::atoi(value) > 1)
      o.passes = std::atoi(value);
    else if (word == "--rounds" && std::atoi(value) > 0)
      o.rounds = std::atoi(value);
    else
      give_up(
          word +
          ": expected --out DIR, --place NAME, --only NAME, --reference PASSES (2 or more), --rounds N or "
          "--json FILE");
  }
  if (o.out.empty()) give_up("expected --out DIR");
  std::filesystem::create_directories(o.out);
  return o;
}

void write_picture(const std::filesystem::path& file, const std::vector<float>& radiance) {
  const std::string bytes = npy::floats(radiance, {kWindow.height_px, kWindow.width_px, 4});
  std::ofstream out(file, std::ios::binary);
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  if (!out) give_up(file.string() + ": cannot be written");
}

/// Turned about its own y axis, so that the middle of the picture moves by that much to the left.
Eigen::Isometry3d turned(Eigen::Isometry3d T_world_camera, double pixels) {
  return T_world_camera * Eigen::AngleAxisd(pixels / kFocal_px, Eigen::Vector3d::UnitY());
}

/// What a robot in the forest sees before it.
constexpr Place kGround{"ground", "forest.import.yaml", -22, -34, 0.95, -0.42, -0.42};

class Bench {
 public:
  explicit Bench(LightOptions o) : o_(std::move(o)), cache_(need(render::EmbreeCache::create())) {
    auto device = render::Device::create();
    if (device) device_ = *device;
    out_["machine"] = machine(device_);
  }
  nlohmann::json& out() { return out_; }

  void place(const Place& place) {
    StandingWorld world(place);
    if (o_.passes > 0) {
      for (const double shift_px : {0.0, kShift_px}) reference(world, place, shift_px);
      return;
    }
    constexpr const char* kOrdinals[] = {"", "", "2nd", "3rd", "4th"};
    struct Choice {
      const char* name;
      PixelSamples samples;
      int step, sky_rays;
    };
    for (const Choice& c :
         {Choice{"rays-1", {1, 0, 0}, 1, 0}, Choice{"rays-1-sky-16", {1, 0, 16}, 1, 0},
          Choice{"rays-1-uneven-7", {1, 7, 0}, 1, 0}, Choice{"rays-1-uneven-7-sky-64", {1, 7, 64}, 1, 0},
          Choice{"rays-1-uneven-15-sky-64", {1, 15, 64}, 1, 0}, Choice{"rays-4", {4, 0, 0}, 1, 0},
          Choice{"rays-4-uneven-15-sky-64", {4, 15, 64}, 1, 0}, Choice{"rays-16", {16, 0, 0}, 1, 0},
          Choice{"rays-1-every-2nd", {1, 0, 0}, 2, 0}, Choice{"rays-1-every-2nd-sky-16", {1, 0, 16}, 2, 0},
          Choice{"rays-1-every-2nd-uneven-7-sky-64", {1, 7, 64}, 2, 0},
          Choice{"rays-1-every-3rd-sky-4", {1, 0, 4}, 3, 0},
          Choice{"rays-1-every-4th-sky-4", {1, 0, 4}, 4, 0}, Choice{"rays-1-sky-rays-1", {1, 0, 0}, 1, 1}}) {
      const std::string name = c.name;
      if (!o_.only.empty() && o_.only != name) continue;
      // On the ground samples differ little: what rigs take, and as by default.
      if (std::string_view(place.name) == kGround.name && c.samples.sky != 16 &&
          name != "rays-1-uneven-7-sky-64")
        continue;
      OpticsOptions optics;
      optics.samples = c.samples;
      optics.pixel_step = c.step;
      optics.sky_rays = c.sky_rays;
      std::string knobs = std::to_string(c.samples.every) + (c.samples.every > 1 ? " samples" : " sample");
      if (c.samples.uneven > 0) knobs += ", " + std::to_string(c.samples.uneven) + " more where uneven";
      if (c.samples.sky > 0) knobs += ", " + std::to_string(c.samples.sky) + " at the sky's edges";
      if (c.step > 1) knobs += std::string(", every ") + kOrdinals[c.step] + " pixel";
      if (c.sky_rays > 0) knobs += ", " + std::to_string(c.sky_rays) + " sky ray";
      quick(world, place, name, "rays", knobs, need(make_rays_optics(camera(), optics, cache_)), o_.rounds);
    }
    if (device_ && (o_.only.empty() || o_.only == "raster"))
      quick(world, place, "raster", "raster", "", need(make_vulkan_optics(camera(), {}, device_)), 1);
  }

 private:
  static constexpr double kShift_px = 0.25, kStep_m = 0.06;
  static CameraModel camera() {
    CameraModel m;
    m.width_px = kWidth_px, m.height_px = kHeight_px;
    m.fx_px = m.fy_px = kFocal_px;
    m.cx_px = 0.5 * (kWidth_px - 1), m.cy_px = 0.5 * (kHeight_px - 1);
    return m;
  }
  static std::string file(const Place& place, const std::string& name, double shift_px) {
    return std::string(place.name) + "-" + name + (shift_px > 0 ? "-turned" : "") + ".npy";
  }
  void reference(StandingWorld& world, const Place& place, double shift_px) {
    const CameraModel m = camera();
    render::LightPictureRequest q;
    q.T_world_camera = turned(world.T_world_optical(), shift_px);
    q.pinhole = {.width_px = kWindow.width_px,
                 .height_px = kWindow.height_px,
                 .fx_px = m.fx_px,
                 .fy_px = m.fy_px,
                 .cx_px = m.cx_px - kWindow.x_px,
                 .cy_px = m.cy_px - kWindow.y_px};
    q.samples_a_side = kSamplesASide;
    q.sky_rays = 1;
    q.bounces = kBounces;
    q.soft_sun = true;
    render::ViewRequest all;
    all.T_world_camera = q.T_world_camera;
    all.switches.frustum_culling = all.switches.levels_of_detail = false;
    auto engine = need(render::EmbreeEngine::create(cache_));
    need(engine->prepare(world.collect(render::ViewRenderer::query_for(all), {}, {}, 1)));
    render::LightTracer tracer(engine);
    for (int pass = 0; pass < o_.passes; ++pass) {
      const auto begun = Clock::now();
      q.seed = static_cast<std::uint64_t>(pass) * 1'000'003 + (shift_px > 0 ? 1 : 0);
      render::ViewPicture picture;
      need(render::trace_picture(tracer, q, picture));
      const std::string name = "reference-" + std::to_string(pass);
      write_picture(o_.out / file(place, name, shift_px), picture.radiance);
      std::printf("%-10s %-20s %9.1f s\n", place.name, (name + (shift_px > 0 ? ", turned" : "")).c_str(),
                  ms_since(begun) / 1e3);
      out_["references"].push_back(
          {{"place", place.name}, {"pass", pass}, {"seconds", ms_since(begun) / 1e3}});
    }
  }
  void quick(StandingWorld& world, const Place& place, const std::string& name, const char* renderer,
             const std::string& knobs, const std::unique_ptr<CameraOpticsPicture>& optics, int rounds) {
    OpticsPicture picture;
    OpticsRequest request;
    for (const double shift_px : {0.0, kShift_px}) {
      const Eigen::Isometry3d T = turned(world.T_world_optical(), shift_px);
      const render::SensorView view{world, [T](BenchTime) { return T; }};
      request.region = kWindow, request.measure.index = shift_px > 0 ? 1 : 0;
      need(optics->form(request, view, picture));
      write_picture(o_.out / file(place, name, shift_px), picture.radiance);
      if (shift_px > 0) continue;
      request.region = {};
      // As a camera with ten pictures a second that drives ahead at 0.6 m/s: what is kept of a place is of
      // use.
      const Times t = timed(rounds, [&](int i) {
        const Eigen::Isometry3d ahead = T * Eigen::Translation3d(0, 0, kStep_m * (i + 1));
        request.measure.index = static_cast<std::uint64_t>(i + 1);
        need(optics->form(request, {world, [ahead](BenchTime) { return ahead; }}, picture));
      });
      // What a new place costs, light that is gathered and sunlight in cells: a metre beside, the first
      // picture of a part less the second.
      request.region = kWindow;
      Eigen::Isometry3d beside = T;
      beside.translation().x() += 1;
      const render::SensorView from_there{world, [beside](BenchTime) { return beside; }};
      const auto cpu_of = [&] {
        const double begun = cpu_ms();
        need(optics->form(request, from_there, picture));
        return cpu_ms() - begun;
      };
      const double first = cpu_of(), again = cpu_of();
      std::printf("%-10s %-24s %9.1f ms, %9.1f ms of CPU, %9.1f ms more in a new place\n", place.name,
                  name.c_str(), t.quantile(0.5), t.cpu(), first - again);
      const bool gathers = std::string_view(renderer) == "rays" && knobs.find("sky ray") == std::string::npos;
      out_["runs"].push_back(
          {{"place", place.name},
           {"name", name},
           {"renderer", renderer},
           {"knobs", knobs},
           {"p50_ms", t.quantile(0.5)},
           {"cpu_ms", t.cpu()},
           {"new_place_cpu_ms", gathers ? nlohmann::json(first - again) : nlohmann::json()}});
    }
  }

  LightOptions o_;
  std::shared_ptr<render::EmbreeCache> cache_;
  std::shared_ptr<render::Device> device_;
  nlohmann::json out_;
};

}  // namespace

int main(int argc, char** argv) {
  const LightOptions o = light_options(argc, argv);
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  Bench bench(o);
  const std::vector<Place> places = {kPlaces[0], kPlaces[1], kGround};
  if (!o.place.empty() &&
      std::none_of(places.begin(), places.end(), [&](const Place& p) { return o.place == p.name; }))
    give_up("--place: expected indoor, forest or ground, got " + o.place);
  for (const Place& p : places)
    if (o.place.empty() || o.place == p.name) bench.place(p);
  write(o.json, bench.out());
  return 0;
}
