#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>

#include "bench/capture/sensor_probe.h"
#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/files/output_file.h"
#include "bench/files/picture_file.h"
#include "bench/sensing/inertial.h"
#include "bench/sensing/sample_files.h"
#include "bench/sensing/sample_json.h"
#include "cli/commands.h"
#include "cli/overrides.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {
namespace {

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

Result<std::vector<std::pair<std::string, double>>> parse_joints(const std::vector<std::string>& texts) {
  std::vector<std::pair<std::string, double>> joints;
  for (const std::string& text : texts) {
    const auto eq = text.find('=');
    char* end = nullptr;
    const double degrees = eq == std::string::npos ? 0 : std::strtod(text.c_str() + eq + 1, &end);
    if (eq == std::string::npos || end == text.c_str() + eq + 1 || *end != '\0' || !std::isfinite(degrees))
      return fail(ErrorCode::bad_input, "--joint", "expected NAME=DEGREES, got \"" + text + "\"");
    joints.emplace_back(text.substr(0, eq), degrees);
  }
  return joints;
}

Result<SensorProbeOptions> probe_options(const SenseOptions& options) {
  auto joints = parse_joints(options.joints);
  if (!joints) return tl::unexpected<Error>(joints.error());
  return SensorProbeOptions{.channel = options.channel,
                            .joints_deg = std::move(*joints),
                            .ideal = options.ideal,
                            .only = options.only,
                            .renderer = options.engine,
                            .truth = !options.truth.empty()};
}

Result<RigConfig> load(const SenseOptions& options) {
  const auto overrides = parse_overrides(options.overrides);
  if (!overrides) return tl::unexpected<Error>(overrides.error());
  return load_rig(options.rig, *overrides);
}

/// What a sample is written as. `answer` gets what is worth saying of it; `said` is the same in words.
class SampleFile {
 public:
  SampleFile(const SenseOptions& options, const Capture& capture, nlohmann::json& answer)
      : options_(options), capture_(capture), answer_(answer) {}

  Status write() {
    const Sample& sample = capture_.sample;
    if (const auto* info = sample.as<ImageInfo>()) return image(*info);
    if (const auto* cloud = sample.as<PointCloudInfo>()) return points(*cloud);
    if (const auto* info = sample.as<RangeImageInfo>()) return ranges(*info);
    answer_["sample"] = sample_json(sample);
    said_ = answer_["sample"].dump();
    return write_output(options_.output, answer_["sample"].dump(2) + "\n");
  }
  [[nodiscard]] const std::string& said() const { return said_; }

 private:
  Status image(const ImageInfo& info) {
    answer_["width_px"] = info.width_px;
    answer_["height_px"] = info.height_px;
    answer_["format"] = pfnc_name(info.format);
    said_ = fmt::format("{}x{} {}", info.width_px, info.height_px, pfnc_name(info.format));
    const auto picture = picture_bytes(options_.output.extension().string(), info, capture_.sample.bytes());
    if (!picture) return tl::unexpected<Error>(picture.error());
    return write_output(options_.output, *picture);
  }

  Status points(const PointCloudInfo& cloud) {
    std::vector<LidarPoint> points(cloud.count);
    if (cloud.count > 0)
      std::memcpy(points.data(), capture_.sample.bytes().data(), capture_.sample.size_bytes);
    double scale_m = 0;
    Status written = options_.output.extension() == ".pcd"
                         ? write_points_pcd(options_.output, points)
                         : write_points_png(options_.output, points, scale_m);
    answer_["points"] = points.size();
    said_ = fmt::format("{} points", points.size());
    if (scale_m > 0) {
      answer_["full_scale_m"] = scale_m;
      said_ += fmt::format(", {:g} m from the middle to the edge", scale_m);
    }
    return written;
  }

  Status ranges(const RangeImageInfo& info) {
    const std::size_t n = std::size_t{info.width_px} * info.height_px;
    std::vector<float> planes(2 * n);
    std::memcpy(planes.data(), capture_.sample.bytes().data(), 2 * n * sizeof(float));
    if (options_.difference)
      if (auto s = subtract_without_effects(std::span(planes).first(n)); !s) return s;
    const std::string ending = options_.output.extension().string();
    const RangePicture picture{info.width_px, info.height_px, std::span(planes).first(n),
                               std::span(planes).last(n)};
    double scale_m = 0;
    Status written = options_.difference && ending == ".png"
                         ? write_difference_png(options_.output, picture, scale_m)
                     : ending == ".pcd" ? write_range_pcd(options_.output, picture, capture_.directions)
                     : ending == ".exr" ? write_range_exr(options_.output, picture)
                                        : write_range_png(options_.output, picture, scale_m);
    const auto returns = std::count_if(picture.range_m.begin(), picture.range_m.end(),
                                       [](float r) { return std::isfinite(r); });
    answer_["width_px"] = info.width_px;
    answer_["height_px"] = info.height_px;
    answer_["returns"] = returns;
    said_ = fmt::format("{}x{}, {} returns", info.width_px, info.height_px, returns);
    if (scale_m > 0) {
      answer_["full_scale_m"] = scale_m;
      said_ += fmt::format(", colours over {:g} to {:g} m", options_.difference ? -scale_m : 0, scale_m);
    }
    return written;
  }

  /// From each range that of the same capture by the same device without its effects. The lens stays where
  /// it is among them, or pixels would look at different things.
  Status subtract_without_effects(std::span<float> range_m) {
    auto how = probe_options(options_);
    if (!how) return tl::unexpected<Error>(how.error());
    const bool lens =
        how->only.empty() || std::find(how->only.begin(), how->only.end(), "lens") != how->only.end();
    how->only = {lens ? "lens" : "none"};
    how->truth = false;
    auto rig = load(options_);
    if (!rig) return tl::unexpected<Error>(rig.error());
    auto probe = SensorProbe::open(std::move(*rig), std::move(*how));
    if (!probe) return tl::unexpected<Error>(probe.error());
    const auto other = (*probe)->capture(options_.at_s);
    if (!other) return tl::unexpected<Error>(other.error());
    std::vector<float> without(range_m.size());
    std::memcpy(without.data(), other->sample.bytes().data(), without.size() * sizeof(float));
    for (std::size_t i = 0; i < without.size(); ++i) range_m[i] -= without[i];
    return {};
  }

  const SenseOptions& options_;
  const Capture& capture_;
  nlohmann::json& answer_;
  std::string said_;
};

}  // namespace

int sense_command(const SenseOptions& options) {
  const auto refuse = [&](const Error& error) { return report_error(error, options.json); };
  auto rig = load(options);
  if (!rig) return refuse(rig.error());
  auto how = probe_options(options);
  if (!how) return refuse(how.error());
  const auto kind = SensorProbe::kind_of(*rig, *how);
  if (!kind) return refuse(kind.error());
  if (options.difference && *kind != SampleKind::range_image)
    return refuse({ErrorCode::bad_input, "--difference",
                   fmt::format("expected a channel of kind range_image, got {}", kind_name(*kind))});
  if (auto s = check_outputs(options, *kind, *rig); !s) return refuse(s.error());
  const std::optional<ProgressTask> progress(std::in_place, "sense " + options.channel);
  auto probe = SensorProbe::open(std::move(*rig), std::move(*how));
  if (!probe) return refuse(probe.error());
  const auto capture = (*probe)->capture(options.at_s);
  if (!capture) return refuse(capture.error());
  nlohmann::json answer{
      {"file", options.output.string()}, {"channel", options.channel}, {"kind", kind_name(*kind)}};
  SampleFile file(options, *capture, answer);
  if (auto s = file.write(); !s) return refuse(s.error());
  const double t_capture_s = static_cast<double>(capture->sample.stamp.t_capture.ns()) * 1e-9;
  answer["t_capture_s"] = t_capture_s;
  answer["index"] = capture->index;
  if (!options.truth.empty()) {
    answer["truth"] = options.truth.string();
    if (auto s = write_truth(options.truth, capture->truth); !s) return refuse(s.error());
  }
  const std::string renderer = (*probe)->renderer();
  answer["renderer"] = renderer;
  if (options.json)
    fmt::print("{}\n", answer.dump());
  else
    fmt::print("{}: {}, capture {} at {:.3f} s{}{}\n", options.output.string(), file.said(), capture->index,
               t_capture_s, renderer.empty() ? "" : ", ", renderer);
  return 0;
}

}  // namespace rigor
