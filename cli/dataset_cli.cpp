#include "cli/dataset_cli.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <utility>

#include "bench/console/terminal.h"
#include "bench/dataset/dataset_texts.h"
#include "bench/dataset/fill_dataset.h"
#include "cli/command_options.h"

namespace rigor {
namespace {

/// As they were typed; empty: not given.
struct Words : DatasetTexts {
  std::filesystem::path output;
  std::string layers, only, jobs, min_area, arrays;
  bool with_truth = false, without_truth = false, json = false;
};

Result<DatasetOutputOptions> read_output(const Words& w, bool truth) {
  DatasetOutputOptions f;
  f.exr = w.arrays == "exr";
  if (!w.layers.empty()) {
    if (!truth) return fail(ErrorCode::bad_input, "--layers", "expected it with truth, got --no-truth");
    f.layers = w.layers == "all"    ? dataset_layers()
               : w.layers == "none" ? std::vector<std::string>{}
                                    : words_of_list(w.layers);
    for (const std::string& layer : f.layers)
      if (std::find(dataset_layers().begin(), dataset_layers().end(), layer) == dataset_layers().end())
        return fail(ErrorCode::bad_input, "--layers",
                    fmt::format("expected all, none, or some of {}, got \"{}\"",
                                fmt::join(dataset_layers(), ", "), layer));
  }
  if (!w.min_area.empty()) {
    const auto area = whole_number(w.min_area, "--min-area", 1, 1'000'000);
    if (!area) return tl::unexpected<Error>(area.error());
    f.min_area_px = static_cast<std::uint32_t>(*area);
  }
  return f;
}

Result<FillOptions> read_work(const Words& w, std::uint64_t size) {
  FillOptions o;
  for (const std::string& word : words_of_list(w.only)) {
    const auto dots = word.find("..");
    auto first = whole_number(word.substr(0, dots), "--only", 0, size - 1);
    if (!first) return tl::unexpected<Error>(first.error());
    auto last =
        dots == std::string::npos ? first : whole_number(word.substr(dots + 2), "--only", *first, size - 1);
    if (!last) return tl::unexpected<Error>(last.error());
    o.only.emplace_back(*first, *last);
  }
  if (!w.jobs.empty()) {
    const auto threads = whole_number(w.jobs, "--jobs", 1, 1024);
    if (!threads) return tl::unexpected<Error>(threads.error());
    o.threads = static_cast<int>(*threads);
  }
  return o;
}

void print(const Words& w, const Dataset& dataset, const Filled& filled) {
  const auto share = [&](double s) { return filled.whole_s > 0 ? 100 * s / filled.whole_s : 0; };
  if (w.json) {
    nlohmann::json rejected = nlohmann::json::object();
    for (const auto& [reason, count] : filled.summary.rejected) rejected[reason] = count;
    fmt::print("{}\n", nlohmann::json{{"folder", w.output.string()},
                                      {"samples", filled.summary.samples},
                                      {"left_out", filled.summary.left_out},
                                      {"annotations", filled.summary.annotations},
                                      {"rejected_poses", rejected},
                                      {"made", filled.made},
                                      {"there", filled.there},
                                      {"whole_s", filled.whole_s},
                                      {"pose_s", filled.times.pose_s},
                                      {"world_s", filled.times.world_s},
                                      {"capture_s", filled.times.capture_s},
                                      {"label_s", filled.times.label_s},
                                      {"write_s", filled.write_s}}
                           .dump());
    return;
  }
  fmt::print("{}: {} of {} samples, {} boxes", w.output.string(), filled.summary.samples, dataset.size(),
             filled.summary.annotations);
  if (filled.there > 0) fmt::print("; {} were there", filled.there);
  if (filled.summary.left_out > 0)
    fmt::print("; {} left out, as each of their poses was rejected", filled.summary.left_out);
  fmt::print("\n");
  if (!filled.summary.rejected.empty()) {
    fmt::print("rejected poses:");
    const char* between = " ";
    for (const auto& [reason, count] : filled.summary.rejected)
      fmt::print("{}{} {}", std::exchange(between, ", "), count, reason);
    fmt::print("\n");
  }
  if (filled.made > 0)
    fmt::print(
        "{:.1f} s, {:.0f} samples a minute; measuring {:.0f} %, writing {:.0f} %, looking for poses {:.0f} "
        "%\n",
        filled.whole_s, 60 * static_cast<double>(filled.made) / filled.whole_s,
        share(filled.times.capture_s + filled.times.world_s), share(filled.write_s),
        share(filled.times.pose_s));
}

int make(Words w) {
  if (w.with_truth || w.without_truth) w.truth = w.with_truth;
  const auto wrong = [&](const Error& e) { return report_error(e, w.json); };
  auto options = read_dataset_options(w);
  if (!options) return wrong(options.error());
  const auto output_options = read_output(w, options->truth);
  if (!output_options) return wrong(output_options.error());
  auto dataset = Dataset::create(*options);
  if (!dataset) return wrong(dataset.error());
  const auto work = read_work(w, (*dataset)->size());
  if (!work) return wrong(work.error());
  auto output = DatasetOutput::open(w.output, **dataset, *output_options);
  if (!output) return wrong(output.error());
  const auto filled = fill_dataset(**dataset, **output, *work);
  if (!filled) return wrong(filled.error());
  print(w, **dataset, *filled);
  return 0;
}

}  // namespace

struct DatasetCommandLine::Impl {
  explicit Impl(CLI::App& app)
      : command(app, "dataset",
                "Make labelled data with ground truth: pictures, clouds, range images; boxes and masks") {}
  CommandOptions command;
  Words words;
};

DatasetCommandLine::DatasetCommandLine(CLI::App& app) : impl_(std::make_unique<Impl>(app)) {
  CommandOptions& c = impl_->command;
  Words& w = impl_->words;
  c.add_option("RIG", w.source, "Rig file or name, or a file that describes a dataset (key `rig`)")
      .required()
      .config_file();
  c.add_option("-o,--output", w.output,
               "Folder, or FILE.mcap; one that was made with the same options is continued")
      .required();
  c.add_option("--channels", w.channels,
               "Channels, with commas between them (default: all simulated ones that look)");
  c.add_option(
      "--poses", w.poses,
      "List of poses, CSV: x_m,y_m and z_m or height_m, yaw_deg, pitch_deg, roll_deg or qw,qx,qy,qz");
  c.add_option("--within", w.within, "Draw poses in a rectangle: X0,Y0,X1,Y1 in metres");
  c.add_option("--along", w.along, "Draw poses along a path, CSV: x_m,y_m");
  c.add_option("--sample", w.samples, "How many samples (default: one for each listed pose)");
  c.add_option("--height", w.height,
               "Of drawn poses above the ground, metres: 1.2 or 1..2 (default: as the rig)");
  c.add_option("--yaw", w.yaw,
               "Degrees; along a path, added to its direction (default: 0..360; along a path 0)");
  c.add_option("--pitch", w.pitch, "Degrees, downwards (default 0)");
  c.add_option("--roll", w.roll, "Degrees (default 0)");
  c.add_option("--lateral", w.lateral, "Metres to the left of a path (default 0)");
  c.add_option("--clearance", w.clearance,
               "Reject poses with anything nearer than this, metres; 0: none (default 0.5)");
  c.add_option(
       "--vary", w.vary,
       "KEY=VALUES that differ between samples: simulation.weather=clear,fog, Type.attribute=50..500, "
       "joint.NAME=0..360, channels.NAME.exposure_us=… (may be repeated)")
      .one_each();
  c.add_flag("--draw-devices", w.draw_devices,
             "Each sample by another device of those that the sensor models' covariances allow");
  c.add_option("--seed", w.seed, "Of all draws (default 1)");
  const auto truth = c.add_flag("--truth", w.with_truth, "Boxes, masks and layers of truth (the default)");
  c.add_flag("--no-truth", w.without_truth, "Without truth").excludes(truth);
  c.add_option("--layers", w.layers,
               "Layers of truth: all, none, or some of depth,instance,class,true_range,normal,flow (default: "
               "the first three)");
  c.add_option("--arrays", w.arrays,
               "npy or exr: files of depths and other numbers in a folder (default npy)")
      .one_of({"npy", "exr"});
  c.add_option("--min-area", w.min_area, "Visible pixels of a box (default 16)");
  c.add_option("--renderer", w.renderer, "rays or raster (default: what the rig says, else rays)")
      .one_of({"rays", "raster"});
  c.add_option("--split", w.split, "Weights of train, val, test (default 80,10,10)");
  c.add_option("--only", w.only, "Make these samples now: 7 or 0..49, with commas between them");
  c.add_option("--jobs", w.jobs, "Threads that measure (default: all of the machine)");
  c.add_option("--set", w.overrides, "Replace one value of the rig: path.to.key=value (may be repeated)")
      .one_each();
  c.add_flag("--json", w.json, "Print what was made as JSON");
  c.footer(
      "Example: rigor dataset demo --channels right --within=-3,-4,3,-2 --yaw 60..120 --sample 100 -o data");
}

DatasetCommandLine::~DatasetCommandLine() = default;
bool DatasetCommandLine::chosen() const { return impl_->command.parsed(); }
int DatasetCommandLine::run() const { return make(impl_->words); }

}  // namespace rigor
