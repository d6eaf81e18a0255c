#include "sensor-hal/record/point_layout.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>

namespace rigor::record {
namespace {

template <class T>
void put(std::byte* at, T value) {
  std::memcpy(at, &value, sizeof value);
}

template <class T>
T get(const std::byte* at) {
  T value;
  std::memcpy(&value, at, sizeof value);
  return value;
}

std::size_t size_of(std::uint8_t datatype) {
  constexpr std::size_t kSizes[] = {0, 1, 1, 2, 2, 4, 4, 4, 8};
  return datatype < std::size(kSizes) ? kSizes[datatype] : 0;
}

/// Of a number that may be negative, NaN or beyond the type.
template <class T>
T limited(double v) {
  if (!(v > 0)) return 0;
  return v >= static_cast<double>(std::numeric_limits<T>::max()) ? std::numeric_limits<T>::max()
                                                                 : static_cast<T>(std::lround(v));
}

std::vector<msg::PointField> xyz_and(std::vector<msg::PointField> more) {
  std::vector<msg::PointField> all{{"x", 0, kFloat32, 1}, {"y", 4, kFloat32, 1}, {"z", 8, kFloat32, 1}};
  all.insert(all.end(), more.begin(), more.end());
  return all;
}

Status wrong(std::string what) { return fail(ErrorCode::protocol, "", std::move(what)); }

bool same_fields(const std::vector<msg::PointField>& a, const std::vector<msg::PointField>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const auto& x, const auto& y) {
    return x.name == y.name && x.offset == y.offset && x.datatype == y.datatype && x.count == y.count;
  });
}

/// When a point was fired, in nanoseconds after the header's stamp, by the fields that programs use for it.
class FiringTime {
 public:
  explicit FiringTime(const msg::PointCloud2& cloud) : cloud_(cloud) {
    for (const char* name : {"t_offset_ns", "time", "t", "offset_time", "timestamp", "time_stamp"})
      if (const msg::PointField* field = field_named(cloud, name)) {
        field_ = field;
        break;
      }
    header_ns_ = static_cast<double>(cloud.header.stamp.sec) * 1e9 + cloud.header.stamp.nanosec;
  }
  [[nodiscard]] std::int32_t at(std::size_t point) const {
    if (!field_) return 0;
    double ns = number_at(cloud_, *field_, point);
    if (field_->datatype == kFloat32) {
      ns *= 1e9;
    } else if (field_->datatype == kFloat64) {
      // Seconds of a scan, seconds of UTC, or nanoseconds of UTC: they are worlds apart.
      if (std::abs(ns) < 1e12) ns *= 1e9;
      if (std::abs(ns) > 1e15) ns -= header_ns_;
    }
    if (!(std::abs(ns) <= std::numeric_limits<std::int32_t>::max())) return 0;
    return static_cast<std::int32_t>(std::lround(ns));
  }

 private:
  const msg::PointCloud2& cloud_;
  const msg::PointField* field_ = nullptr;
  double header_ns_ = 0;
};

}  // namespace

std::vector<msg::PointField> point_fields(PointLayout layout) {
  switch (layout) {
    case PointLayout::rigor:
      break;
    case PointLayout::velodyne:
      return xyz_and({{"intensity", 12, kFloat32, 1}, {"ring", 16, kUint16, 1}, {"time", 18, kFloat32, 1}});
    case PointLayout::ouster:
      return xyz_and({{"intensity", 16, kFloat32, 1},
                      {"t", 20, kUint32, 1},
                      {"reflectivity", 24, kUint16, 1},
                      {"ring", 26, kUint8, 1},
                      {"ambient", 28, kUint16, 1},
                      {"range", 32, kUint32, 1}});
    case PointLayout::livox:
      return xyz_and({{"intensity", 12, kFloat32, 1},
                      {"tag", 16, kUint8, 1},
                      {"line", 17, kUint8, 1},
                      {"timestamp", 18, kFloat64, 1}});
  }
  return {{"x", offsetof(LidarPoint, x_m), kFloat32, 1},
          {"y", offsetof(LidarPoint, y_m), kFloat32, 1},
          {"z", offsetof(LidarPoint, z_m), kFloat32, 1},
          {"intensity", offsetof(LidarPoint, remission), kFloat32, 1},
          {"t_offset_ns", offsetof(LidarPoint, t_offset_ns), kInt32, 1},
          {"ring", offsetof(LidarPoint, ring), kUint16, 1},
          {"return_index", offsetof(LidarPoint, return_index), kUint8, 1},
          {"flags", offsetof(LidarPoint, flags), kUint8, 1}};
}

std::uint32_t point_step(PointLayout layout) {
  switch (layout) {
    case PointLayout::velodyne:
      return 22;
    case PointLayout::ouster:
      return 48;
    case PointLayout::livox:
      return 26;
    case PointLayout::rigor:
      break;
  }
  return sizeof(LidarPoint);
}

std::int32_t header_offset_ns(PointLayout layout, std::span<const LidarPoint> points) {
  std::int32_t earliest = 0;
  if (layout != PointLayout::rigor)
    for (const LidarPoint& p : points) earliest = std::min(earliest, p.t_offset_ns);
  return earliest;
}

void pack_points(PointLayout layout, std::span<const LidarPoint> points, std::int32_t header_offset,
                 std::int64_t header_utc_ns, std::vector<std::byte>& data) {
  const std::size_t step = point_step(layout);
  data.assign(points.size() * step, std::byte{0});
  std::byte* to = data.data();
  for (const LidarPoint& p : points) {
    const std::int64_t after_ns = std::int64_t{p.t_offset_ns} - header_offset;
    put(to, p.x_m);
    put(to + 4, p.y_m);
    put(to + 8, p.z_m);
    switch (layout) {
      case PointLayout::rigor:
        std::memcpy(to, &p, sizeof p);
        break;
      case PointLayout::velodyne:
        put(to + 12, p.remission);
        put(to + 16, p.ring);
        put(to + 18, static_cast<float>(static_cast<double>(after_ns) * 1e-9));
        break;
      case PointLayout::ouster:
        put(to + 16, p.remission);
        put(to + 20, static_cast<std::uint32_t>(after_ns));
        put(to + 24, limited<std::uint16_t>(p.remission));
        put(to + 26, static_cast<std::uint8_t>(p.ring));
        put(to + 32, limited<std::uint32_t>(1e3 * std::hypot(p.x_m, p.y_m, p.z_m)));
        break;
      case PointLayout::livox:
        put(to + 12, p.remission);
        put(to + 16, p.return_index);
        put(to + 17, static_cast<std::uint8_t>(p.ring));
        put(to + 18, static_cast<double>(header_utc_ns + after_ns));
        break;
    }
    to += step;
  }
}

std::vector<msg::PointField> timing_fields() {
  return {{"t_offset_ns", 0, kInt32, 1},
          {"ring", 4, kUint16, 1},
          {"return_index", 6, kUint8, 1},
          {"flags", 7, kUint8, 1}};
}

void pack_timing(std::span<const LidarPoint> points, std::vector<std::byte>& data) {
  data.resize(points.size() * kTimingStep);
  std::byte* to = data.data();
  for (const LidarPoint& p : points) {
    put(to, p.t_offset_ns);
    put(to + 4, p.ring);
    put(to + 6, p.return_index);
    put(to + 7, p.flags);
    to += kTimingStep;
  }
}

bool is_own_layout(const msg::PointCloud2& cloud) {
  static const std::vector<msg::PointField> own = point_fields(PointLayout::rigor);
  return cloud.point_step == sizeof(LidarPoint) && !cloud.is_bigendian && same_fields(cloud.fields_, own);
}

Status check_cloud(const msg::PointCloud2& cloud) {
  const std::uint64_t count = std::uint64_t{cloud.width} * cloud.height;
  const std::uint64_t step = cloud.point_step;
  // Rows may be padded; what is read goes from point to point.
  const std::uint64_t row = std::uint64_t{cloud.width} * step;
  if (cloud.height > 1 && cloud.row_step != row)
    return wrong("expected rows of " + std::to_string(row) + " bytes without padding, got " +
                 std::to_string(cloud.row_step));
  if (count > 0 && (step == 0 || count > cloud.data.size() / step || count * step != cloud.data.size()))
    return wrong("expected " + std::to_string(count) + " points of " + std::to_string(step) +
                 " bytes, as the cloud states, got " + std::to_string(cloud.data.size()) + " bytes");
  for (const msg::PointField& f : cloud.fields_)
    if (const std::uint64_t size = size_of(f.datatype) * std::uint64_t{std::max(1u, f.count)};
        count > 0 && (size > step || f.offset > step - size))
      return wrong("the field " + f.name.substr(0, 40) + " lies beyond a point");
  return {};
}

const msg::PointField* field_named(const msg::PointCloud2& cloud, std::string_view name) {
  for (const msg::PointField& f : cloud.fields_)
    if (f.name == name) return &f;
  return nullptr;
}

double number_at(const msg::PointCloud2& cloud, const msg::PointField& field, std::size_t point) {
  const std::byte* at = cloud.data.data() + point * cloud.point_step + field.offset;
  std::array<std::byte, 8> turned{};
  if (cloud.is_bigendian) {
    const std::size_t size = size_of(field.datatype);
    std::reverse_copy(at, at + size, turned.begin());
    at = turned.data();
  }
  switch (field.datatype) {
    case kInt8:
      return get<std::int8_t>(at);
    case kUint8:
      return get<std::uint8_t>(at);
    case kInt16:
      return get<std::int16_t>(at);
    case kUint16:
      return get<std::uint16_t>(at);
    case kInt32:
      return get<std::int32_t>(at);
    case kUint32:
      return get<std::uint32_t>(at);
    case kFloat32:
      return static_cast<double>(get<float>(at));
    case kFloat64:
      return get<double>(at);
    default:
      return std::numeric_limits<double>::quiet_NaN();
  }
}

Status unpack_points(const msg::PointCloud2& cloud, const msg::PointCloud2* timing,
                     std::vector<LidarPoint>& points) {
  if (auto s = check_cloud(cloud); !s) return s;
  std::array<const msg::PointField*, 3> xyz{field_named(cloud, "x"), field_named(cloud, "y"),
                                            field_named(cloud, "z")};
  for (const msg::PointField* f : xyz)
    if (!f || f->datatype != kFloat32)
      return wrong("expected a point cloud with fields x, y and z of float32, got another layout");
  const std::size_t count = std::size_t{cloud.width} * cloud.height;
  const auto either = [&](const char* one, const char* other) {
    const msg::PointField* f = field_named(cloud, one);
    return f ? f : field_named(cloud, other);
  };
  const msg::PointField *intensity = either("intensity", "reflectivity"), *ring = either("ring", "line");
  const FiringTime fired(cloud);
  points.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    LidarPoint& p = points[i];
    p = {};
    p.x_m = static_cast<float>(number_at(cloud, *xyz[0], i));
    p.y_m = static_cast<float>(number_at(cloud, *xyz[1], i));
    p.z_m = static_cast<float>(number_at(cloud, *xyz[2], i));
    if (intensity) p.remission = static_cast<float>(number_at(cloud, *intensity, i));
    if (timing) continue;
    p.t_offset_ns = fired.at(i);
    if (ring) p.ring = limited<std::uint16_t>(number_at(cloud, *ring, i));
  }
  if (!timing) return {};
  if (auto s = check_cloud(*timing); !s) return s;
  if (!same_fields(timing->fields_, timing_fields()) || timing->point_step != kTimingStep ||
      timing->is_bigendian || std::size_t{timing->width} * timing->height != count)
    return wrong(
        "expected a companion `/timing` of as many points (t_offset_ns, ring, return_index, flags "
        "in 8 bytes), got another");
  const std::byte* from = timing->data.data();
  for (LidarPoint& p : points) {
    p.t_offset_ns = get<std::int32_t>(from);
    p.ring = get<std::uint16_t>(from + 4);
    p.return_index = get<std::uint8_t>(from + 6);
    p.flags = get<std::uint8_t>(from + 7);
    from += kTimingStep;
  }
  return {};
}

}  // namespace rigor::record
