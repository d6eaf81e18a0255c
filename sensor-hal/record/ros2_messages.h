// The messages that a recording holds, as plain structs: those of ROS 2 by their own names and field order,
// and `rigor_msgs`, where ROS 2 has none. Encoded and decoded by CdrWriter and CdrReader; their definitions,
// which go into the file so that other tools can read it, come from schema_text().
//
// Times in headers are UTC where the run had a clock for it (see docs/recording.md).
#pragma once

#include <string_view>

#include "sensor-hal/record/cdr.h"

namespace rigor::record::msg {

struct Time {
  std::int32_t sec = 0;
  std::uint32_t nanosec = 0;
  static constexpr std::string_view kType = "builtin_interfaces/msg/Time";
  static constexpr auto fields() { return std::tuple(&Time::sec, &Time::nanosec); }
};

/// `/clock`: the time of a run in virtual time.
struct Clock {
  Time clock{};
  static constexpr std::string_view kType = "rosgraph_msgs/msg/Clock";
  static constexpr auto fields() { return std::tuple(&Clock::clock); }
};

struct Header {
  Time stamp{};
  std::string frame_id;
  static constexpr std::string_view kType = "std_msgs/msg/Header";
  static constexpr auto fields() { return std::tuple(&Header::stamp, &Header::frame_id); }
};

struct Point {
  double x = 0;
  double y = 0;
  double z = 0;
  static constexpr std::string_view kType = "geometry_msgs/msg/Point";
  static constexpr auto fields() { return std::tuple(&Point::x, &Point::y, &Point::z); }
};

struct Vector3 {
  double x = 0;
  double y = 0;
  double z = 0;
  static constexpr std::string_view kType = "geometry_msgs/msg/Vector3";
  static constexpr auto fields() { return std::tuple(&Vector3::x, &Vector3::y, &Vector3::z); }
};

struct Quaternion {
  double x = 0;
  double y = 0;
  double z = 0;
  double w = 1;
  static constexpr std::string_view kType = "geometry_msgs/msg/Quaternion";
  static constexpr auto fields() {
    return std::tuple(&Quaternion::x, &Quaternion::y, &Quaternion::z, &Quaternion::w);
  }
};

struct Pose {
  Point position{};
  Quaternion orientation{};
  static constexpr std::string_view kType = "geometry_msgs/msg/Pose";
  static constexpr auto fields() { return std::tuple(&Pose::position, &Pose::orientation); }
};

struct PoseStamped {
  Header header{};
  Pose pose{};
  static constexpr std::string_view kType = "geometry_msgs/msg/PoseStamped";
  static constexpr auto fields() { return std::tuple(&PoseStamped::header, &PoseStamped::pose); }
};

struct PoseWithCovariance {
  Pose pose{};
  std::array<double, 36> covariance{};
  static constexpr std::string_view kType = "geometry_msgs/msg/PoseWithCovariance";
  static constexpr auto fields() {
    return std::tuple(&PoseWithCovariance::pose, &PoseWithCovariance::covariance);
  }
};

struct Twist {
  Vector3 linear{};
  Vector3 angular{};
  static constexpr std::string_view kType = "geometry_msgs/msg/Twist";
  static constexpr auto fields() { return std::tuple(&Twist::linear, &Twist::angular); }
};

struct TwistWithCovariance {
  Twist twist{};
  std::array<double, 36> covariance{};
  static constexpr std::string_view kType = "geometry_msgs/msg/TwistWithCovariance";
  static constexpr auto fields() {
    return std::tuple(&TwistWithCovariance::twist, &TwistWithCovariance::covariance);
  }
};

struct Transform {
  Vector3 translation{};
  Quaternion rotation{};
  static constexpr std::string_view kType = "geometry_msgs/msg/Transform";
  static constexpr auto fields() { return std::tuple(&Transform::translation, &Transform::rotation); }
};

struct TransformStamped {
  Header header{};
  std::string child_frame_id;
  Transform transform{};
  static constexpr std::string_view kType = "geometry_msgs/msg/TransformStamped";
  static constexpr auto fields() {
    return std::tuple(&TransformStamped::header, &TransformStamped::child_frame_id,
                      &TransformStamped::transform);
  }
};

struct TFMessage {
  std::vector<TransformStamped> transforms;
  static constexpr std::string_view kType = "tf2_msgs/msg/TFMessage";
  static constexpr auto fields() { return std::tuple(&TFMessage::transforms); }
};

struct Odometry {
  Header header{};
  std::string child_frame_id;
  PoseWithCovariance pose{};
  TwistWithCovariance twist{};
  static constexpr std::string_view kType = "nav_msgs/msg/Odometry";
  static constexpr auto fields() {
    return std::tuple(&Odometry::header, &Odometry::child_frame_id, &Odometry::pose, &Odometry::twist);
  }
};

struct Image {
  Header header{};
  std::uint32_t height = 0;
  std::uint32_t width = 0;
  std::string encoding;
  std::uint8_t is_bigendian = 0;
  std::uint32_t step = 0;
  ByteView data;
  static constexpr std::string_view kType = "sensor_msgs/msg/Image";
  static constexpr auto fields() {
    return std::tuple(&Image::header, &Image::height, &Image::width, &Image::encoding, &Image::is_bigendian,
                      &Image::step, &Image::data);
  }
};

struct CompressedImage {
  Header header{};
  std::string format;
  ByteView data;
  static constexpr std::string_view kType = "sensor_msgs/msg/CompressedImage";
  static constexpr auto fields() {
    return std::tuple(&CompressedImage::header, &CompressedImage::format, &CompressedImage::data);
  }
};

struct RegionOfInterest {
  std::uint32_t x_offset = 0;
  std::uint32_t y_offset = 0;
  std::uint32_t height = 0;
  std::uint32_t width = 0;
  bool do_rectify = false;
  static constexpr std::string_view kType = "sensor_msgs/msg/RegionOfInterest";
  static constexpr auto fields() {
    return std::tuple(&RegionOfInterest::x_offset, &RegionOfInterest::y_offset, &RegionOfInterest::height,
                      &RegionOfInterest::width, &RegionOfInterest::do_rectify);
  }
};

struct CameraInfo {
  Header header{};
  std::uint32_t height = 0;
  std::uint32_t width = 0;
  std::string distortion_model;
  std::vector<double> d;
  std::array<double, 9> k{};
  std::array<double, 9> r{};
  std::array<double, 12> p{};
  std::uint32_t binning_x = 0;
  std::uint32_t binning_y = 0;
  RegionOfInterest roi{};
  static constexpr std::string_view kType = "sensor_msgs/msg/CameraInfo";
  static constexpr auto fields() {
    return std::tuple(&CameraInfo::header, &CameraInfo::height, &CameraInfo::width,
                      &CameraInfo::distortion_model, &CameraInfo::d, &CameraInfo::k, &CameraInfo::r,
                      &CameraInfo::p, &CameraInfo::binning_x, &CameraInfo::binning_y, &CameraInfo::roi);
  }
};

struct PointField {
  std::string name;
  std::uint32_t offset = 0;
  std::uint8_t datatype = 0;
  std::uint32_t count = 0;
  static constexpr std::string_view kType = "sensor_msgs/msg/PointField";
  static constexpr auto fields() {
    return std::tuple(&PointField::name, &PointField::offset, &PointField::datatype, &PointField::count);
  }
};

struct PointCloud2 {
  Header header{};
  std::uint32_t height = 0;
  std::uint32_t width = 0;
  std::vector<PointField> fields_;
  bool is_bigendian = false;
  std::uint32_t point_step = 0;
  std::uint32_t row_step = 0;
  ByteView data;
  bool is_dense = false;
  static constexpr std::string_view kType = "sensor_msgs/msg/PointCloud2";
  static constexpr auto fields() {
    return std::tuple(&PointCloud2::header, &PointCloud2::height, &PointCloud2::width, &PointCloud2::fields_,
                      &PointCloud2::is_bigendian, &PointCloud2::point_step, &PointCloud2::row_step,
                      &PointCloud2::data, &PointCloud2::is_dense);
  }
};

struct LaserScan {
  Header header{};
  float angle_min = 0;
  float angle_max = 0;
  float angle_increment = 0;
  float time_increment = 0;
  float scan_time = 0;
  float range_min = 0;
  float range_max = 0;
  std::vector<float> ranges;
  std::vector<float> intensities;
  static constexpr std::string_view kType = "sensor_msgs/msg/LaserScan";
  static constexpr auto fields() {
    return std::tuple(&LaserScan::header, &LaserScan::angle_min, &LaserScan::angle_max,
                      &LaserScan::angle_increment, &LaserScan::time_increment, &LaserScan::scan_time,
                      &LaserScan::range_min, &LaserScan::range_max, &LaserScan::ranges,
                      &LaserScan::intensities);
  }
};

struct Imu {
  Header header{};
  Quaternion orientation{};
  std::array<double, 9> orientation_covariance{};
  Vector3 angular_velocity{};
  std::array<double, 9> angular_velocity_covariance{};
  Vector3 linear_acceleration{};
  std::array<double, 9> linear_acceleration_covariance{};
  static constexpr std::string_view kType = "sensor_msgs/msg/Imu";
  static constexpr auto fields() {
    return std::tuple(&Imu::header, &Imu::orientation, &Imu::orientation_covariance, &Imu::angular_velocity,
                      &Imu::angular_velocity_covariance, &Imu::linear_acceleration,
                      &Imu::linear_acceleration_covariance);
  }
};

struct Temperature {
  Header header{};
  double temperature = 0;
  double variance = 0;
  static constexpr std::string_view kType = "sensor_msgs/msg/Temperature";
  static constexpr auto fields() {
    return std::tuple(&Temperature::header, &Temperature::temperature, &Temperature::variance);
  }
};

struct JointState {
  Header header{};
  std::vector<std::string> name;
  std::vector<double> position;
  std::vector<double> velocity;
  std::vector<double> effort;
  static constexpr std::string_view kType = "sensor_msgs/msg/JointState";
  static constexpr auto fields() {
    return std::tuple(&JointState::header, &JointState::name, &JointState::position, &JointState::velocity,
                      &JointState::effort);
  }
};

struct NavSatStatus {
  std::int8_t status = 0;
  std::uint16_t service = 0;
  static constexpr std::string_view kType = "sensor_msgs/msg/NavSatStatus";
  static constexpr auto fields() { return std::tuple(&NavSatStatus::status, &NavSatStatus::service); }
};

struct NavSatFix {
  Header header{};
  NavSatStatus status{};
  double latitude = 0;
  double longitude = 0;
  double altitude = 0;
  std::array<double, 9> position_covariance{};
  std::uint8_t position_covariance_type = 0;
  static constexpr std::string_view kType = "sensor_msgs/msg/NavSatFix";
  static constexpr auto fields() {
    return std::tuple(&NavSatFix::header, &NavSatFix::status, &NavSatFix::latitude, &NavSatFix::longitude,
                      &NavSatFix::altitude, &NavSatFix::position_covariance,
                      &NavSatFix::position_covariance_type);
  }
};

struct Frame {
  Header header{};
  std::uint32_t id = 0;
  bool is_rtr = false;
  bool is_extended = false;
  bool is_error = false;
  std::uint8_t dlc = 0;
  std::array<std::uint8_t, 8> data{};
  static constexpr std::string_view kType = "can_msgs/msg/Frame";
  static constexpr auto fields() {
    return std::tuple(&Frame::header, &Frame::id, &Frame::is_rtr, &Frame::is_extended, &Frame::is_error,
                      &Frame::dlc, &Frame::data);
  }
};

struct KeyValue {
  std::string key;
  std::string value;
  static constexpr std::string_view kType = "diagnostic_msgs/msg/KeyValue";
  static constexpr auto fields() { return std::tuple(&KeyValue::key, &KeyValue::value); }
};

struct DiagnosticStatus {
  std::uint8_t level = 0;
  std::string name;
  std::string message;
  std::string hardware_id;
  std::vector<KeyValue> values;
  static constexpr std::string_view kType = "diagnostic_msgs/msg/DiagnosticStatus";
  static constexpr auto fields() {
    return std::tuple(&DiagnosticStatus::level, &DiagnosticStatus::name, &DiagnosticStatus::message,
                      &DiagnosticStatus::hardware_id, &DiagnosticStatus::values);
  }
};

struct DiagnosticArray {
  Header header{};
  std::vector<DiagnosticStatus> status;
  static constexpr std::string_view kType = "diagnostic_msgs/msg/DiagnosticArray";
  static constexpr auto fields() { return std::tuple(&DiagnosticArray::header, &DiagnosticArray::status); }
};

struct SampleStamp {
  std::string channel;
  std::uint64_t sequence = 0;
  std::int64_t t_capture_ns = 0;
  std::int64_t t_release_ns = 0;
  std::int64_t t_arrival_ns = 0;
  std::int64_t sigma_capture_ns = 0;
  std::uint32_t lost_before = 0;
  std::uint32_t validity = 0;
  std::uint8_t kind = 0;
  static constexpr std::string_view kType = "rigor_msgs/msg/SampleStamp";
  static constexpr auto fields() {
    return std::tuple(&SampleStamp::channel, &SampleStamp::sequence, &SampleStamp::t_capture_ns,
                      &SampleStamp::t_release_ns, &SampleStamp::t_arrival_ns, &SampleStamp::sigma_capture_ns,
                      &SampleStamp::lost_before, &SampleStamp::validity, &SampleStamp::kind);
  }
};

struct ImageSettings {
  Header header{};
  std::string pixel_format;
  std::uint32_t offset_x_px = 0;
  std::uint32_t offset_y_px = 0;
  std::int64_t exposure_ns = 0;
  double gain_db = 0;
  static constexpr std::string_view kType = "rigor_msgs/msg/ImageSettings";
  static constexpr auto fields() {
    return std::tuple(&ImageSettings::header, &ImageSettings::pixel_format, &ImageSettings::offset_x_px,
                      &ImageSettings::offset_y_px, &ImageSettings::exposure_ns, &ImageSettings::gain_db);
  }
};

struct CanFdFrame {
  Header header{};
  std::uint32_t id = 0;
  bool is_rtr = false;
  bool is_extended = false;
  bool is_error = false;
  bool is_fd = false;
  bool bit_rate_switch = false;
  ByteView data;
  static constexpr std::string_view kType = "rigor_msgs/msg/CanFdFrame";
  static constexpr auto fields() {
    return std::tuple(&CanFdFrame::header, &CanFdFrame::id, &CanFdFrame::is_rtr, &CanFdFrame::is_extended,
                      &CanFdFrame::is_error, &CanFdFrame::is_fd, &CanFdFrame::bit_rate_switch,
                      &CanFdFrame::data);
  }
};

struct RegisterBlock {
  Header header{};
  std::vector<std::string> names;
  std::vector<double> values;
  std::vector<std::string> units;
  std::vector<std::uint16_t> raw;
  static constexpr std::string_view kType = "rigor_msgs/msg/RegisterBlock";
  static constexpr auto fields() {
    return std::tuple(&RegisterBlock::header, &RegisterBlock::names, &RegisterBlock::values,
                      &RegisterBlock::units, &RegisterBlock::raw);
  }
};

/// What sensor_msgs/NavSatFix has no place for; `status` as in FixStatus.
struct NavFixQuality {
  Header header{};
  std::uint8_t status = 0;
  std::uint16_t satellites = 0;
  static constexpr std::string_view kType = "rigor_msgs/msg/NavFixQuality";
  static constexpr auto fields() {
    return std::tuple(&NavFixQuality::header, &NavFixQuality::status, &NavFixQuality::satellites);
  }
};

struct PortEntry {
  std::string channel;
  std::uint64_t sequence = 0;
  std::uint8_t status = 0;
  std::int64_t t_capture_ns = 0;
  std::int64_t t_arrival_ns = 0;
  std::int64_t t_release_ns = 0;
  static constexpr std::string_view kType = "rigor_msgs/msg/PortEntry";
  static constexpr auto fields() {
    return std::tuple(&PortEntry::channel, &PortEntry::sequence, &PortEntry::status, &PortEntry::t_capture_ns,
                      &PortEntry::t_arrival_ns, &PortEntry::t_release_ns);
  }
};

struct PortVisibility {
  std::uint64_t cycle = 0;
  std::int64_t t_bench_ns = 0;
  std::vector<PortEntry> entries;
  static constexpr std::string_view kType = "rigor_msgs/msg/PortVisibility";
  static constexpr auto fields() {
    return std::tuple(&PortVisibility::cycle, &PortVisibility::t_bench_ns, &PortVisibility::entries);
  }
};

struct Event {
  Header header{};
  std::string channel;
  std::string kind;
  std::uint32_t code = 0;
  double value = 0;
  std::string text;
  static constexpr std::string_view kType = "rigor_msgs/msg/Event";
  static constexpr auto fields() {
    return std::tuple(&Event::header, &Event::channel, &Event::kind, &Event::code, &Event::value,
                      &Event::text);
  }
};

/// A fault begins or ends.
struct Fault {
  Header header{};
  std::string channel;
  std::uint32_t index = 0;
  std::string kind;
  bool live = false;
  bool begins = false;
  std::uint64_t seen = 0;
  std::uint64_t dropped = 0;
  std::uint64_t changed = 0;
  std::uint64_t delayed = 0;
  std::string fault;
  static constexpr std::string_view kType = "rigor_msgs/msg/Fault";
  static constexpr auto fields() {
    return std::tuple(&Fault::header, &Fault::channel, &Fault::index, &Fault::kind, &Fault::live,
                      &Fault::begins, &Fault::seen, &Fault::dropped, &Fault::changed, &Fault::delayed,
                      &Fault::fault);
  }
};

struct Command {
  Header header{};
  std::string channel;
  std::uint64_t sequence = 0;
  std::int64_t t_effect_ns = 0;
  std::vector<std::string> names;
  std::vector<double> values;
  static constexpr std::string_view kType = "rigor_msgs/msg/Command";
  static constexpr auto fields() {
    return std::tuple(&Command::header, &Command::channel, &Command::sequence, &Command::t_effect_ns,
                      &Command::names, &Command::values);
  }
};

}  // namespace rigor::record::msg

namespace rigor::record {

/// The definition of a type of the namespace msg and of all it contains, as `ros2msg`. Empty for an unknown
/// name. `type` is written as kType is. Any thread; allocates.
[[nodiscard]] std::string schema_text(std::string_view type);

}  // namespace rigor::record
