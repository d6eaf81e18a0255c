#include "drivers/ouster/sensor_metadata.h"

#include <charconv>
#include <cmath>
#include <fstream>
#include <iterator>

#include "drivers/ouster/bounded_json.h"

namespace rigor::ouster {
namespace {

using nlohmann::json;

constexpr std::size_t kMaxBytes = 4 << 20;

struct BadMetadata {
  std::string key, message;
};

std::string shown(const json& v) {
  std::string t = v.dump(-1, ' ', true, json::error_handler_t::replace);
  return t.size() > 60 ? t.substr(0, 57) + "..." : t;
}

/// A value by its place in either form; nullptr: in none.
class Reader {
 public:
  explicit Reader(const json& root)
      : root_(root), nested_(root.contains("lidar_data_format") || root.contains("sensor_info")) {}

  /// `group` of the nested form; `flat_group` of the flat one, empty: at the top.
  [[nodiscard]] const json* find(const char* group, const char* key, const char* flat_group = "") {
    const json* from = &root_;
    const char* inside = nested_ ? group : flat_group;
    key_ = *inside ? std::string(inside) + "." + key : key;
    if (*inside) {
      const auto at = root_.find(inside);
      if (at == root_.end()) return nullptr;
      if (!at->is_object()) throw BadMetadata{inside, "expected a map, got " + shown(*at)};
      from = &*at;
    }
    const auto at = from->find(key);
    return at == from->end() || at->is_null() ? nullptr : &*at;
  }
  [[nodiscard]] const std::string& key() const { return key_; }
  [[noreturn]] void refuse(const std::string& message) const { throw BadMetadata{key_, message}; }

  [[nodiscard]] std::string text(const char* group, const char* key) {
    const json* v = find(group, key);
    if (!v) return {};
    if (v->is_number_integer()) return std::to_string(v->get<std::int64_t>());  // serials
    if (!v->is_string()) refuse("expected text, got " + shown(*v));
    return v->get<std::string>();
  }
  [[nodiscard]] std::int64_t whole(const json& v, std::int64_t min, std::int64_t max) const {
    if (!v.is_number_integer() || v.get<std::int64_t>() < min || v.get<std::int64_t>() > max)
      refuse("expected a whole number from " + std::to_string(min) + " to " + std::to_string(max) + ", got " +
             shown(v));
    return v.get<std::int64_t>();
  }
  [[nodiscard]] double number(const json& v, double most) const {
    if (!v.is_number() || !(std::abs(v.get<double>()) <= most))
      refuse("expected a number of at most " + std::to_string(most) + ", got " + shown(v));
    return v.get<double>();
  }
  [[nodiscard]] std::vector<double> numbers(const json& v, std::size_t count, double most) const {
    if (!v.is_array() || v.size() != count)
      refuse("expected " + std::to_string(count) + " numbers, got " +
             (v.is_array() ? std::to_string(v.size()) : shown(v)));
    std::vector<double> out;
    for (const json& n : v) out.push_back(number(n, most));
    return out;
  }
  /// A rigid transform in millimetres.
  [[nodiscard]] std::array<double, 16> transform(const json& v) const {
    const std::vector<double> n = numbers(v, 16, 1e6);
    std::array<double, 16> t{};
    std::copy(n.begin(), n.end(), t.begin());
    for (std::size_t row = 0; row < 3; ++row) {
      for (std::size_t other = 0; other <= row; ++other) {
        double dot = 0;
        for (std::size_t c = 0; c < 3; ++c) dot += t[row * 4 + c] * t[other * 4 + c];
        if (std::abs(dot - (row == other ? 1 : 0)) > 1e-3)
          refuse(
              "expected a rotation and a translation, got rows that are not square to each other or not of "
              "length 1");
      }
      t[row * 4 + 3] *= 1e-3;
    }
    if (t[12] != 0 || t[13] != 0 || t[14] != 0 || t[15] != 1)
      refuse("expected the last row 0, 0, 0, 1, got " + shown(v));
    return t;
  }

 private:
  const json& root_;
  bool nested_;
  std::string key_;
};

/// What sensors without these keys have (OS1, the only line of their time).
constexpr double kOs1BeamOrigin_m = 12.163e-3;
constexpr std::array<double, 16> kOs1SensorLidar{-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18e-3, 0, 0, 0, 1};
constexpr std::array<double, 16> kOs1SensorImu{1, 0, 0, 6.253e-3, 0, 1, 0, -11.775e-3,
                                               0, 0, 1, 7.645e-3, 0, 0, 0, 1};

Metadata read(const json& root) {
  if (!root.is_object()) throw BadMetadata{"", "expected a map, got " + shown(root)};
  Reader r(root);
  Metadata m;
  m.product_line = r.text("sensor_info", "prod_line");
  m.serial = r.text("sensor_info", "prod_sn");
  m.firmware = r.text("sensor_info", "build_rev");
  m.status = r.text("sensor_info", "status");
  m.timestamp_mode = r.text("config_params", "timestamp_mode");
  const std::string mode = r.text("config_params", "lidar_mode");
  const auto named = mode_named(mode);
  if (!named) r.refuse("expected a mode like 1024x10, got \"" + mode + "\"");
  m.mode = *named;

  const char* format = "lidar_data_format";
  if (const json* v = r.find(format, "udp_profile_lidar", "data_format")) {
    const auto profile = v->is_string() ? profile_named(v->get<std::string>()) : std::nullopt;
    if (!profile)
      r.refuse(
          "expected LEGACY, RNG19_RFL8_SIG16_NIR16, RNG19_RFL8_SIG16_NIR16_DUAL or RNG15_RFL8_NIR8, got " +
          shown(*v));
    m.profile = *profile;
  }
  if (const json* v = r.find(format, "pixels_per_column", "data_format"))
    m.pixels_per_column = static_cast<std::uint32_t>(r.whole(*v, 1, 256));
  else
    r.refuse("expected it: how many beams the sensor has");
  if (const json* v = r.find(format, "columns_per_packet", "data_format"))
    m.columns_per_packet = static_cast<std::uint32_t>(r.whole(*v, 1, 64));
  if (const json* v = r.find(format, "columns_per_frame", "data_format"))
    if (const auto columns = r.whole(*v, 1, 8192); columns != m.mode.columns)
      r.refuse("expected the " + std::to_string(m.mode.columns) + " columns of lidar_mode, got " +
               std::to_string(columns));
  if (m.mode.columns % m.columns_per_packet != 0)
    r.refuse("expected a whole number of packets, got " + std::to_string(m.mode.columns) +
             " columns in packets of " + std::to_string(m.columns_per_packet));
  m.window = {0, m.mode.columns - 1};
  if (const json* v = r.find(format, "column_window", "data_format")) {
    if (!v->is_array() || v->size() != 2)
      r.refuse("expected the first and the last column, got " + shown(*v));
    m.window = {static_cast<std::uint32_t>(r.whole((*v)[0], 0, m.mode.columns - 1)),
                static_cast<std::uint32_t>(r.whole((*v)[1], 0, m.mode.columns - 1))};
  }
  m.pixel_shift.assign(m.pixels_per_column, 0);
  if (const json* v = r.find(format, "pixel_shift_by_row", "data_format")) {
    const auto shifts = r.numbers(*v, m.pixels_per_column, m.mode.columns);
    for (std::size_t i = 0; i < shifts.size(); ++i) m.pixel_shift[i] = static_cast<std::int32_t>(shifts[i]);
  }

  if (const json* v = r.find("beam_intrinsics", "beam_altitude_angles"))
    m.beam_altitude_deg = r.numbers(*v, m.pixels_per_column, 90);
  else
    r.refuse("expected it: where the beams point");
  if (const json* v = r.find("beam_intrinsics", "beam_azimuth_angles"))
    m.beam_azimuth_deg = r.numbers(*v, m.pixels_per_column, 360);
  else
    r.refuse("expected it: where the beams point");
  m.beam_origin_m = kOs1BeamOrigin_m;
  if (const json* v = r.find("beam_intrinsics", "lidar_origin_to_beam_origin_mm"))
    m.beam_origin_m = r.number(*v, 1000) * 1e-3;
  if (const json* v = r.find("beam_intrinsics", "beam_to_lidar_transform")) {
    const auto t = r.transform(*v);
    m.beam_origin_m = t[3], m.beam_origin_z_m = t[11];
  }
  m.T_sensor_lidar = kOs1SensorLidar;
  if (const json* v = r.find("lidar_intrinsics", "lidar_to_sensor_transform"))
    m.T_sensor_lidar = r.transform(*v);
  m.T_sensor_imu = kOs1SensorImu;
  if (const json* v = r.find("imu_intrinsics", "imu_to_sensor_transform")) m.T_sensor_imu = r.transform(*v);

  if (const json* v = r.find("sensor_info", "initialization_id"))
    m.initialization_id = static_cast<std::uint32_t>(r.whole(*v, 0, 0xFFFFFFFF)) & 0xFFFFFF;
  if (const json* v = r.find("config_params", "udp_port_lidar"))
    m.lidar_port = static_cast<std::uint16_t>(r.whole(*v, 0, 65535));
  if (const json* v = r.find("config_params", "udp_port_imu"))
    m.imu_port = static_cast<std::uint16_t>(r.whole(*v, 0, 65535));
  return m;
}

}  // namespace

std::string_view name_of(Profile p) {
  switch (p) {
    case Profile::legacy:
      return "LEGACY";
    case Profile::single:
      return "RNG19_RFL8_SIG16_NIR16";
    case Profile::dual:
      return "RNG19_RFL8_SIG16_NIR16_DUAL";
    case Profile::low_data:
      return "RNG15_RFL8_NIR8";
  }
  return "unknown";
}

std::optional<Profile> profile_named(std::string_view name) {
  for (const Profile p : kProfiles)
    if (name_of(p) == name) return p;
  return {};
}

std::optional<LidarMode> mode_named(std::string_view name) {
  LidarMode m;
  const char *begin = name.data(), *end = begin + name.size();
  const auto columns = std::from_chars(begin, end, m.columns);
  if (columns.ec != std::errc{} || columns.ptr == end || *columns.ptr != 'x') return {};
  const auto rate = std::from_chars(columns.ptr + 1, end, m.rate_hz);
  if (rate.ec != std::errc{} || rate.ptr != end) return {};
  if (m.columns < 16 || m.columns > 8192 || m.rate_hz < 1 || m.rate_hz > 100) return {};
  return m;
}

std::string name_of(const LidarMode& m) {
  return std::to_string(m.columns) + "x" + std::to_string(m.rate_hz);
}

Result<Metadata> parse_metadata(std::string_view text, std::string_view name) {
  if (text.size() > kMaxBytes)
    return fail(
        ErrorCode::bad_input, std::string(name),
        "expected the metadata of a sensor, some KiB of JSON, got " + std::to_string(text.size()) + " bytes");
  std::string why;
  const json root = parse_bounded(text, &why);
  if (root.is_discarded()) return fail(ErrorCode::bad_input, std::string(name), "expected JSON, got " + why);
  try {
    return read(root);
  } catch (const BadMetadata& bad) {
    return fail(
        ErrorCode::bad_input, std::string(name) + (bad.key.empty() ? "" : ": " + bad.key),
        bad.message + "; the metadata of an Ouster sensor is what it answers to GET /api/v1/sensor/metadata");
  }
}

Result<Metadata> load_metadata(const std::filesystem::path& file) {
  std::error_code ec;
  if (!std::filesystem::is_regular_file(file, ec))
    return fail(ErrorCode::not_found, file.string(),
                "expected the metadata of an Ouster sensor (JSON), found no such file");
  if (std::filesystem::file_size(file, ec) > kMaxBytes || ec)
    return fail(ErrorCode::bad_input, file.string(),
                "expected the metadata of an Ouster sensor, some KiB of JSON, got a larger file");
  std::ifstream in(file, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(in), {}};
  return parse_metadata(text, file.string());
}

}  // namespace rigor::ouster
