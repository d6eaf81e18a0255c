#include "drivers/velodyne/calibration_file.h"

#include <charconv>
#include <cmath>
#include <fstream>
#include <numbers>
#include <sstream>
#include <string>
#include <vector>

#include "sensor-hal/config/yaml.h"

namespace rigor::velodyne {
namespace {

constexpr std::size_t kMaxFileBytes = 4u << 20;
constexpr double kDegree = std::numbers::pi / 180;

/// Bounds that a laser of either device stays far within.
struct Bounds {
  static constexpr Range angle_rad{.min = -std::numbers::pi, .max = std::numbers::pi};
  static constexpr Range elevation_rad{.min = -std::numbers::pi / 2, .max = std::numbers::pi / 2};
  static constexpr Range length_m{.min = -10, .max = 10};
  static constexpr Range slope{.min = -100, .max = 100};
  static constexpr Range focal_m{.min = -1000, .max = 1e6};
  static constexpr Range intensity{.min = 0, .max = 255};
};

Calibration read_yaml(ConfigNode root, Model model) {
  const DeviceFacts& f = facts_of(model);
  Calibration c;
  const std::int64_t count = root.integer("num_lasers", {.min = 1, .max = 4096});
  if (count != f.lasers)
    throw root.error("num_lasers", "expected " + std::to_string(f.lasers) + ", a " + std::string(f.name) +
                                       "'s, got " + std::to_string(count) +
                                       "; give the calibration of this device, or its `model`");
  c.range_unit_m = root.number_or("distance_resolution", kRangeUnit_m, {.min = 1e-4, .max = 0.1});
  c.lasers.resize(f.lasers);
  std::vector<bool> seen(f.lasers, false);
  // Files for 32 lasers come with entries up to 63, which are no lasers.
  for (const ConfigNode& n : root.list("lasers")) {
    const std::int64_t id = n.integer("laser_id", {.min = 0, .max = 4095});
    LaserCalibration l;
    l.elevation_rad = n.number("vert_correction", Bounds::elevation_rad);
    l.azimuth_rad = n.number_or("rot_correction", 0, Bounds::angle_rad);
    l.range_correction_m = n.number_or("dist_correction", 0, Bounds::length_m);
    l.vertical_offset_m = n.number_or("vert_offset_correction", 0, Bounds::length_m);
    l.horizontal_offset_m = n.number_or("horiz_offset_correction", 0, Bounds::length_m);
    l.min_intensity = n.number_or("min_intensity", 0, Bounds::intensity);
    l.max_intensity = n.number_or("max_intensity", 255, Bounds::intensity);
    l.focal_distance_m = n.number_or("focal_distance", 0, Bounds::focal_m) * 0.01;
    l.focal_slope = n.number_or("focal_slope", 0, Bounds::slope);
    (void)n.number_or("dist_correction_x", 0, Bounds::length_m);
    (void)n.number_or("dist_correction_y", 0, Bounds::length_m);
    if (n.flag_or("two_pt_correction_available", false))
      throw n.error("two_pt_correction_available",
                    "expected false: the two-point correction is that of an HDL-64E, got true");
    if (l.min_intensity > l.max_intensity) throw n.error("min_intensity", "expected at most max_intensity");
    n.finish();
    if (id >= f.lasers) continue;
    if (seen[static_cast<std::size_t>(id)])
      throw n.error("laser_id", "expected each laser once, got " + std::to_string(id) + " again");
    seen[static_cast<std::size_t>(id)] = true;
    c.lasers[static_cast<std::size_t>(id)] = l;
  }
  root.finish();
  for (std::size_t i = 0; i < seen.size(); ++i)
    if (!seen[i])
      throw root.error("lasers", "expected every laser from 0 to " + std::to_string(f.lasers - 1) +
                                     ", found none with laser_id " + std::to_string(i));
  return c;
}

/// Elements, their texts and where they stand: all of XML that these files use.
class XmlReader {
 public:
  XmlReader(std::string_view text, std::string_view name) : text_(text), name_(name) {}

  /// Calls `leaf(name, text)` for elements without children, `close(name)` for the others.
  template <class Leaf, class Close>
  void read(Leaf&& leaf, Close&& close) {
    std::vector<std::string_view> open;
    bool had_child = true;
    std::size_t text_begin = 0;
    while (true) {
      const std::size_t lt = text_.find('<', at_);
      if (lt == std::string_view::npos) break;
      at_ = lt;
      const std::size_t gt = text_.find('>', lt);
      if (gt == std::string_view::npos)
        throw error("expected `>` at the end of this tag, got the end of the file");
      std::string_view tag = text_.substr(lt + 1, gt - lt - 1);
      const std::size_t next = gt + 1;
      if (tag.empty()) throw error("expected a name in this tag, got <>");
      if (tag[0] == '!' && tag.substr(0, 3) == "!--") {
        const std::size_t end = text_.find("-->", lt);
        if (end == std::string_view::npos) throw error("expected `-->` at the end of this comment");
        at_ = end + 3;
        continue;
      }
      if (tag[0] == '!' || tag[0] == '?') {
        at_ = next;
        continue;
      }
      if (tag[0] == '/') {
        tag.remove_prefix(1);
        if (open.empty() || open.back() != tag)
          throw error("expected " + (open.empty() ? "no end tag" : "</" + std::string(open.back()) + ">") +
                      ", got </" + std::string(tag.substr(0, 40)) + ">");
        open.pop_back();
        if (had_child)
          close(tag);
        else
          leaf(tag, text_.substr(text_begin, lt - text_begin));
        had_child = true;
      } else if (tag.back() != '/') {
        const std::string_view element = tag.substr(0, tag.find_first_of(" \t\r\n"));
        if (open.size() >= 64) throw error("expected elements at most 64 deep");
        open.push_back(element);
        had_child = false;
        text_begin = next;
      }
      at_ = next;
    }
    if (!open.empty()) {
      at_ = text_.size();
      throw error("expected </" + std::string(open.back()) + ">, got the end of the file");
    }
  }
  [[nodiscard]] double number(std::string_view element, std::string_view text, Range range) const {
    const std::size_t first = text.find_first_not_of(" \t\r\n");
    const std::size_t last = text.find_last_not_of(" \t\r\n");
    double v = 0;
    bool good = false;
    if (first != std::string_view::npos) {
      text = text.substr(first, last - first + 1);
      const auto r = std::from_chars(text.data(), text.data() + text.size(), v);
      good = r.ec == std::errc{} && r.ptr == text.data() + text.size() && std::isfinite(v);
    }
    if (!good || v < range.min || v > range.max)
      throw error(std::string(element) + ": expected a number from " + shown(range.min) + " to " +
                  shown(range.max) + ", got \"" + std::string(text.substr(0, 40)) + "\"");
    return v;
  }
  [[nodiscard]] ConfigError error(const std::string& message) const {
    std::size_t line = 1, column = 1;
    for (std::size_t i = 0; i < at_ && i < text_.size(); ++i) {
      ++column;
      if (text_[i] == '\n') ++line, column = 1;
    }
    return ConfigError({ErrorCode::bad_input,
                        std::string(name_) + ":" + std::to_string(line) + ":" + std::to_string(column),
                        message});
  }

 private:
  static std::string shown(double v) {
    std::ostringstream s;
    s << v;
    return s.str();
  }
  std::string_view text_, name_;
  std::size_t at_ = 0;
};

Calibration read_xml(std::string_view text, std::string_view name, Model model) {
  const DeviceFacts& f = facts_of(model);
  Calibration c;
  c.lasers.resize(f.lasers);
  std::vector<bool> seen(f.lasers, false);
  std::vector<double> min_intensity, max_intensity, items;
  LaserCalibration l;
  double id = -1;
  bool has_elevation = false;
  XmlReader xml(text, name);
  xml.read(
      [&](std::string_view element, std::string_view value) {
        const auto number = [&](Range range) { return xml.number(element, value, range); };
        constexpr Range kDegrees{.min = -180, .max = 180}, kCentimetres{.min = -1000, .max = 1000};
        if (element == "id_") {
          id = number({.min = 0, .max = 4095});
        } else if (element == "rotCorrection_") {
          l.azimuth_rad = number(kDegrees) * kDegree;
        } else if (element == "vertCorrection_") {
          l.elevation_rad = number({.min = -90, .max = 90}) * kDegree;
          has_elevation = true;
        } else if (element == "distCorrection_") {
          l.range_correction_m = number(kCentimetres) * 0.01;
        } else if (element == "vertOffsetCorrection_") {
          l.vertical_offset_m = number(kCentimetres) * 0.01;
        } else if (element == "horizOffsetCorrection_") {
          l.horizontal_offset_m = number(kCentimetres) * 0.01;
        } else if (element == "focalDistance_") {
          l.focal_distance_m = number({.min = -1e5, .max = 1e8}) * 0.01;
        } else if (element == "focalSlope_") {
          l.focal_slope = number(Bounds::slope);
        } else if (element == "distLSB_") {
          c.range_unit_m = number({.min = 0.01, .max = 10}) * 0.01;
        } else if (element == "item" && items.size() < 4096) {
          items.push_back(number({.min = -1e9, .max = 1e9}));
        }
      },
      [&](std::string_view element) {
        if (element == "px") {
          if (id < 0) throw xml.error("px: expected an <id_> in it, found none");
          const auto at = static_cast<std::size_t>(id);
          if (at < f.lasers) {
            if (!has_elevation) throw xml.error("px: expected a <vertCorrection_> in it, found none");
            if (seen[at])
              throw xml.error("id_: expected each laser once, got " + std::to_string(at) + " again");
            seen[at] = true;
            c.lasers[at] = l;
          }
          l = {};
          id = -1;
          has_elevation = false;
        } else if (element == "minIntensity_") {
          min_intensity = items;
        } else if (element == "maxIntensity_") {
          max_intensity = items;
        }
        if (element != "px" && element != "item") items.clear();
      });
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (!seen[i])
      throw xml.error("expected a <px> for every laser from 0 to " + std::to_string(f.lasers - 1) +
                      ", found none with id_ " + std::to_string(i));
    const double low = i < min_intensity.size() ? min_intensity[i] : 0;
    const double high = i < max_intensity.size() ? max_intensity[i] : 255;
    if (!(low >= 0 && low <= high && high <= 255))
      throw xml.error("minIntensity_, maxIntensity_: expected 0 to 255 in this order for laser " +
                      std::to_string(i));
    c.lasers[i].min_intensity = low, c.lasers[i].max_intensity = high;
  }
  return c;
}

}  // namespace

Result<Calibration> parse_calibration(std::string_view text, std::string_view name, Model model) {
  const std::size_t first = text.find_first_not_of(" \t\r\n\xEF\xBB\xBF");
  if (first != std::string_view::npos && text[first] == '<')
    return catch_config([&] { return read_xml(text, name, model); });
  auto root = ConfigDocument::parse(text, name);
  if (!root) return tl::unexpected<Error>(root.error());
  return catch_config([&] { return read_yaml(*root, model); });
}

Result<Calibration> load_calibration(const std::filesystem::path& file, Model model) {
  std::ifstream in(file, std::ios::binary);
  std::error_code ec;
  if (!in || std::filesystem::is_directory(file, ec))
    return fail(ErrorCode::not_found, file.string(),
                "expected a calibration file, got nothing that can be read");
  std::string text(kMaxFileBytes + 1, '\0');
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(in.gcount()));
  if (text.size() > kMaxFileBytes)
    return fail(ErrorCode::bad_input, file.string(), "expected a calibration file of at most 4 MiB");
  return parse_calibration(text, file.string(), model);
}

}  // namespace rigor::velodyne
