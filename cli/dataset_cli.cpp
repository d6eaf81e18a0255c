#include "cli/dataset_cli.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <tuple>
#include <utility>

#include "bench/console/terminal.h"
#include "bench/dataset/fill_dataset.h"
#include "bench/sensing/clearance.h"
#include "cli/command_options.h"
#include "cli/overrides.h"

namespace rigor {
namespace {

using dataset::Interval;
using dataset::PoseChoice;
using dataset::Written;

/// As they were typed; empty: not given.
struct Words {
  std::filesystem::path source, poses, along, output;
  std::vector<std::string> overrides, vary;
  std::string channels, samples, within, height, yaw, pitch, roll, lateral, seed, clearance, split, layers,
      only, jobs, min_area;
  std::string renderer, arrays;
  bool draw_devices = false, truth = false, no_truth = false, json = false;
};

std::vector<std::string> listed(const std::string& text) {
  std::vector<std::string> words;
  for (std::size_t at = 0; at <= text.size() && !text.empty();) {
    const std::size_t end = std::min(text.find(',', at), text.size());
    words.push_back(text.substr(at, end - at));
    at = end + 1;
  }
  return words;
}

Result<std::uint64_t> whole_number(const std::string& text, const char* option, std::uint64_t least,
                                   std::uint64_t most) {
  std::uint64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || value < least || value > most)
    return fail(ErrorCode::bad_input, option,
                fmt::format("expected a whole number from {} to {}, got \"{}\"", least, most, text));
  return value;
}

/// Keeps the first error of many values.
class Reading {
 public:
  void number(const std::string& text, const char* option, std::uint64_t least, std::uint64_t most,
              std::uint64_t& out) {
    if (text.empty()) return;
    take(whole_number(text, option, least, most), out);
  }
  template <class Out>
  void interval(const std::string& text, const char* option, double min, double max, Out& out) {
    if (text.empty()) return;
    take(Interval::parse({text, option}, min, max), out);
  }
  template <class T, class Out>
  void take(const Result<T>& value, Out& out) {
    if (value)
      out = *value;
    else
      wrong(value.error());
  }
  void wrong(Error e) {
    if (!error_) error_ = std::move(e);
  }
  [[nodiscard]] Status status() const { return error_ ? Status(tl::unexpected<Error>(*error_)) : Status{}; }

 private:
  std::optional<Error> error_;
};

Status read_poses(const Words& w, PoseChoice& p, Reading& reading) {
  const int ways = int{!w.poses.empty()} + int{!w.within.empty()} + int{!w.along.empty()};
  if (ways > 1)
    return fail(ErrorCode::bad_input, "--poses, --within, --along", "expected one of them, got several");
  if (ways == 1) {
    PoseChoice other;
    other.pitch_deg = p.pitch_deg;
    other.roll_deg = p.roll_deg;
    p = other;
  }
  if (!w.poses.empty()) {
    p.kind = PoseChoice::Kind::list;
    p.file = w.poses;
    p.where = "--poses";
  } else if (!w.along.empty()) {
    p.kind = PoseChoice::Kind::along;
    p.file = w.along;
    p.where = "--along";
  } else if (!w.within.empty()) {
    p.kind = PoseChoice::Kind::within;
    reading.take(dataset::parse_rectangle({w.within, "--within"}), p.within);
  }
  // An option that says nothing about these poses is a mistake.
  const bool drawn = p.kind == PoseChoice::Kind::within || p.kind == PoseChoice::Kind::along;
  for (const auto& [option, text, fits] :
       {std::tuple{"--height", &w.height, drawn || p.kind == PoseChoice::Kind::list},
        {"--yaw", &w.yaw, drawn},
        {"--pitch", &w.pitch, drawn},
        {"--roll", &w.roll, drawn},
        {"--lateral", &w.lateral, p.kind == PoseChoice::Kind::along}})
    if (!text->empty() && !fits)
      return fail(ErrorCode::bad_input, option,
                  std::string("expected it with ") +
                      (option == std::string_view("--lateral") ? "--along" : "--within or --along"));
  reading.interval(w.height, "--height", 0, dataset::kMostHeight_m, p.height_m);
  reading.interval(w.yaw, "--yaw", -dataset::kMostAngle_deg, dataset::kMostAngle_deg, p.yaw_deg);
  reading.interval(w.pitch, "--pitch", -90, 90, p.pitch_deg);
  reading.interval(w.roll, "--roll", -180, 180, p.roll_deg);
  reading.interval(w.lateral, "--lateral", -dataset::kMostLateral_m, dataset::kMostLateral_m, p.lateral_m);
  return {};
}

Result<DatasetOptions> read_options(const Words& w) {
  DatasetOptions o;
  if (is_dataset_file(w.source)) {
    auto loaded = load_dataset_options(w.source);
    if (!loaded) return loaded;
    o = std::move(*loaded);
  } else {
    o.rig = w.source;
  }
  const auto overrides = parse_overrides(w.overrides);
  if (!overrides) return tl::unexpected<Error>(overrides.error());
  o.overrides.insert(o.overrides.end(), overrides->begin(), overrides->end());
  if (!w.channels.empty()) o.channels = listed(w.channels);
  Reading reading;
  reading.number(w.samples, "--sample", 1, DatasetOptions::kMostSamples, o.samples);
  reading.number(w.seed, "--seed", 0, std::numeric_limits<std::int64_t>::max(), o.seed);
  if (auto s = read_poses(w, o.poses, reading); !s) return tl::unexpected<Error>(s.error());
  Interval clearance{o.clearance_m, o.clearance_m};
  reading.interval(w.clearance, "--clearance", 0, ClearanceProbe::kReach_m, clearance);
  o.clearance_m = clearance.to;
  for (const std::string& text : w.vary) {
    const auto equals = text.find('=');
    if (equals == std::string::npos) {
      reading.wrong({ErrorCode::bad_input, "--vary", "expected KEY=VALUES, got \"" + text + "\""});
      continue;
    }
    const std::string key = text.substr(0, equals);
    auto v = dataset::Variation::parse(key, {text.substr(equals + 1), "--vary " + key});
    if (!v) {
      reading.wrong(v.error());
      continue;
    }
    // In place of what the file says of this key.
    std::erase_if(o.vary, [&](const auto& known) {
      return known.key == key && known.written.where != v->written.where;
    });
    o.vary.push_back(std::move(*v));
  }
  if (!w.split.empty()) reading.take(dataset::parse_split({w.split, "--split"}), o.split);
  if (w.draw_devices) o.draw_devices = true;
  if (w.truth || w.no_truth) o.truth = w.truth;
  if (!w.renderer.empty()) o.renderer = w.renderer;
  if (auto s = reading.status(); !s) return tl::unexpected<Error>(s.error());
  return o;
}

Result<DatasetFolderOptions> read_folder(const Words& w, bool truth) {
  DatasetFolderOptions f;
  f.exr = w.arrays == "exr";
  if (!w.layers.empty()) {
    if (!truth) return fail(ErrorCode::bad_input, "--layers", "expected it with truth, got --no-truth");
    f.layers = w.layers == "all"    ? dataset_layers()
               : w.layers == "none" ? std::vector<std::string>{}
                                    : listed(w.layers);
    for (const std::string& layer : f.layers)
      if (std::find(dataset_layers().begin(), dataset_layers().end(), layer) == dataset_layers().end())
        return fail(ErrorCode::bad_input, "--layers",
                    fmt::format("expected all, none, or some of {}, got \"{}\"",
                                fmt::join(dataset_layers(), ", "), layer));
  }
  Reading reading;
  std::uint64_t area = f.min_area_px;
  reading.number(w.min_area, "--min-area", 1, 1'000'000, area);
  f.min_area_px = static_cast<std::uint32_t>(area);
  if (auto s = reading.status(); !s) return tl::unexpected<Error>(s.error());
  return f;
}

Result<FillOptions> read_work(const Words& w, std::uint64_t size) {
  FillOptions o;
  for (const std::string& word : listed(w.only)) {
    const auto dots = word.find("..");
    auto first = whole_number(word.substr(0, dots), "--only", 0, size - 1);
    if (!first) return tl::unexpected<Error>(first.error());
    auto last =
        dots == std::string::npos ? first : whole_number(word.substr(dots + 2), "--only", *first, size - 1);
    if (!last) return tl::unexpected<Error>(last.error());
    o.only.emplace_back(*first, *last);
  }
  std::uint64_t threads = 0;
  Reading reading;
  reading.number(w.jobs, "--jobs", 1, 1024, threads);
  if (auto s = reading.status(); !s) return tl::unexpected<Error>(s.error());
  o.threads = static_cast<int>(threads);
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

int make(const Words& w) {
  const auto wrong = [&](const Error& e) { return report_error(e, w.json); };
  auto options = read_options(w);
  if (!options) return wrong(options.error());
  const auto folder_options = read_folder(w, options->truth);
  if (!folder_options) return wrong(folder_options.error());
  auto dataset = Dataset::create(*options);
  if (!dataset) return wrong(dataset.error());
  const auto work = read_work(w, (*dataset)->size());
  if (!work) return wrong(work.error());
  auto folder = DatasetFolder::open(w.output, **dataset, *folder_options);
  if (!folder) return wrong(folder.error());
  const auto filled = fill_dataset(**dataset, **folder, *work);
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
  c.add_option("-o,--output", w.output, "Folder; one that was made with the same options is continued")
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
  const auto truth = c.add_flag("--truth", w.truth, "Boxes, masks and layers of truth (the default)");
  c.add_flag("--no-truth", w.no_truth, "Without truth").excludes(truth);
  c.add_option("--layers", w.layers,
               "Layers of truth: all, none, or some of depth,instance,class,true_range,normal,flow (default: "
               "the first three)");
  c.add_option("--arrays", w.arrays, "npy or exr: files of depths and other numbers (default npy)")
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
