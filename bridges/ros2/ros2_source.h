// Backend `ros2`: a topic of ROS 2 as a channel: what a real robot, or another rig's bridge, publishes.
//
// Keys, beside those of every channel:
//   topic: /camera/image_raw
//   type: sensor_msgs/Image    by default that of the channel's kind; a point_cloud may be a
//                              sensor_msgs/LaserScan; registers come from any type with numbers
//   domain: 0, interface: lo, peers: []      settings.h
//   qos: sensor_data, depth
//   stamp: header              header: t_capture is the message's stamp (UTC of this machine's clock);
//                              arrival: when it came here, less the channel's latency
//   frame_id: NAME             of the channel; its own name
//   slots: 16
//   width_px, height_px        of images and range images
//   pixel_format: Mono8        of images
//   max_points: 200000         of point clouds
//   values: { position: position.elbow, speed: velocity.elbow }    of registers: number of the message
//
//   kind             types
//   image            sensor_msgs/Image
//   range_image      sensor_msgs/Image 32FC1 [m]
//   point_cloud      sensor_msgs/PointCloud2 (x, y, z as float32 at least), sensor_msgs/LaserScan
//   imu              sensor_msgs/Imu
//   nav_fix          sensor_msgs/NavSatFix
//   odometry         nav_msgs/Odometry
//   pose             geometry_msgs/PoseStamped
//   can_frame        can_msgs/Frame
//   event            rigor_msgs/Event
//   registers        any whose definition is known, by `values`
//
// A header's stamp that is more than kMostAge from its arrival (simulated time, none at all) is not believed:
// the sample has its arrival less the latency, and kClockUnsure. Messages that cannot be samples of the
// channel count as `protocol_errors`, and the first reason is a warning.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include "bridges/ros2/participant.h"
#include "bridges/ros2/values.h"
#include "sensor-hal/channel/stream_source.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor::ros2 {

class Ros2Source final : public StreamSource {
 public:
  static constexpr Duration kMostAge = seconds(10);
  ~Ros2Source() override;
  [[nodiscard]] std::vector<std::string> warnings() const override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  void read_size(const ConfigNode& n, SampleKind kind);
  void read_registers(const ConfigNode& n);
  void work();
  void take(record::Bytes message);
  [[nodiscard]] Status make_sample(record::Bytes message, SampleSlot& slot);
  [[nodiscard]] Status take_apart(record::Bytes message);
  [[nodiscard]] Status check(const Sample& sample) const;
  [[nodiscard]] Status read_scan(record::Bytes message);
  /// The instant of a header's stamp, as far as it can be believed.
  void stamp_by(std::int64_t header_utc_ns);
  void complain(const std::string& what);

  DomainSettings domain_;
  Qos qos_;
  std::string topic_;
  MessageType type_;
  bool by_arrival_ = false;
  std::size_t slots_ = 16;

  std::shared_ptr<Participant> participant_;
  std::unique_ptr<Reader> reader_;
  std::unique_ptr<Waiter> waiter_;
  std::thread thread_;
  std::atomic<bool> stopping_{false};
  std::atomic<std::uint64_t> sequence_{0};

  // The thread that reads.
  std::optional<record::SampleDecoder> decoder_;
  std::optional<ValueReader> values_;
  bool values_have_stamp_ = false;
  std::vector<double> numbers_;
  std::vector<LidarPoint> points_;
  record::Channel channel_;
  record::Schema schema_;
  Duration to_utc_;
  MonotonicTime epoch_read_;
  BenchTime arrival_;
  Stamp stamp_;
  std::uint64_t lost_ = 0;
  std::uint32_t count_ = 0;

  mutable std::mutex mutex_;
  std::string complaint_;
};

}  // namespace rigor::ros2
