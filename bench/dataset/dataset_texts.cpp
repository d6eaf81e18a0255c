#include "bench/dataset/dataset_texts.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <limits>
#include <tuple>
#include <utility>

#include "bench/sensing/clearance.h"

namespace rigor {

std::vector<std::string> words_of_list(const std::string& text) {
  std::vector<std::string> words;
  for (std::size_t at = 0; at <= text.size() && !text.empty();) {
    const std::size_t end = std::min(text.find(',', at), text.size());
    words.push_back(text.substr(at, end - at));
    at = end + 1;
  }
  return words;
}

Result<std::uint64_t> whole_number(const std::string& text, const std::string& option, std::uint64_t least,
                                   std::uint64_t most) {
  std::uint64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || value < least || value > most)
    return fail(ErrorCode::bad_input, option,
                fmt::format("expected a whole number from {} to {}, got \"{}\"", least, most, text));
  return value;
}

namespace {

using dataset::Interval;
using dataset::PoseChoice;

/// Keeps the first error of many values.
class Reading {
 public:
  void number(const std::string& text, const std::string& option, std::uint64_t least, std::uint64_t most,
              std::uint64_t& out) {
    if (text.empty()) return;
    take(whole_number(text, option, least, most), out);
  }
  template <class Out>
  void interval(const std::string& text, const std::string& option, double min, double max, Out& out) {
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

Status read_poses(const DatasetTexts& w, PoseChoice& p, Reading& reading) {
  const std::string& d = w.dashes;
  const int ways = int{!w.poses.empty()} + int{!w.within.empty()} + int{!w.along.empty()};
  if (ways > 1)
    return fail(ErrorCode::bad_input, fmt::format("{0}poses, {0}within, {0}along", d),
                "expected one of them, got several");
  if (ways == 1) {
    PoseChoice other;
    other.pitch_deg = p.pitch_deg;
    other.roll_deg = p.roll_deg;
    p = other;
  }
  if (!w.poses.empty()) {
    p.kind = PoseChoice::Kind::list;
    p.file = w.poses;
    p.where = d + "poses";
  } else if (!w.along.empty()) {
    p.kind = PoseChoice::Kind::along;
    p.file = w.along;
    p.where = d + "along";
  } else if (!w.within.empty()) {
    p.kind = PoseChoice::Kind::within;
    reading.take(dataset::parse_rectangle({w.within, d + "within"}), p.within);
  }
  // An option that says nothing about these poses is a mistake.
  const bool drawn = p.kind == PoseChoice::Kind::within || p.kind == PoseChoice::Kind::along;
  for (const auto& [option, text, fits] :
       {std::tuple{"height", &w.height, drawn || p.kind == PoseChoice::Kind::list},
        {"yaw", &w.yaw, drawn},
        {"pitch", &w.pitch, drawn},
        {"roll", &w.roll, drawn},
        {"lateral", &w.lateral, p.kind == PoseChoice::Kind::along}})
    if (!text->empty() && !fits)
      return fail(ErrorCode::bad_input, d + option,
                  option == std::string_view("lateral") ? fmt::format("expected it with {}along", d)
                  : option == std::string_view("height")
                      ? fmt::format("expected it with {0}poses, {0}within or {0}along", d)
                      : fmt::format("expected it with {0}within or {0}along", d));
  reading.interval(w.height, d + "height", 0, dataset::kMostHeight_m, p.height_m);
  reading.interval(w.yaw, d + "yaw", -dataset::kMostAngle_deg, dataset::kMostAngle_deg, p.yaw_deg);
  reading.interval(w.pitch, d + "pitch", -90, 90, p.pitch_deg);
  reading.interval(w.roll, d + "roll", -180, 180, p.roll_deg);
  reading.interval(w.lateral, d + "lateral", -dataset::kMostLateral_m, dataset::kMostLateral_m, p.lateral_m);
  return {};
}

}  // namespace

Result<DatasetOptions> read_dataset_options(const DatasetTexts& w) {
  const std::string& d = w.dashes;
  DatasetOptions o;
  if (is_dataset_file(w.source)) {
    auto loaded = load_dataset_options(w.source);
    if (!loaded) return loaded;
    o = std::move(*loaded);
  } else {
    o.rig = w.source;
  }
  for (const std::string& text : w.overrides) {
    auto one = ConfigOverride::parse(text);
    if (!one) return tl::unexpected<Error>(one.error());
    o.overrides.push_back(std::move(*one));
  }
  if (!w.channels.empty()) o.channels = words_of_list(w.channels);
  Reading reading;
  reading.number(w.samples, d + "sample", 1, DatasetOptions::kMostSamples, o.samples);
  reading.number(w.seed, d + "seed", 0, std::numeric_limits<std::int64_t>::max(), o.seed);
  if (auto s = read_poses(w, o.poses, reading); !s) return tl::unexpected<Error>(s.error());
  Interval clearance{o.clearance_m, o.clearance_m};
  reading.interval(w.clearance, d + "clearance", 0, ClearanceProbe::kReach_m, clearance);
  o.clearance_m = clearance.to;
  for (const std::string& text : w.vary) {
    const auto equals = text.find('=');
    if (equals == std::string::npos) {
      reading.wrong({ErrorCode::bad_input, d + "vary", "expected KEY=VALUES, got \"" + text + "\""});
      continue;
    }
    const std::string key = text.substr(0, equals);
    auto v = dataset::Variation::parse(key, {text.substr(equals + 1), d + "vary " + key});
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
  if (!w.split.empty()) reading.take(dataset::parse_split({w.split, d + "split"}), o.split);
  if (w.draw_devices) o.draw_devices = true;
  if (w.truth) o.truth = *w.truth;
  if (!w.renderer.empty()) o.renderer = w.renderer;
  if (auto s = reading.status(); !s) return tl::unexpected<Error>(s.error());
  return o;
}

}  // namespace rigor
