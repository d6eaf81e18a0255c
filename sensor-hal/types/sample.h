// The samples that channels carry. One type for all of them, so that ports, pools, recorder and replay are
// written once: a stamp, what kind of thing it is (`info`), and bytes that were given to the slot when the
// rig was armed.
//
//   kind            info             bytes
//   image           ImageInfo        pixels, rows without padding
//   range_image     RangeImageInfo   float32 range [m] plane, then float32 amplitude plane
//                                    (row-major; NaN: no return)
//   point_cloud     PointCloudInfo   LidarPoint[count]
//   can_frame       CanFrame         none
//   register_block  RegisterBlock    none
//   pose            Pose             none
//   event           EventInfo        none
//   imu             ImuSample        none
//   nav_fix         NavFix           none
//   odometry        Odometry         none
//
// Writing: the holder of the slot, before it is published as a lease. Reading: any thread that holds a lease.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <variant>

#include "rt-core/pool.h"
#include "rt-core/stamp.h"
#include "sensor-hal/types/pixel_format.h"
#include "sensor-hal/types/sample_memory.h"

namespace rigor {

struct ImageInfo {
  PixelFormat format = PixelFormat::mono8;
  std::uint32_t width_px = 0, height_px = 0;
  std::uint32_t offset_x_px = 0, offset_y_px = 0;  ///< of the region in the full sensor
  Duration exposure;
  double gain_db = 0;
};
struct RangeImageInfo {
  std::uint32_t width_px = 0, height_px = 0;
};
/// One return of a LiDAR, in the sensor's frame (x forward, y left, z up).
struct LidarPoint {
  float x_m, y_m, z_m;
  float remission;            ///< in the device's own unit, see the channel's description
  std::int32_t t_offset_ns;   ///< of this firing against the sample's t_capture
  std::uint16_t ring;         ///< beam index
  std::uint8_t return_index;  ///< 0 strongest or only, 1 last
  std::uint8_t flags;
};
static_assert(sizeof(LidarPoint) == 24);
struct PointCloudInfo {
  std::uint32_t count = 0;
};
struct CanFrame {
  std::uint32_t id = 0;
  bool extended = false, remote = false, error = false, fd = false, bit_rate_switch = false;
  std::uint8_t length = 0;
  std::array<std::uint8_t, 64> data{};
};
/// Values of a group of registers, in the order of the channel's `registers` and in their stated units.
struct RegisterBlock {
  static constexpr std::size_t kMax = 64;
  std::uint32_t count = 0;
  std::array<double, kMax> value{};
};
/// T_parent_child: maps child coordinates to parent coordinates. Quaternion w, x, y, z, unit length.
struct Pose {
  std::array<double, 3> position_m{0, 0, 0};
  std::array<double, 4> orientation_wxyz{1, 0, 0, 0};
};
struct EventInfo {
  std::uint32_t code = 0;
  double value = 0;
  std::array<char, 440> text{};  ///< NUL-terminated UTF-8
};

/// Of an inertial measurement unit, in its own frame, at t_capture.
struct ImuSample {
  std::array<double, 3> specific_force_mps2{};  ///< acceleration less gravity: at rest one g, upwards
  std::array<double, 3> angular_rate_radps{};
  double temperature_c = std::numeric_limits<double>::quiet_NaN();  ///< NaN: the device does not tell
};
enum class FixStatus : std::uint8_t { none, fix, sbas, rtk_float, rtk_fixed };
/// Of a satellite receiver: where its antenna is. With `none` the place means nothing.
struct NavFix {
  FixStatus status = FixStatus::none;
  std::uint16_t satellites = 0;                ///< used in the fix; 0 also where the receiver does not tell
  double latitude_deg = 0, longitude_deg = 0;  ///< WGS 84
  double height_m = 0;                         ///< above the ellipsoid
  /// As the receiver claims it: east, north, up, row by row.
  std::array<double, 9> covariance_enu_m2{};
};
/// Of a vehicle that integrates its wheels: where it believes to be since the start (frame `odom`), how it
/// moves, and what its wheels say.
struct Odometry {
  Pose T_odom_base;
  std::array<double, 3> velocity_mps{};      ///< of the base's origin, in the base's axes
  std::array<double, 3> turn_rate_radps{};   ///< in the base's axes
  std::array<double, 6> pose_variance{};     ///< x, y, z [m²], roll, pitch, yaw [rad²], as claimed
  std::array<double, 6> twist_variance{};    ///< of velocity [m²/s²] and turn rate [rad²/s²], as claimed
  std::array<double, 2> wheel_angle_rad{};   ///< left, right; since the start, forward counts up
  std::array<double, 2> wheel_rate_radps{};  ///< left, right
};

enum class SampleKind : std::uint8_t {
  none,
  image,
  range_image,
  point_cloud,
  can_frame,
  register_block,
  pose,
  event,
  imu,
  nav_fix,
  odometry
};

/// The last one, for those who go through all.
inline constexpr SampleKind kLastSampleKind = SampleKind::odometry;

struct Sample {
  Stamp stamp;
  std::variant<std::monostate, ImageInfo, RangeImageInfo, PointCloudInfo, CanFrame, RegisterBlock, Pose,
               EventInfo, ImuSample, NavFix, Odometry>
      info;
  std::size_t size_bytes = 0;  ///< how much of the slot's memory is in use

  [[nodiscard]] SampleKind kind() const noexcept { return static_cast<SampleKind>(info.index()); }
  template <class T>
  [[nodiscard]] const T* as() const noexcept {
    return std::get_if<T>(&info);
  }
  [[nodiscard]] std::span<const std::byte> bytes() const noexcept { return {memory_.get(), size_bytes}; }
  /// Where the bytes lie in the memory that other processes map (sample_memory.h); negative: elsewhere.
  [[nodiscard]] std::int64_t shared_offset() const noexcept { return memory_.get_deleter().offset; }
  /// All of the slot's memory, to be filled.
  [[nodiscard]] std::span<std::byte> memory() noexcept { return {memory_.get(), capacity_bytes_}; }
  /// Setup context: gives the slot its memory and touches every page of it.
  void reserve(std::size_t capacity_bytes) {
    memory_ = sample_memory::take(capacity_bytes);
    capacity_bytes_ = capacity_bytes;
  }

 private:
  sample_memory::Block memory_;
  std::size_t capacity_bytes_ = 0;
};

using SampleSlot = WritableSlot<Sample>;
using SampleLease = Lease<Sample>;
using SamplePool = Pool<Sample>;

/// A pool of `slots` samples of `capacity_bytes` each. Setup context; allocates and prefaults.
[[nodiscard]] inline std::unique_ptr<SamplePool> make_sample_pool(std::size_t slots,
                                                                  std::size_t capacity_bytes) {
  auto pool = std::make_unique<SamplePool>(slots);
  pool->for_each([&](Sample& s) { s.reserve(capacity_bytes); });
  return pool;
}

}  // namespace rigor
