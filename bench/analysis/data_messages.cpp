#include "bench/analysis/data_messages.h"

#include <algorithm>
#include <array>
#include <bitset>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>

#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/point_layout.h"

namespace rigor {
namespace {

namespace msg = record::msg;

constexpr double kNoIntensity = std::numeric_limits<double>::quiet_NaN();

/// The first field of a definition as ros2msg: its type.
std::string_view first_field_type(std::string_view text) {
  while (!text.empty()) {
    std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(text.size(), line.size() + 1));
    line = line.substr(0, line.find('#'));
    const std::size_t begin = line.find_first_not_of(" \t\r");
    if (begin == std::string_view::npos) continue;
    if (line.starts_with("===")) return {};
    line.remove_prefix(begin);
    // Constants are no fields.
    if (line.find('=') != std::string_view::npos) continue;
    return line.substr(0, line.find_first_of(" \t\r"));
  }
  return {};
}

/// A type's package and name, without `msg`.
std::pair<std::string_view, std::string_view> parts_of(std::string_view type) {
  const std::size_t first = type.find('/'), last = type.rfind('/');
  if (first == std::string_view::npos) return {"", type};
  return {type.substr(0, first), type.substr(last + 1)};
}

bool is_spatial(std::string_view type) {
  const auto [package, name] = parts_of(type);
  static constexpr std::array kSensors{
      "PointCloud2", "PointCloud", "LaserScan", "MultiEchoLaserScan", "Image",          "CameraInfo",
      "Imu",         "NavSatFix",  "Range",     "MagneticField",      "CompressedImage"};
  if (package == "sensor_msgs") return std::find(kSensors.begin(), kSensors.end(), name) != kSensors.end();
  return package == "geometry_msgs" || package == "nav_msgs" || package == "visualization_msgs";
}

/// Mean over what is finite.
class Mean {
 public:
  void add(double v) {
    if (!std::isfinite(v)) return;
    sum_ += v;
    ++count_;
  }
  [[nodiscard]] double value() const {
    return count_ > 0 ? sum_ / static_cast<double>(count_) : kNoIntensity;
  }

 private:
  double sum_ = 0;
  std::uint64_t count_ = 0;
};

}  // namespace

MessageForm form_of(const record::Channel& channel, const record::Schema* schema) {
  MessageForm form;
  if (!schema || channel.message_encoding != "cdr") return form;
  const std::string_view type = schema->name;
  if (type == msg::TFMessage::kType) {
    form.content = MessageForm::Content::frames;
    return form;
  }
  // What tells of many things has as many messages of one instant.
  if (type == msg::Event::kType || type == msg::Fault::kType || type == msg::Command::kType ||
      type == msg::DiagnosticArray::kType)
    return form;
  form.spatial = is_spatial(type);
  if (type == msg::PointCloud2::kType) form.content = MessageForm::Content::cloud;
  if (type == msg::LaserScan::kType) form.content = MessageForm::Content::scan;
  if (schema->encoding == "ros2msg") {
    const auto [package, name] = parts_of(first_field_type(schema->text));
    form.header = name == "Header" && (package == "std_msgs" || package.empty());
  } else {
    form.header = form.spatial && parts_of(type).second != "MarkerArray";
    // Of geometry_msgs those with a stamp have a header, in whatever language they are defined.
    if (parts_of(type).first == "geometry_msgs") form.header = type.ends_with("Stamped");
  }
  return form;
}

Result<ScanContent> read_cloud(record::Bytes message) {
  msg::PointCloud2 cloud;
  if (auto s = record::CdrReader::read(message, cloud); !s) return tl::unexpected<Error>(s.error());
  if (auto s = record::check_cloud(cloud); !s) return tl::unexpected<Error>(s.error());
  const msg::PointField *x = record::field_named(cloud, "x"), *y = record::field_named(cloud, "y"),
                        *z = record::field_named(cloud, "z");
  const msg::PointField* intensity = record::field_named(cloud, "intensity");
  if (!intensity) intensity = record::field_named(cloud, "reflectivity");
  ScanContent content;
  const std::size_t count = std::size_t{cloud.width} * cloud.height;
  if (!x || !y || !z) {  // of something else than places: its number is all
    content.points = count;
    content.mean_intensity = kNoIntensity;
    return content;
  }
  std::bitset<360> degrees;
  Mean mean;
  for (std::size_t i = 0; i < count; ++i) {
    const double px = record::number_at(cloud, *x, i), py = record::number_at(cloud, *y, i),
                 pz = record::number_at(cloud, *z, i);
    if (!std::isfinite(px + py + pz) || (px == 0 && py == 0 && pz == 0)) continue;
    ++content.points;
    const double degree = std::floor(std::atan2(py, px) * 180 / std::numbers::pi + 180);
    degrees.set(static_cast<std::size_t>(std::clamp(degree, 0.0, 359.0)));
    if (intensity) mean.add(record::number_at(cloud, *intensity, i));
  }
  content.columns = degrees.count();
  content.mean_intensity = mean.value();
  return content;
}

Result<ScanContent> read_scan(record::Bytes message) {
  msg::LaserScan scan;
  if (auto s = record::CdrReader::read(message, scan); !s) return tl::unexpected<Error>(s.error());
  ScanContent content;
  content.columns = scan.ranges.size();
  Mean mean;
  for (std::size_t i = 0; i < scan.ranges.size(); ++i) {
    if (!std::isfinite(scan.ranges[i])) continue;
    ++content.points;
    if (i < scan.intensities.size()) mean.add(scan.intensities[i]);
  }
  content.mean_intensity = mean.value();
  return content;
}

}  // namespace rigor
