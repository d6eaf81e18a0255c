#include "bench/dataset/dataset_options.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "bench/sensing/clearance.h"
#include "sensor-hal/config/value_or_throw.h"

namespace rigor {
namespace dataset {
namespace {

Result<std::vector<double>> numbers(const Written& written, std::size_t count, const char* what) {
  const auto wrong =
      fail(ErrorCode::bad_input, written.where, fmt::format("expected {}, got \"{}\"", what, written.text));
  std::vector<double> out;
  for (std::size_t at = 0; at <= written.text.size();) {
    const std::size_t end = std::min(written.text.find(',', at), written.text.size());
    const std::string word = written.text.substr(at, end - at);
    auto one = Interval::parse({word, written.where}, -1e8, 1e8);
    if (!one || one->from != one->to) return wrong;
    out.push_back(one->from);
    at = end + 1;
  }
  if (out.size() != count) return wrong;
  return out;
}

}  // namespace

Result<std::array<double, 3>> parse_split(const Written& written) {
  constexpr const char* kWhat = "three numbers that are not negative and not all 0, such as 80,10,10";
  const auto n = numbers(written, 3, kWhat);
  if (!n) return tl::unexpected<Error>(n.error());
  if ((*n)[0] < 0 || (*n)[1] < 0 || (*n)[2] < 0 || (*n)[0] + (*n)[1] + (*n)[2] <= 0)
    return fail(ErrorCode::bad_input, written.where,
                fmt::format("expected {}, got \"{}\"", kWhat, written.text));
  return std::array<double, 3>{(*n)[0], (*n)[1], (*n)[2]};
}

Result<std::array<double, 4>> parse_rectangle(const Written& written) {
  constexpr const char* kWhat = "x0,y0,x1,y1 in metres with x0 up to x1 and y0 up to y1";
  const auto n = numbers(written, 4, kWhat);
  if (!n) return tl::unexpected<Error>(n.error());
  if ((*n)[0] > (*n)[2] || (*n)[1] > (*n)[3])
    return fail(ErrorCode::bad_input, written.where,
                fmt::format("expected {}, got \"{}\"", kWhat, written.text));
  return std::array<double, 4>{(*n)[0], (*n)[1], (*n)[2], (*n)[3]};
}

namespace {

/// "data.yaml:7:3: poses.file", as messages have it.
std::string place_of(const ConfigNode& n, const std::string& key) {
  const Error at = n.error(key, "").error();
  const std::string path = at.message.substr(0, at.message.find(": "));
  return at.where.empty() ? path : at.where + ": " + path;
}

/// A scalar, or the items of a list with commas between them.
std::string words_of(const ConfigNode& n, const std::string& key) {
  if (!n.scalar_or_empty(key).empty()) return n.text(key);
  std::string words;
  for (const ConfigNode& item : n.list(key)) words += (words.empty() ? "" : ",") + item.as_text();
  return words;
}

void read_interval(const ConfigNode& n, const char* key, double min, double max, Interval& out) {
  if (!n.has(key)) return;
  const auto read = Interval::parse({n.text(key), ""}, min, max);
  if (!read) throw n.error(key, read.error().message);
  out = *read;
}
void read_interval(const ConfigNode& n, const char* key, double min, double max,
                   std::optional<Interval>& out) {
  Interval value;
  if (!n.has(key)) return;
  read_interval(n, key, min, max, value);
  out = value;
}

PoseChoice read_poses(const ConfigNode& n) {
  PoseChoice p;
  if (int{n.has("file")} + int{n.has("within")} + int{n.has("along")} != 1)
    throw n.error("", "expected one of file, within and along");
  if (n.has("within")) {
    p.kind = PoseChoice::Kind::within;
    const auto v = n.numbers("within", 4);
    if (v[0] > v[2] || v[1] > v[3])
      throw n.error("within",
                    "expected [x0, y0, x1, y1] with x0 up to x1 and y0 up to y1, got another order");
    p.within = {v[0], v[1], v[2], v[3]};
  } else {
    const char* key = n.has("file") ? "file" : "along";
    p.kind = n.has("file") ? PoseChoice::Kind::list : PoseChoice::Kind::along;
    p.file = n.base_dir() / n.text(key);
    p.where = place_of(n, key);
  }
  read_interval(n, "height_m", 0, kMostHeight_m, p.height_m);
  if (p.kind != PoseChoice::Kind::list) {
    read_interval(n, "yaw_deg", -kMostAngle_deg, kMostAngle_deg, p.yaw_deg);
    read_interval(n, "pitch_deg", -90, 90, p.pitch_deg);
    read_interval(n, "roll_deg", -180, 180, p.roll_deg);
  }
  if (p.kind == PoseChoice::Kind::along)
    read_interval(n, "lateral_m", -kMostLateral_m, kMostLateral_m, p.lateral_m);
  n.finish();
  return p;
}

DatasetOptions read(const ConfigNode& n) {
  DatasetOptions o;
  o.rig = n.base_dir() / n.text("rig");
  for (const ConfigNode& item : n.list_or_empty("set")) {
    auto set = ConfigOverride::parse(item.as_text());
    if (!set) throw item.error("", set.error().message);
    o.overrides.push_back(std::move(*set));
  }
  for (const ConfigNode& item : n.list_or_empty("channels")) o.channels.push_back(item.as_text());
  o.samples = static_cast<std::uint64_t>(
      n.integer_or("samples", 0, {.min = 0, .max = double{DatasetOptions::kMostSamples}}));
  o.seed = static_cast<std::uint64_t>(n.integer_or("seed", 1, {.min = 0}));
  if (const ConfigNode poses = n.map_or_absent("poses"); poses.present()) o.poses = read_poses(poses);
  o.clearance_m = n.number_or("clearance_m", o.clearance_m, {.min = 0, .max = ClearanceProbe::kReach_m});
  if (const ConfigNode vary = n.map_or_absent("vary"); vary.present())
    for (const std::string& key : vary.keys()) {
      auto v = Variation::parse(key, {words_of(vary, key), ""});
      if (!v) throw vary.error(key, v.error().message);
      v->written.where = place_of(vary, key);
      o.vary.push_back(std::move(*v));
    }
  o.draw_devices = n.flag_or("draw_devices", false);
  o.truth = n.flag_or("truth", true);
  o.renderer = n.choice_or("renderer", {"rays", "raster"}, "");
  if (const ConfigNode split = n.map_or_absent("split"); split.present()) {
    const char* const names[] = {"train", "val", "test"};
    for (std::size_t i = 0; i < 3; ++i) o.split[i] = split.number_or(names[i], 0, {.min = 0});
    if (o.split[0] + o.split[1] + o.split[2] <= 0)
      throw n.error("split", "expected a weight above 0 of train, val or test, found none");
    split.finish();
  }
  n.finish();
  return o;
}

}  // namespace
}  // namespace dataset

bool is_dataset_file(const std::filesystem::path& file) {
  const auto n = ConfigDocument::load(file);
  return n && n->is_map() && n->has("rig");
}

Result<DatasetOptions> load_dataset_options(const std::filesystem::path& file) {
  auto n = ConfigDocument::load(file);
  if (!n) return tl::unexpected<Error>(n.error());
  return catch_config([&] { return dataset::read(*n); });
}

nlohmann::json DatasetOptions::json() const {
  using Kind = dataset::PoseChoice::Kind;
  nlohmann::json p{{"pitch_deg", poses.pitch_deg.text()}, {"roll_deg", poses.roll_deg.text()}};
  if (poses.kind == Kind::list) p = {{"file", poses.file.filename().string()}};
  if (poses.kind == Kind::along) p["along"] = poses.file.filename().string();
  if (poses.kind == Kind::along) p["lateral_m"] = poses.lateral_m.text();
  if (poses.kind == Kind::within) p["within"] = poses.within;
  if (poses.kind == Kind::rig) p = {{"rig", true}};
  if (poses.height_m) p["height_m"] = poses.height_m->text();
  if (poses.yaw_deg) p["yaw_deg"] = poses.yaw_deg->text();
  nlohmann::json vary_json = nlohmann::json::array();
  for (const dataset::Variation& v : vary) vary_json.push_back({v.key, v.written.text});
  nlohmann::json set = nlohmann::json::array();
  for (const ConfigOverride& o : overrides) set.push_back(o.path + "=" + o.value);
  return {{"rig", rig.filename().string()},
          {"set", set},
          {"channels", channels},
          {"samples", samples},
          {"seed", seed},
          {"poses", p},
          {"clearance_m", clearance_m},
          {"vary", vary_json},
          {"draw_devices", draw_devices},
          {"truth", truth},
          {"renderer", renderer},
          {"split", split}};
}

}  // namespace rigor
