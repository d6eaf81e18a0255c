// Samples of the HAL to messages of ROS 2 and back, without losing a bit.
//
// What a standard type cannot say goes into companion messages, at the same log time and in front of it:
//
//   kind            <topic>                          companions
//   any                                              <topic>/stamp      rigor_msgs/SampleStamp
//   image           sensor_msgs/Image                <topic>/settings   rigor_msgs/ImageSettings
//   range_image     sensor_msgs/Image 32FC1 [m]      <topic>/amplitude  sensor_msgs/Image 32FC1, if any
//   point_cloud     sensor_msgs/PointCloud2          <topic>/timing     sensor_msgs/PointCloud2, of layouts
//                                                                       that round or leave out
//                                                                       (point_layout.h)
//   can_frame       can_msgs/Frame                   <topic>/fd         rigor_msgs/CanFdFrame, in place of
//                                                                       it for CAN FD
//   register_block  rigor_msgs/RegisterBlock
//   pose            geometry_msgs/PoseStamped
//   event           rigor_msgs/Event
//   imu             sensor_msgs/Imu                  <topic>/temperature  sensor_msgs/Temperature, if told
//   nav_fix         sensor_msgs/NavSatFix            <topic>/quality    rigor_msgs/NavFixQuality
//   odometry        nav_msgs/Odometry                <topic>/wheels     sensor_msgs/JointState: left, right
//
// A 2D scanner's sweep goes to `/NAME/scan`, too, as sensor_msgs/LaserScan (laser_scan.h), behind the cloud.
// Poses are in the root's frame, which their headers name; all other headers name the sensor's own.
//
// Pixel formats: mono8, mono16, rgb8 and bayer_rggb8 are ROS encodings; Mono12p stays packed, under the name
// `mono12p`, which ROS does not know. Headers carry t_capture in UTC, the companion carries all times on the
// bench clock.
//
// Encoder and decoder: one thread at a time, an I/O thread; they allocate until their buffers have grown.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/laser_scan.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/point_layout.h"
#include "sensor-hal/record/ros2_messages.h"
#include "sensor-hal/types/sample.h"

namespace rigor::record {

/// Last part of the topic that a channel of this kind records to, e.g. `image`.
[[nodiscard]] std::string_view topic_of(SampleKind kind);
/// What companions' topics add to that of the main message, with the slash.
inline constexpr std::array<std::string_view, 8> kCompanionTopics{
    "/stamp", "/settings", "/amplitude", "/fd", "/temperature", "/quality", "/wheels", "/timing"};

/// What the codec must know of a channel beside its samples.
struct SampleChannel {
  std::string name;
  std::string topic;     ///< of the main message, e.g. `/camera/image`
  std::string frame_id;  ///< for headers
  SampleKind kind = SampleKind::none;
  std::vector<std::string> register_names{};
  std::vector<std::string> register_units{};
  Duration to_utc{};  ///< UTC less bench time
  PointLayout points = PointLayout::rigor;
  std::optional<ScanLine> scan{};    ///< of a 2D scanner
  std::string root_frame = "world";  ///< in which poses are
};

/// One topic that a channel's samples go to.
struct SampleStream {
  std::string topic;
  std::string_view type;
};

struct SampleMessage {
  std::size_t stream = 0;  ///< index in SampleEncoder::streams()
  Pieces pieces{};
};

class SampleEncoder {
 public:
  explicit SampleEncoder(SampleChannel channel);

  [[nodiscard]] const std::vector<SampleStream>& streams() const { return streams_; }
  /// The messages of one sample, in the order in which they are to be written; valid until the next call and
  /// as long as the sample, whose bytes they borrow. Errors: internal, where kind or size of the sample are
  /// not the channel's.
  [[nodiscard]] Result<std::span<const SampleMessage>> encode(const Sample& sample);

 private:
  template <class M>
  Status add(std::size_t stream, const M& message);
  msg::Header header(const Sample& sample) const;
  Status add_content(const Sample& sample);
  Status add_image(const Sample& sample, const ImageInfo& info);
  Status add_range_image(const Sample& sample, const RangeImageInfo& info);
  Status add_point_cloud(const Sample& sample, const PointCloudInfo& info);
  Status add_can(const Sample& sample, const CanFrame& frame);
  Status add_imu(const Sample& sample, const ImuSample& imu);
  Status add_nav_fix(const Sample& sample, const NavFix& fix);
  Status add_odometry(const Sample& sample, const Odometry& odometry);
  Status wrong_size(std::size_t expected, const Sample& sample) const;

  SampleChannel channel_;
  std::vector<SampleStream> streams_;
  std::array<CdrWriter, 4> writers_;
  std::vector<SampleMessage> messages_;
  msg::SampleStamp stamp_;
  msg::RegisterBlock registers_;
  std::size_t scan_stream_ = 0;  ///< 0: none
  bool scan_aligned_ = false;    ///< with the first scan that tells
  msg::LaserScan scan_;
  std::vector<std::byte> points_, timing_;
};

/// Puts samples together again from the messages of one channel, in file order.
class SampleDecoder {
 public:
  /// `to_utc` as in SampleChannel: it counts only for messages that have no companion, such as those of a
  /// foreign bag, whose capture instant is then taken from their header, and release and arrival from the log
  /// time.
  explicit SampleDecoder(std::string topic, Duration to_utc = {})
      : topic_(std::move(topic)), to_utc_(to_utc) {}

  /// Whether a topic is the decoder's own, or of one of its companions.
  [[nodiscard]] bool wants(std::string_view topic) const;
  /// True when the message completes a sample, which fill() then gives; messages of other topics are passed
  /// over. Errors: protocol.
  [[nodiscard]] Result<bool> take(const MessageView& message);
  /// Bytes that the sample needs.
  [[nodiscard]] std::size_t size_bytes() const { return main_bytes_.size() + second_bytes_.size(); }
  [[nodiscard]] const Stamp& stamp() const { return stamp_; }
  /// Writes the completed sample; before the cursor that gave the message moves on. Errors: bad_input, where
  /// the sample's memory is too small.
  [[nodiscard]] Status fill(Sample& sample) const;

 private:
  Status decode(const MessageView& message);
  Status decode_image(const MessageView& message);
  Status decode_point_cloud(const MessageView& message);
  Status decode_other_points(const msg::PointCloud2& cloud, const MessageView& message);
  Status decode_imu(const MessageView& message);
  Status decode_nav_fix(const MessageView& message);
  Status decode_odometry(const MessageView& message);
  void stamp_from(const msg::Header& header, const MessageView& message);

  std::string topic_;
  Duration to_utc_;
  Stamp stamp_;
  bool stamped_ = false;
  std::uint32_t stamped_sequence_ = 0;  ///< of the message that carried the stamp
  SampleKind stamped_kind_ = SampleKind::none;
  std::optional<msg::ImageSettings> settings_;
  std::vector<std::byte> amplitude_;
  std::optional<std::vector<std::byte>> timing_;  ///< the companion's message
  std::vector<LidarPoint> points_;
  std::optional<msg::Temperature> temperature_;
  std::optional<msg::NavFixQuality> quality_;
  std::optional<msg::JointState> wheels_;
  decltype(Sample::info) info_;
  Bytes main_bytes_;
  Bytes second_bytes_;
};

}  // namespace rigor::record
