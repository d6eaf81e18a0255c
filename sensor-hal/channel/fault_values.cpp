#include "sensor-hal/channel/fault_values.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>

#include "sensor-hal/models/one_source.h"
#include "sensor-hal/types/geodetic.h"
#include "sensor-hal/types/orientation.h"

namespace rigor {
namespace {

using models::NoiseEffect;

double normal_of(std::uint32_t word) noexcept {
  using Noise = models::NoiseMath<double>;
  return Noise::normal_quantile(Noise::unit_from_bits(word));
}

/// The change of element i of a sample; elements are asked for in order, four of them share a draw.
class Change {
 public:
  explicit Change(const SampleEdit& e) noexcept : e_(e) {}
  /// 0 where the element is not hit.
  [[nodiscard]] double of(std::uint32_t i) noexcept {
    switch (e_.kind) {
      case FaultKind::noise:
        return e_.amount * normal_of(word(i));
      case FaultKind::spike: {
        const std::uint32_t w = word(i);
        // The lowest bit is the way, the others say whether.
        if ((static_cast<double>(w >> 1) + 0.5) * 0x1p-31 >= e_.element_share) return 0;
        return (w & 1) != 0 ? e_.amount : -e_.amount;
      }
      default:
        return e_.amount;
    }
  }

 private:
  [[nodiscard]] std::uint32_t word(std::uint32_t i) noexcept {
    if (i / 4 != block_) {
      block_ = i / 4;
      words_ = models::draw_words(e_.key, NoiseEffect::fault_value, e_.sequence, block_);
    }
    return words_[i % 4];
  }
  const SampleEdit& e_;
  std::uint32_t block_ = std::numeric_limits<std::uint32_t>::max();
  std::array<std::uint32_t, 4> words_{};
};

int clipped(int dn, double change, int maximum) noexcept {
  const double v = std::floor(static_cast<double>(dn) + change + 0.5);
  return static_cast<int>(std::clamp(v, 0.0, static_cast<double>(maximum)));
}

template <class T>
T load(const std::byte* at) noexcept {
  T t;
  std::memcpy(&t, at, sizeof t);
  return t;
}
template <class T>
void store(std::byte* at, const T& t) noexcept {
  std::memcpy(at, &t, sizeof t);
}

void change_bytes(Change& change, std::byte* p, std::size_t count, std::size_t step) noexcept {
  for (std::size_t i = 0; i < count; ++i, p += step)
    *p = static_cast<std::byte>(clipped(static_cast<int>(*p), change.of(static_cast<std::uint32_t>(i)), 255));
}

void change_words(Change& change, std::byte* p, std::size_t count, int maximum, bool keep_zero) noexcept {
  for (std::size_t i = 0; i < count; ++i, p += 2) {
    const auto dn = load<std::uint16_t>(p);
    const double c = change.of(static_cast<std::uint32_t>(i));
    if (keep_zero && dn == 0) continue;
    store(p, static_cast<std::uint16_t>(clipped(dn, c, maximum)));
  }
}

/// Two pixels in three bytes: the low eight bits of the first, four and four, the high eight of the second.
void change_mono12p(Change& change, std::byte* p, std::size_t count) noexcept {
  for (std::size_t i = 0; i < count; ++i) {
    std::byte* low = p + i / 2 * 3 + i % 2;
    const auto word = load<std::uint16_t>(low);
    const int dn = i % 2 == 0 ? word & 0x0fff : word >> 4;
    const int v = clipped(dn, change.of(static_cast<std::uint32_t>(i)), 4095);
    store(low, static_cast<std::uint16_t>(i % 2 == 0 ? (word & 0xf000) | v : (word & 0x000f) | (v << 4)));
  }
}

void change_image(const SampleEdit& e, const ImageInfo& info, Sample& s) noexcept {
  const std::size_t bytes = image_bytes(info.format, info.width_px, info.height_px);
  if (s.size_bytes < bytes) return;
  std::byte* p = s.memory().data();
  const std::size_t pixels = std::size_t{info.width_px} * info.height_px;
  Change change(e);
  switch (info.format) {
    case PixelFormat::mono8:
    case PixelFormat::bayer_rg8:
      return change_bytes(change, p, pixels, 1);
    case PixelFormat::rgb8:
      return change_bytes(change, p, pixels * 3, 1);
    case PixelFormat::yuv422_8:
      return change_bytes(change, p, pixels, 2);
    case PixelFormat::yuv420_sp:
      return change_bytes(change, p, pixels, 1);
    case PixelFormat::mono12p:
      return change_mono12p(change, p, pixels);
    case PixelFormat::mono10:
    case PixelFormat::mono12:
    case PixelFormat::mono16:
    case PixelFormat::bayer_rg10:
    case PixelFormat::bayer_rg12:
    case PixelFormat::bayer_rg16:
    case PixelFormat::coord3d_c16:
      return change_words(change, p, pixels, (1 << significant_bits(info.format)) - 1, is_depth(info.format));
  }
}

void change_range_image(const SampleEdit& e, const RangeImageInfo& info, Sample& s) noexcept {
  const std::size_t pixels = std::size_t{info.width_px} * info.height_px;
  const std::size_t first = e.component == 1 ? pixels : 0;
  if (s.size_bytes < (first + pixels) * sizeof(float)) return;
  Change change(e);
  for (std::size_t i = 0; i < pixels; ++i) {
    std::byte* at = s.memory().data() + (first + i) * sizeof(float);
    const double c = change.of(static_cast<std::uint32_t>(i)), v = load<float>(at);
    if (!std::isnan(v)) store(at, static_cast<float>(std::max(0.0, v + c)));
  }
}

void change_points(const SampleEdit& e, std::uint32_t count, Sample& s) noexcept {
  if (s.size_bytes < count * sizeof(LidarPoint)) return;
  Change change(e);
  for (std::uint32_t i = 0; i < count; ++i) {
    std::byte* at = s.memory().data() + i * sizeof(LidarPoint);
    auto p = load<LidarPoint>(at);
    const double c = change.of(i);
    if (e.component == 1) {
      p.remission = static_cast<float>(std::max(0.0, p.remission + c));
    } else {
      const double x = p.x_m, y = p.y_m, z = p.z_m, range = std::sqrt(x * x + y * y + z * z);
      if (!(range > 0)) continue;
      const double scale = std::max(0.0, range + c) / range;
      p.x_m = static_cast<float>(x * scale);
      p.y_m = static_cast<float>(y * scale);
      p.z_m = static_cast<float>(z * scale);
    }
    store(at, p);
  }
}

void change_frame(const SampleEdit& e, CanFrame& frame) noexcept {
  Change change(e);
  const double c = change.of(0);
  if (e.signal) {
    const double v = e.signal->read(frame);
    if (!std::isnan(v)) (void)e.signal->write(frame, v + c);
    return;
  }
  const auto at = static_cast<std::size_t>(e.component);
  if (at >= frame.length) return;
  const double whole = std::floor(std::fmod(c, 256.0) + 0.5);
  frame.data[at] =
      static_cast<std::uint8_t>(static_cast<int>(frame.data[at]) + static_cast<int>(whole) + 512);
}

/// Turns about the body's own axis 0 (x), 1 (y), 2 (z): q ⊗ (cos a/2, axis · sin a/2).
void turn(Pose& pose, std::size_t axis, double angle_rad) noexcept {
  std::array<double, 4> d{std::cos(angle_rad / 2), 0, 0, 0};
  d[1 + axis] = std::sin(angle_rad / 2);
  const auto& [w, x, y, z] = pose.orientation_wxyz;
  pose.orientation_wxyz = {
      w * d[0] - x * d[1] - y * d[2] - z * d[3], w * d[1] + x * d[0] + y * d[3] - z * d[2],
      w * d[2] - x * d[3] + y * d[0] + z * d[1], w * d[3] + x * d[2] - y * d[1] + z * d[0]};
}

void change_pose(Pose& pose, int component, double by) noexcept {
  const auto i = static_cast<std::size_t>(component);
  if (i < 3)
    pose.position_m[i] += by;
  else if (i < 6)
    turn(pose, i - 3, by);
}
double read_pose(const Pose& pose, int component) noexcept {
  const auto i = static_cast<std::size_t>(component);
  return i < 3 ? pose.position_m[i] : roll_pitch_yaw_of(pose.orientation_wxyz)[i - 3];
}

double* imu_value(ImuSample& s, int component) noexcept {
  const auto i = static_cast<std::size_t>(component);
  return i < 3 ? &s.specific_force_mps2[i] : i < 6 ? &s.angular_rate_radps[i - 3] : &s.temperature_c;
}

void change_fix(NavFix& f, int component, double by) noexcept {
  const double to_rad = std::numbers::pi / 180;
  const MetresPerRadian m = metres_per_radian(f.latitude_deg * to_rad, f.height_m);
  if (component == 0) {
    if (m.east > 1) f.longitude_deg = std::remainder(f.longitude_deg + by / m.east / to_rad, 360.0);
  } else if (component == 1) {
    f.latitude_deg = std::clamp(f.latitude_deg + by / m.north / to_rad, -90.0, 90.0);
  } else if (component == 2) {
    f.height_m += by;
  } else {
    f.satellites = static_cast<std::uint16_t>(clipped(f.satellites, by, 65535));
  }
}

void change_odometry(Odometry& o, int component, double by) noexcept {
  switch (component) {
    case 0:
    case 1:
      o.T_odom_base.position_m[static_cast<std::size_t>(component)] += by;
      return;
    case 2:
      return turn(o.T_odom_base, 2, by);
    case 3:
    case 4:
      o.velocity_mps[static_cast<std::size_t>(component - 3)] += by;
      return;
    case 5:
      o.turn_rate_radps[2] += by;
      return;
    case 6:
    case 7:
      o.wheel_angle_rad[static_cast<std::size_t>(component - 6)] += by;
      return;
    default:
      o.wheel_rate_radps[static_cast<std::size_t>(std::min(component, 9) - 8)] += by;
  }
}
double read_odometry(const Odometry& o, int component) noexcept {
  const std::array<double, 10> all{
      o.T_odom_base.position_m[0], o.T_odom_base.position_m[1], yaw_of(o.T_odom_base.orientation_wxyz),
      o.velocity_mps[0],           o.velocity_mps[1],           o.turn_rate_radps[2],
      o.wheel_angle_rad[0],        o.wheel_angle_rad[1],        o.wheel_rate_radps[0],
      o.wheel_rate_radps[1]};
  return all[static_cast<std::size_t>(std::clamp(component, 0, 9))];
}

/// Random bits of `size` bytes turn over; the same place may be hit twice.
void flip_bits(const SampleEdit& e, std::byte* p, std::size_t size) noexcept {
  const std::uint64_t bits = size * 8;
  if (bits == 0) return;
  for (std::uint32_t i = 0; i < e.flips; ++i) {
    const auto words = models::draw_words(e.key, NoiseEffect::fault_value, e.sequence, i);
    const std::uint64_t at = ((std::uint64_t{words[0]} << 32) | words[1]) % bits;
    p[at / 8] ^= std::byte{1} << (at % 8);
  }
}

void corrupt(const SampleEdit& e, Sample& s) noexcept {
  if (auto* frame = std::get_if<CanFrame>(&s.info)) {
    flip_bits(e, reinterpret_cast<std::byte*>(frame->data.data()), frame->length);
    const auto kept = static_cast<std::uint8_t>(std::floor(frame->length * e.keep));
    std::fill(frame->data.begin() + kept, frame->data.end(), std::uint8_t{0});
    frame->length = kept;
    return;
  }
  flip_bits(e, s.memory().data(), s.size_bytes);
  if (e.keep >= 1) return;
  if (auto* cloud = std::get_if<PointCloudInfo>(&s.info)) {
    cloud->count = static_cast<std::uint32_t>(std::floor(cloud->count * e.keep));
    s.size_bytes = cloud->count * sizeof(LidarPoint);
    return;
  }
  // What never came is zero; of a range image it is no return.
  const auto kept = static_cast<std::size_t>(std::floor(static_cast<double>(s.size_bytes) * e.keep));
  std::byte* const end = s.memory().data() + s.size_bytes;
  if (s.kind() == SampleKind::range_image) {
    const float none = std::numeric_limits<float>::quiet_NaN();
    for (std::byte* p = s.memory().data() + (kept + 3) / 4 * 4; p < end; p += sizeof none) store(p, none);
  } else {
    std::fill(s.memory().data() + kept, end, std::byte{0});
  }
}

}  // namespace

bool has_elements(SampleKind kind) noexcept {
  return kind == SampleKind::image || kind == SampleKind::range_image || kind == SampleKind::point_cloud;
}

std::vector<FaultComponent> fault_components(SampleKind kind, const ChannelDescription& description) {
  switch (kind) {
    case SampleKind::image:
      return {{"intensity", "dn"}};
    case SampleKind::range_image:
      return {{"range", "m"}, {"amplitude", ""}};
    case SampleKind::point_cloud:
      return {{"range", "m"}, {"remission", ""}};
    case SampleKind::can_frame: {
      std::vector<FaultComponent> bytes;
      for (int i = 0; i < 64; ++i) bytes.push_back({"byte_" + std::to_string(i), ""});
      return bytes;
    }
    case SampleKind::register_block: {
      std::vector<FaultComponent> all;
      for (const std::string& name : description.names) all.push_back({name, ""});
      return all;
    }
    case SampleKind::pose:
      return {{"x", "m"}, {"y", "m"}, {"z", "m"}, {"roll", "rad"}, {"pitch", "rad"}, {"yaw", "rad"}};
    case SampleKind::imu:
      return {{"force_x", "mps2"}, {"force_y", "mps2"}, {"force_z", "mps2"}, {"rate_x", "radps"},
              {"rate_y", "radps"}, {"rate_z", "radps"}, {"temperature", "k"}};
    case SampleKind::nav_fix:
      return {{"east", "m"}, {"north", "m"}, {"up", "m"}, {"satellites", ""}};
    case SampleKind::odometry:
      return {{"x", "m"},
              {"y", "m"},
              {"yaw", "rad"},
              {"velocity_x", "mps"},
              {"velocity_y", "mps"},
              {"turn_rate", "radps"},
              {"wheel_left", "rad"},
              {"wheel_right", "rad"},
              {"wheel_rate_left", "radps"},
              {"wheel_rate_right", "radps"}};
    case SampleKind::none:
    case SampleKind::event:
      return {};
  }
  return {};
}

double read_component(const Sample& sample, int component) noexcept {
  const auto i = static_cast<std::size_t>(component);
  if (const auto* b = sample.as<RegisterBlock>())
    return i < b->count ? b->value[i] : std::numeric_limits<double>::quiet_NaN();
  if (const auto* p = sample.as<Pose>()) return read_pose(*p, component);
  if (const auto* m = sample.as<ImuSample>()) return *imu_value(const_cast<ImuSample&>(*m), component);
  if (const auto* o = sample.as<Odometry>()) return read_odometry(*o, component);
  if (const auto* f = sample.as<CanFrame>(); f && i < f->length) return f->data[i];
  if (const auto* f = sample.as<NavFix>()) {
    if (component == 2) return f->height_m;
    if (component == 3) return f->satellites;
  }
  return std::numeric_limits<double>::quiet_NaN();
}

double edit_amount(const SampleEdit& edit) noexcept { return Change(edit).of(0); }

double fault_normal(models::PhiloxKey key, std::uint64_t sequence, std::uint32_t element) noexcept {
  return normal_of(models::draw_words(key, NoiseEffect::fault_choice, sequence, element)[0]);
}

void apply_edit(const SampleEdit& e, Sample& s) noexcept {
  if (e.kind == FaultKind::corrupt) return corrupt(e, s);
  if (const auto* image = s.as<ImageInfo>()) return change_image(e, *image, s);
  if (const auto* range = s.as<RangeImageInfo>()) return change_range_image(e, *range, s);
  if (const auto* cloud = s.as<PointCloudInfo>()) return change_points(e, cloud->count, s);
  if (auto* frame = std::get_if<CanFrame>(&s.info)) return change_frame(e, *frame);
  const double by = edit_amount(e);
  if (auto* block = std::get_if<RegisterBlock>(&s.info)) {
    if (const auto i = static_cast<std::size_t>(e.component); i < block->count) block->value[i] += by;
  } else if (auto* pose = std::get_if<Pose>(&s.info)) {
    change_pose(*pose, e.component, by);
  } else if (auto* imu = std::get_if<ImuSample>(&s.info)) {
    *imu_value(*imu, e.component) += by;
  } else if (auto* fix = std::get_if<NavFix>(&s.info)) {
    if (fix->status != FixStatus::none) change_fix(*fix, e.component, by);
  } else if (auto* odometry = std::get_if<Odometry>(&s.info)) {
    change_odometry(*odometry, e.component, by);
  }
}

}  // namespace rigor
