#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <numbers>

#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/files/output_file.h"
#include "bench/files/picture_file.h"
#include "bench/sensing/inertial.h"
#include "bench/sensing/sample_files.h"
#include "bench/sensing/sample_json.h"
#include "bench/sensing/simulation.h"
#include "bench/tune/engine_choices.h"
#include "cli/commands.h"
#include "cli/overrides.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {
namespace {

struct Target {
  RigConfig rig;
  const ChannelEntry* entry = nullptr;
  const BackendChoice* choice = nullptr;
  std::string noise_name;  ///< the name that keys the channel's noise in a run
};

Result<std::unique_ptr<Target>> find_target(const SenseOptions& options) {
  const auto overrides = parse_overrides(options.overrides);
  if (!overrides) return tl::unexpected<Error>(overrides.error());
  auto rig = load_rig(options.rig, *overrides);
  if (!rig) return tl::unexpected<Error>(rig.error());
  auto target = std::make_unique<Target>();
  target->rig = std::move(*rig);
  std::vector<std::string> names;
  for (const ChannelEntry& c : target->rig.channels) {
    const BackendChoice& choice = c.is_pair ? c.simulated : c.source;
    if (choice.backend != "simulated") continue;
    names.push_back(c.name);
    if (c.name != options.channel) continue;
    target->entry = &c;
    target->choice = &choice;
    target->noise_name = c.is_pair ? c.name + ".simulated" : c.name;
  }
  if (!target->entry)
    return fail(ErrorCode::bad_input, "--channel",
                fmt::format("expected a simulated channel of the rig, got \"{}\"; there {}: {}",
                            options.channel, names.size() == 1 ? "is" : "are",
                            names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", "))));
  if (target->rig.simulation.world.empty())
    return fail(ErrorCode::bad_input, options.rig.string(), "expected `simulation.world`, found none");
  return target;
}

/// A year: instants count in nanoseconds.
constexpr double kLatest_s = 366 * 86400.0;

Status check_options(const SenseOptions& options, SampleKind kind) {
  if (!(options.at_s >= 0 && options.at_s <= kLatest_s))
    return fail(ErrorCode::bad_input, "--at",
                fmt::format("expected seconds from 0 to {:.0f}, got {:g}", kLatest_s, options.at_s));
  if (options.difference && kind != SampleKind::range_image)
    return fail(ErrorCode::bad_input, "--difference",
                fmt::format("expected a channel of kind range_image, got {}", kind_name(kind)));
  if (is_inertial(kind))
    for (const auto& [option, given] : {std::pair{"--only", !options.only.empty()},
                                        {"--renderer", !options.engine.empty()},
                                        {"--truth", !options.truth.empty()}})
      if (given)
        return fail(ErrorCode::bad_input, option,
                    fmt::format("expected it with a sensor that looks, got a channel of kind {}; --ideal "
                                "gives a sample without errors",
                                kind_name(kind)));
  return {};
}

Status check_outputs(const SenseOptions& options, SampleKind kind, const RigConfig& rig) {
  const std::vector<std::string> endings =
      is_inertial(kind)                 ? std::vector<std::string>{".json"}
      : kind == SampleKind::image       ? std::vector<std::string>{".png", ".exr"}
      : options.difference              ? std::vector<std::string>{".png", ".exr"}
      : kind == SampleKind::range_image ? std::vector<std::string>{".png", ".exr", ".pcd"}
                                        : std::vector<std::string>{".png", ".pcd"};
  if (std::find(endings.begin(), endings.end(), options.output.extension().string()) == endings.end())
    return fail(ErrorCode::bad_input, "-o",
                fmt::format("expected a file that ends in {} for a channel of kind {}, got \"{}\"",
                            fmt::join(endings, ", "), kind_name(kind), options.output.string()));
  if (!options.truth.empty() && options.truth.extension() != ".exr")
    return fail(ErrorCode::bad_input, "--truth",
                "expected a file that ends in .exr, got \"" + options.truth.string() + "\"");
  InputFiles inputs;
  inputs.add_rig(rig);
  Outputs outputs(std::move(inputs));
  const Existing existing = options.force ? Existing::replace : Existing::refuse;
  if (auto s = outputs.add(options.output, "-o", existing); !s) return s;
  if (!options.truth.empty()) return outputs.add(options.truth, "--truth", existing);
  return {};
}

Status set_joint(WorldMotion& motion, const Simulation& simulation, const std::string& text) {
  const auto eq = text.find('=');
  char* end = nullptr;
  const double degrees = eq == std::string::npos ? 0 : std::strtod(text.c_str() + eq + 1, &end);
  if (eq == std::string::npos || end == text.c_str() + eq + 1 || *end != '\0' || !std::isfinite(degrees))
    return fail(ErrorCode::bad_input, "--joint", "expected NAME=DEGREES, got \"" + text + "\"");
  auto index = simulation.joint(text.substr(0, eq));
  if (!index) return tl::unexpected<Error>(index.error());
  motion.joint[*index].position_rad = degrees * std::numbers::pi / 180;
  return {};
}

/// Takes one sample and writes it. `told` gets what is worth telling of it.
class Sensing {
 public:
  Sensing(const SenseOptions& options, const Target& target, Simulation& simulation)
      : options_(options), target_(target), simulation_(simulation) {}

  Status run(nlohmann::json& told) {
    const ConfigNode& params = target_.choice->params;
    SensorOptions how;
    how.ideal = options_.ideal;
    how.only = options_.only;
    const SampleKind kind = target_.entry->kind;
    if (!is_inertial(kind)) {
      auto choice = sense_choice(target_.rig, *target_.entry, simulation_, options_.engine);
      if (!choice) return tl::unexpected<Error>(choice.error());
      how.choice = std::move(*choice);
    }
    // The sample that a virtual run takes at that instant: same index, same draws.
    const Period period = target_.entry->period;
    const Duration phase = seconds_from(params.number_or("phase_us", 0, {.min = 0}) * 1e-6);
    request_.index =
        static_cast<std::uint64_t>(std::max<std::int64_t>(0, (seconds_from(options_.at_s) - phase) / period));
    request_.t_capture = BenchTime(0) + phase + period * static_cast<std::int64_t>(request_.index);
    request_.motion = simulation_.motion_at_rest();
    for (const std::string& joint : options_.joints)
      if (auto s = set_joint(request_.motion, simulation_, joint); !s) return s;
    if (auto s = is_inertial(kind)           ? inertial(params, how, told)
                 : kind == SampleKind::image ? image(params, how, told)
                                             : sampled(params, how, told);
        !s)
      return s;
    told["t_capture_s"] = static_cast<double>(request_.t_capture.ns()) * 1e-9;
    told["index"] = request_.index;
    if (options_.truth.empty()) return {};
    told["truth"] = options_.truth.string();
    return write_truth(options_.truth, truth_);
  }
  /// The sample in words.
  [[nodiscard]] const std::string& said() const { return said_; }

 private:
  Status image(const ConfigNode& params, const SensorOptions& how, nlohmann::json& told) {
    std::shared_ptr<ImageProvider> camera;
    auto made = simulation_.camera(params, target_.rig.seed, target_.noise_name, how);
    if (!made) return tl::unexpected<Error>(made.error());
    camera = *made;
    if (!options_.truth.empty()) {
      auto* sensed = dynamic_cast<SensedCamera*>(camera.get());
      if (!sensed)
        return fail(
            ErrorCode::bad_input, "--truth",
            "expected `renderer: rays` or `renderer: raster` in the rig or as --renderer: the renderer of "
            "small scenes knows no ground truth");
      sensed->set_truth(&truth_);
    }
    ImageRequest r;
    const auto geometry = camera->geometry();
    r.index = request_.index;
    r.t_capture = request_.t_capture;
    r.motion = request_.motion;
    r.format = geometry.format;
    r.width_px = geometry.width_px;
    r.height_px = geometry.height_px;
    r.exposure =
        seconds_from(params.number_or("exposure_us", geometry.exposure.seconds() * 1e6, {.min = 1}) * 1e-6);
    r.gain_db = params.number_or("gain_db", 0);
    std::vector<std::byte> pixels(image_bytes(r.format, r.width_px, r.height_px));
    if (auto s = camera->capture(r, pixels); !s) return s;
    const ImageInfo info{r.format, r.width_px, r.height_px, 0, 0, r.exposure, r.gain_db};
    told["width_px"] = info.width_px;
    told["height_px"] = info.height_px;
    told["format"] = pfnc_name(info.format);
    said_ = fmt::format("{}x{} {}", info.width_px, info.height_px, pfnc_name(info.format));
    const auto picture = picture_bytes(options_.output.extension().string(), info, pixels);
    if (!picture) return tl::unexpected<Error>(picture.error());
    return write_output(options_.output, *picture);
  }

  Status inertial(const ConfigNode& params, const SensorOptions& how, nlohmann::json& told) {
    const ChannelEntry& entry = *target_.entry;
    auto made =
        simulation_.inertial(entry.kind, params, target_.rig.seed, target_.noise_name, entry.period, how);
    if (!made) return tl::unexpected<Error>(made.error());
    Sample sample;
    SampleProvider::Request request = request_;
    // Odometry adds up: every capture since the start, as a run takes them.
    const std::uint64_t first = entry.kind == SampleKind::odometry ? 0 : request_.index;
    for (request.index = first; request.index <= request_.index; ++request.index) {
      request.t_capture = request_.t_capture - entry.period * static_cast<std::int64_t>(request_.index) +
                          entry.period * static_cast<std::int64_t>(request.index);
      if (auto s = (*made)->capture(request, sample); !s) return s;
    }
    told["sample"] = sample_json(sample);
    said_ = told["sample"].dump();
    return write_output(options_.output, told["sample"].dump(2) + "\n");
  }

  Status sampled(const ConfigNode& params, const SensorOptions& how, nlohmann::json& told) {
    auto made = simulation_.sampler(target_.entry->kind, params, target_.rig.seed, target_.noise_name, how);
    if (!made) return tl::unexpected<Error>(made.error());
    TruthfulSampler& sensor = **made;
    if (!options_.truth.empty()) sensor.set_truth(&truth_);
    Sample sample;
    sample.reserve(sensor.geometry().max_bytes);
    if (auto s = sensor.capture(request_, sample); !s) return s;
    double scale_m = 0;
    Status written;
    const std::string ending = options_.output.extension().string();
    if (const auto* cloud = sample.as<PointCloudInfo>()) {
      std::vector<LidarPoint> points(cloud->count);
      if (cloud->count > 0) std::memcpy(points.data(), sample.bytes().data(), sample.size_bytes);
      written = ending == ".pcd" ? write_points_pcd(options_.output, points)
                                 : write_points_png(options_.output, points, scale_m);
      told["points"] = points.size();
      said_ = fmt::format("{} points", points.size());
      if (scale_m > 0) said_ += fmt::format(", {:g} m from the middle to the edge", scale_m);
    } else if (const auto* info = sample.as<RangeImageInfo>()) {
      const std::size_t n = std::size_t{info->width_px} * info->height_px;
      std::vector<float> planes(2 * n);
      std::memcpy(planes.data(), sample.bytes().data(), 2 * n * sizeof(float));
      if (options_.difference)
        if (auto s = subtract_without_effects(params, how, std::span(planes).first(n)); !s) return s;
      const RangePicture picture{info->width_px, info->height_px, std::span(planes).first(n),
                                 std::span(planes).last(n)};
      written = options_.difference && ending == ".png"
                    ? write_difference_png(options_.output, picture, scale_m)
                : ending == ".pcd" ? write_range_pcd(options_.output, picture, sensor.directions())
                : ending == ".exr" ? write_range_exr(options_.output, picture)
                                   : write_range_png(options_.output, picture, scale_m);
      const auto returns = std::count_if(picture.range_m.begin(), picture.range_m.end(),
                                         [](float r) { return std::isfinite(r); });
      told["width_px"] = info->width_px;
      told["height_px"] = info->height_px;
      told["returns"] = returns;
      said_ = fmt::format("{}x{}, {} returns", info->width_px, info->height_px, returns);
      if (scale_m > 0)
        said_ += fmt::format(", colours over {:g} to {:g} m", options_.difference ? -scale_m : 0, scale_m);
    }
    if (scale_m > 0) told["full_scale_m"] = scale_m;
    return written;
  }

  /// From each range that of the same capture by the same device without its effects. The lens stays where
  /// it is among them, or pixels would look at different things.
  Status subtract_without_effects(const ConfigNode& params, SensorOptions how, std::span<float> range_m) {
    const bool lens =
        how.only.empty() || std::find(how.only.begin(), how.only.end(), "lens") != how.only.end();
    how.only = {lens ? "lens" : "none"};
    auto made = simulation_.sampler(target_.entry->kind, params, target_.rig.seed, target_.noise_name, how);
    if (!made) return tl::unexpected<Error>(made.error());
    Sample sample;
    sample.reserve((*made)->geometry().max_bytes);
    if (auto s = (*made)->capture(request_, sample); !s) return s;
    std::vector<float> without(range_m.size());
    std::memcpy(without.data(), sample.bytes().data(), without.size() * sizeof(float));
    for (std::size_t i = 0; i < without.size(); ++i) range_m[i] -= without[i];
    return {};
  }

  const SenseOptions& options_;
  const Target& target_;
  Simulation& simulation_;
  SampleProvider::Request request_;
  GroundTruth truth_;

  std::string said_;
};

}  // namespace

int sense_command(const SenseOptions& options) {
  auto target = find_target(options);
  if (!target) return report_error(target.error(), options.json);
  if (auto s = check_options(options, (*target)->entry->kind); !s)
    return report_error(s.error(), options.json);
  if (auto s = check_outputs(options, (*target)->entry->kind, (*target)->rig); !s)
    return report_error(s.error(), options.json);
  auto simulation = Simulation::open((*target)->rig.simulation);
  if (!simulation) return report_error(simulation.error(), options.json);

  nlohmann::json told{{"file", options.output.string()},
                      {"channel", options.channel},
                      {"kind", kind_name((*target)->entry->kind)}};
  Sensing sensing(options, **target, **simulation);
  std::optional<ProgressTask> progress(std::in_place, "sense " + options.channel);
  const auto done = catch_config([&] { return sensing.run(told); });
  progress.reset();
  if (!done) return report_error(done.error(), options.json);
  if (!*done) return report_error(done->error(), options.json);

  told["renderer"] = (*simulation)->engine();
  if (options.json)
    fmt::print("{}\n", told.dump());
  else
    fmt::print("{}: {}, capture {} at {:.3f} s{}{}\n", options.output.string(), sensing.said(),
               told["index"].get<std::uint64_t>(), told["t_capture_s"].get<double>(),
               (*simulation)->engine().empty() ? "" : ", ", (*simulation)->engine());
  return 0;
}

}  // namespace rigor
