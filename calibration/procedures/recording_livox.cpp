#include <cstring>

#include "calibration/procedures/recording_packets.h"
#include "drivers/livox/pcap_report.h"
#include "drivers/livox/point_stream.h"
#include "drivers/network/pcap_file.h"

namespace rigor {

bool is_livox_recording(const std::filesystem::path& file) { return livox::is_livox_recording(file); }

Result<RecordingInput> read_livox_recording(const std::filesystem::path& file, const TakeSample& take) {
  auto reader = network::PcapReader::open(file);
  if (!reader) return tl::unexpected<Error>(reader.error());
  livox::PointStream stream({.time = packet_lidar::TimeSource::fixed});
  RecordingInput result;
  result.topic = "Livox Mid-360";
  Sample sample;
  sample.reserve(stream.max_points() * sizeof(LidarPoint));
  bool enough = false;
  const packet_lidar::HandCloud hand = [&](const packet_lidar::Cloud& c) {
    if (enough) return;
    sample.size_bytes = c.points.size() * sizeof(LidarPoint);
    if (!c.points.empty()) std::memcpy(sample.memory().data(), c.points.data(), sample.size_bytes);
    sample.info = PointCloudInfo{static_cast<std::uint32_t>(c.points.size())};
    sample.stamp = {};
    sample.stamp.t_capture = sample.stamp.t_release = sample.stamp.t_arrival = c.t_capture;
    sample.stamp.validity = c.validity;
    sample.stamp.sequence = result.samples++;
    enough = !take(sample);
  };
  std::uint64_t damaged = 0;
  while (!enough) {
    auto record = reader->next();
    if (!record) {
      result.warnings.push_back(record.error().text());
      break;
    }
    if (!*record) break;
    if (!(*record)->udp) continue;
    livox::PacketFault fault{};
    const auto packet = livox::Packet::parse((*record)->udp->payload, fault);
    damaged += fault == livox::PacketFault::wrong_checksum;
    if (packet && packet->data_type() != livox::DataType::imu)
      stream.take((*record)->udp->payload, BenchTime(0), hand);
  }
  if (damaged > 0)
    result.warnings.push_back(file.string() + ": " + std::to_string(damaged) +
                              " packets were damaged and passed over");
  if (const auto lost = stream.counters().packets_lost; lost > 0)
    result.warnings.push_back(file.string() + ": " + std::to_string(lost) + " packets are missing");
  if (result.samples == 0)
    return fail(
        ErrorCode::bad_input, file.string(),
        "expected packets of a Livox Mid-360's points, and a frame of 100 ms from its beginning, found "
        "none");
  return result;
}

}  // namespace rigor
