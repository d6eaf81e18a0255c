#include "bench/dataset/variation.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <optional>

#include "sensor-hal/config/yaml.h"
#include "sensor-hal/models/philox.h"

namespace rigor::dataset {
namespace {

std::optional<double> number(std::string_view text) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

std::vector<std::string> split_words(const std::string& text) {
  std::vector<std::string> words(1);
  int depth = 0;
  for (const char c : text) {
    if (c == '[' || c == '{') ++depth;
    if (c == ']' || c == '}') --depth;
    if (c == ',' && depth <= 0)
      words.emplace_back();
    else
      words.back() += c;
  }
  for (std::string& word : words) {
    while (!word.empty() && word.front() == ' ') word.erase(0, 1);
    while (!word.empty() && word.back() == ' ') word.pop_back();
  }
  return words;
}

struct Ends {
  double from = 0, to = 0;
};
/// Of "50..500"; empty where it is no range.
std::optional<Ends> range_of(std::string_view text) {
  const auto dots = text.find("..");
  if (dots == std::string_view::npos) return std::nullopt;
  const auto from = number(text.substr(0, dots)), to = number(text.substr(dots + 2));
  if (!from || !to) return std::nullopt;
  return Ends{*from, *to};
}

/// Two dots that are no part of a path such as ../sensors/a.yaml.
bool has_range_dots(std::string_view text) {
  for (auto at = text.find(".."); at != std::string_view::npos; at = text.find("..", at + 1)) {
    const bool before = at > 0 && text[at - 1] == '/', behind = at + 2 < text.size() && text[at + 2] == '/';
    if (!before && !behind) return true;
  }
  return false;
}

constexpr std::string_view kLog = "log:";

}  // namespace

Result<Values> Values::parse(const Written& written) {
  Values v;
  std::string_view text = written.text;
  v.logarithmic_ = text.starts_with(kLog);
  if (v.logarithmic_) text.remove_prefix(kLog.size());
  if (has_range_dots(text) || v.logarithmic_) {
    const auto colon = text.rfind(':');
    const auto ends = range_of(text.substr(0, colon));
    if (!ends || ends->from > ends->to || (v.logarithmic_ && ends->from <= 0))
      return fail(
          ErrorCode::bad_input, written.where,
          fmt::format("expected two numbers, the smaller one first{}, such as {}50..500, got \"{}\"",
                      v.logarithmic_ ? " and above 0" : "", v.logarithmic_ ? "log:" : "", written.text));
    v.from_ = ends->from;
    v.to_ = ends->to;
    if (colon == std::string_view::npos) return v;
    const auto steps = number(text.substr(colon + 1));
    if (!steps || *steps < 2 || *steps > static_cast<double>(kMostSteps) || *steps != std::floor(*steps))
      return fail(ErrorCode::bad_input, written.where,
                  fmt::format("expected how many numbers behind the colon, 2 to {}, such as 50..500:10, got "
                              "\"{}\"",
                              kMostSteps, written.text));
    for (double i = 0; i < *steps; ++i)
      v.words_.push_back(fmt::format("{:.10g}", v.number_at(i / (*steps - 1))));
    return v;
  }
  v.words_ = split_words(written.text);
  for (const std::string& word : v.words_)
    if (word.empty())
      return fail(
          ErrorCode::bad_input, written.where,
          fmt::format("expected values with commas between them, or a range such as 50..500, got \"{}\"",
                      written.text));
  return v;
}

double Values::number_at(double u) const {
  return logarithmic_ ? from_ * std::pow(to_ / from_, u) : from_ + (to_ - from_) * u;
}

std::string Values::at(double u) const {
  if (!words_.empty()) {
    const auto i = static_cast<std::size_t>(u * static_cast<double>(words_.size()));
    return words_[std::min(i, words_.size() - 1)];
  }
  return fmt::format("{:.6g}", number_at(u));
}

Result<Interval> Interval::parse(const Written& written, double min, double max) {
  std::optional<Ends> ends = range_of(written.text);
  if (const auto one = number(written.text)) ends = Ends{*one, *one};
  if (!ends || ends->from > ends->to || ends->from < min || ends->to > max)
    return fail(ErrorCode::bad_input, written.where,
                fmt::format("expected a number from {:g} to {:g}, or two with the smaller one first, such as "
                            "1..2, got \"{}\"",
                            min, max, written.text));
  return Interval{ends->from, ends->to};
}

std::string Interval::text() const {
  return from == to ? fmt::format("{}", from) : fmt::format("{}..{}", from, to);
}

std::vector<std::pair<std::string, std::string>> weather_texts(const std::string& preset) {
  std::vector<std::pair<std::string, std::string>> texts;
  for (const auto& [attribute, value] : weather_preset(preset))
    texts.emplace_back(attribute, fmt::format("{:g}", value));
  return texts;
}

Result<Variation> Variation::parse(const std::string& key, const Written& written) {
  Variation v;
  v.key = key;
  v.written = written;
  auto values = Values::parse(written);
  if (!values) return tl::unexpected<Error>(values.error());
  v.values = std::move(*values);
  const auto wrong = [&](const std::string& what) { return fail(ErrorCode::bad_input, written.where, what); };
  const auto all_numbers = [&]() -> Status {
    for (const std::string& word : v.values.words())
      if (!number(word))
        return wrong(fmt::format("expected numbers or a range such as 50..500, got \"{}\"", word));
    return {};
  };
  const auto dot = key.find('.');
  const std::string first = key.substr(0, dot), rest = dot == std::string::npos ? "" : key.substr(dot + 1);
  if (key == "simulation.weather") {
    v.of = Of::weather;
    if (v.values.words().empty()) return wrong("expected presets, got a range");
    for (const std::string& word : v.values.words())
      if (std::find(weather_presets().begin(), weather_presets().end(), word) == weather_presets().end())
        return wrong(fmt::format("expected presets of the weather ({}), got \"{}\"",
                                 fmt::join(weather_presets(), ", "), word));
    return v;
  }
  if (first == "joint" && !rest.empty()) {
    v.of = Of::joint;
    v.name = rest;
    if (auto s = all_numbers(); !s) return tl::unexpected<Error>(s.error());
    return v;
  }
  if (first == "channels") {
    v.of = Of::channel;
    const auto last = rest.rfind('.');
    v.name = rest.substr(0, last);
    v.attribute = last == std::string::npos ? "" : rest.substr(last + 1);
    if (v.attribute != "exposure_us" && v.attribute != "gain_db")
      return wrong(
          fmt::format("expected channels.NAME.exposure_us or channels.NAME.gain_db, got \"{}\"", key));
    if (auto s = all_numbers(); !s) return tl::unexpected<Error>(s.error());
    // What a channel takes in a rig.
    const bool exposure = v.attribute == "exposure_us";
    const double least = exposure ? 1 : -40, most = exposure ? 60e6 : 80;
    std::vector<std::string> ends = v.values.words();
    if (ends.empty()) ends = {v.values.at(0), v.values.at(1)};
    for (const std::string& end : ends)
      if (const double value = *number(end); value < least || value > most)
        return wrong(
            fmt::format("expected {:.8g} to {:.8g} {}, got {}", least, most, exposure ? "µs" : "dB", end));
    return v;
  }
  if (rest.empty() || first.front() < 'A' || first.front() > 'Z')
    return wrong(
        fmt::format("expected simulation.weather, Type.attribute, joint.NAME or channels.NAME.exposure_us "
                    "or .gain_db, got \"{}\"",
                    key));
  return v;
}

std::array<double, 4> draw(std::uint64_t seed, Draw what, std::uint64_t index, std::uint32_t element) {
  // A key of its own for each kind of draw.
  static constexpr std::string_view kNames[] = {"dataset.pose", "dataset.value", "dataset.device",
                                                "dataset.split"};
  const auto key =
      models::channel_key(seed, models::channel_id_from_name(kNames[static_cast<std::size_t>(what)]));
  const auto words = models::philox(
      {element, 0, static_cast<std::uint32_t>(index), static_cast<std::uint32_t>(index >> 32)}, key);
  std::array<double, 4> u{};
  for (std::size_t i = 0; i < 4; ++i) u[i] = (words[i] + 0.5) / 4294967296.0;
  return u;
}

std::vector<std::pair<std::string, std::string>> draw_conditions(const std::vector<Variation>& variations,
                                                                 std::uint64_t seed, std::uint64_t index) {
  std::vector<std::pair<std::string, std::string>> out;
  std::map<std::string, std::string> preset;
  for (const Variation& v : variations) {
    out.emplace_back(v.key,
                     v.values.at(draw(seed, Draw::value, index, models::channel_id_from_name(v.key))[0]));
    if (v.of == Variation::Of::weather)
      for (const auto& [attribute, value] : weather_texts(out.back().second)) preset[attribute] = value;
  }
  if (preset.empty()) return out;
  for (const auto& [attribute, clear] : weather_texts("clear"))
    if (preset[attribute] == clear)
      for (auto& [key, value] : out)
        if (key == "Atmosphere." + attribute) value.clear();
  return out;
}

}  // namespace rigor::dataset
