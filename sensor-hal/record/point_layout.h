// Points of a sample as the fields of a sensor_msgs/PointCloud2 that other programs read, and back.
//
//   layout    bytes  fields (offset, type)
//   rigor        24  x 0 f32, y 4 f32, z 8 f32, intensity 12 f32, t_offset_ns 16 i32, ring 20 u16,
//                    return_index 22 u8, flags 23 u8: LidarPoint as it is
//   velodyne     22  x 0, y 4, z 8, intensity 12 f32, ring 16 u16, time 18 f32 [s after the header's stamp]
//   ouster       48  x 0, y 4, z 8, intensity 16 f32, t 20 u32 [ns after the header's stamp],
//                    reflectivity 24 u16, ring 26 u8, ambient 28 u16 (0: not known), range 32 u32 [mm]
//   livox        26  x 0, y 4, z 8, intensity 12 f32, tag 16 u8 (the return's index), line 17 u8 (the ring),
//                    timestamp 18 f64 [ns, UTC]
//
// Sources of names and types:
//   velodyne  VelodynePointXYZIRT of LIO-SAM (TixiaoShan/LIO-SAM, branch ros2, src/imageProjection.cpp); the
//             offsets are those of the driver (ros-drivers/velodyne, velodyne_pointcloud/pointcloudXYZIRT)
//   ouster    ouster_ros::Point of FAST-LIO (hku-mars/FAST_LIO, src/preprocess.h) and OusterPointXYZIRT of
//             LIO-SAM, which calls the field `ambient` `noise` and does not use it
//   livox     PointCloud2 of Livox-SDK/livox_ros_driver2 (xfer_format 0, LivoxPointXyzrtlt)
// Those programs find fields by name and refuse another type, LIO-SAM also a cloud that is not dense; both
// take times for increasing from the header's stamp on, and LIO-SAM the last point's for the scan's end.
//
// Where times count from the header, its stamp is the earliest firing (header_offset_ns): offsets against
// t_capture may be negative. What a layout rounds or leaves out goes to the companion topic `<topic>/timing`
// (a PointCloud2 of t_offset_ns, ring, return_index, flags), so that samples come back bit for bit.
//
// Any thread; allocates.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/record/ros2_messages.h"
#include "sensor-hal/types/point_layout.h"
#include "sensor-hal/types/sample.h"

namespace rigor::record {

/// Codes of sensor_msgs/PointField.
inline constexpr std::uint8_t kInt8 = 1, kUint8 = 2, kInt16 = 3, kUint16 = 4, kInt32 = 5, kUint32 = 6,
                              kFloat32 = 7, kFloat64 = 8;

[[nodiscard]] std::vector<msg::PointField> point_fields(PointLayout layout);
/// Bytes from point to point.
[[nodiscard]] std::uint32_t point_step(PointLayout layout);
/// From t_capture to the header's stamp: 0, or the earliest firing where that was before t_capture; always 0
/// for the layout `rigor`.
[[nodiscard]] std::int32_t header_offset_ns(PointLayout layout, std::span<const LidarPoint> points);
/// The message's data. `header_offset`: as above; `header_utc_ns`: the header's stamp, for `livox`.
void pack_points(PointLayout layout, std::span<const LidarPoint> points, std::int32_t header_offset,
                 std::int64_t header_utc_ns, std::vector<std::byte>& data);

/// Of the companion on `<topic>/timing`.
[[nodiscard]] std::vector<msg::PointField> timing_fields();
inline constexpr std::uint32_t kTimingStep = 8;
void pack_timing(std::span<const LidarPoint> points, std::vector<std::byte>& data);

/// Points of a cloud in one of the layouts above, or of another program's cloud that has at least x, y and z
/// as float32: fields are found by name (intensity or reflectivity; ring or line; t_offset_ns, time, t or
/// timestamp in seconds or nanoseconds by its type), what is not there is 0. `timing` may be null: then times
/// are what the fields say, rounded as they are. protocol: no such fields, more points than data, a companion
/// of another number of points.
[[nodiscard]] Status unpack_points(const msg::PointCloud2& cloud, const msg::PointCloud2* timing,
                                   std::vector<LidarPoint>& points);
/// Whether the cloud is in the layout `rigor`, whose data are LidarPoint[] as they lie.
[[nodiscard]] bool is_own_layout(const msg::PointCloud2& cloud);
/// protocol: width × height × point_step is not the size of the data, or a field lies beyond a point.
[[nodiscard]] Status check_cloud(const msg::PointCloud2& cloud);

/// A number of a point; NaN where the field has no such type. Precondition: check_cloud().
[[nodiscard]] double number_at(const msg::PointCloud2& cloud, const msg::PointField& field,
                               std::size_t point);
/// Null: there is none.
[[nodiscard]] const msg::PointField* field_named(const msg::PointCloud2& cloud, std::string_view name);

}  // namespace rigor::record
