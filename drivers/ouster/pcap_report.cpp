#include "drivers/ouster/pcap_report.h"

#include <algorithm>

#include "drivers/network/pcap_file.h"

namespace rigor::ouster {
namespace {

class Counter {
 public:
  explicit Counter(PcapReport& report)
      : r_(report), stream_(report.metadata, {.time = packet_lidar::TimeSource::fixed}) {
    r_.returns_per_row.assign(report.metadata.pixels_per_column, 0);
  }

  void add(RealtimeTime t, const network::UdpDatagram& udp) {
    const Metadata& m = r_.metadata;
    const PacketLayout& layout = stream_.layout();
    const bool to_lidar = udp.destination_port == (m.lidar_port != 0 ? m.lidar_port : kLidarPort);
    const bool to_imu = udp.destination_port == (m.imu_port != 0 ? m.imu_port : kImuPort);
    // By size first: recordings are made with other ports, too.
    if (udp.payload.size() == layout.packet_bytes || (to_lidar && udp.payload.size() != kImuBytes)) {
      PacketFault fault{};
      const auto packet = LidarPacket::parse(udp.payload, layout, fault);
      if (!packet) {
        ++r_.malformed;
        ++r_.faults[std::string(text_of(fault))];
        return;
      }
      if (r_.lidar_packets++ == 0) t_first_ = t;
      t_last_ = t;
      ++r_.sources[network::sender_of(udp)];
      count(*packet);
      stream_.take(udp.payload, BenchTime(0), hand_);
    } else if (udp.payload.size() == kImuBytes || to_imu) {
      if (parse_imu(udp.payload)) {
        ++r_.imu_packets;
      } else {
        ++r_.malformed;
        ++r_.faults["not an IMU packet"];
      }
    } else {
      ++r_.other_datagrams;
    }
  }

  void finish() {
    stream_.finish(hand_);
    r_.frames = stream_.counters();
    r_.duration_s = (t_last_ - t_first_).seconds();
    if (r_.duration_s > 0) {
      r_.packets_per_s = static_cast<double>(r_.lidar_packets - 1) / r_.duration_s;
      r_.imu_packets_per_s = static_cast<double>(r_.imu_packets) / r_.duration_s;
    }
    if (frames_ > 1)
      r_.frame_rate_hz = static_cast<double>(last_sequence_ - first_sequence_) / (last_ - first_).seconds();
  }

 private:
  void count(const LidarPacket& packet) {
    const std::uint32_t returns = stream_.layout().dual() ? 2 : 1;
    for (std::uint32_t i = 0; i < packet.columns(); ++i) {
      const auto c = packet.column(i);
      if (!c.good()) {
        ++r_.columns_not_good;
        continue;
      }
      if (r_.first_timestamp_ns == 0) r_.first_timestamp_ns = c.timestamp_ns();
      r_.last_timestamp_ns = c.timestamp_ns();
      for (std::uint32_t row = 0; row < r_.metadata.pixels_per_column; ++row)
        for (std::uint32_t index = 0; index < returns; ++index) {
          const Pixel p = c.pixel(row, index);
          if (p.range_mm == 0) continue;
          const double range_m = p.range_mm * 1e-3;
          r_.minimum_range_m = r_.returns == 0 ? range_m : std::min(r_.minimum_range_m, range_m);
          r_.maximum_range_m = std::max(r_.maximum_range_m, range_m);
          ++r_.returns;
          ++r_.returns_per_row[row];
          r_.second_returns += index;
        }
    }
  }

  PcapReport& r_;
  FrameStream stream_;
  RealtimeTime t_first_, t_last_;
  std::uint64_t frames_ = 0, first_sequence_ = 0, last_sequence_ = 0;
  BenchTime first_, last_;
  packet_lidar::HandCloud hand_ = [this](const packet_lidar::Cloud& c) {
    if (frames_++ == 0) first_ = c.t_capture, first_sequence_ = c.sequence;
    last_ = c.t_capture, last_sequence_ = c.sequence;
    r_.frames_incomplete += (c.validity & kIncomplete) != 0;
  };
};

}  // namespace

Result<PcapReport> inspect_pcap(const std::filesystem::path& file, const std::filesystem::path& metadata) {
  auto m = load_metadata(metadata);
  if (!m) return tl::unexpected<Error>(m.error());
  auto reader = network::PcapReader::open(file);
  if (!reader) return tl::unexpected<Error>(reader.error());
  PcapReport r;
  r.file = file.string();
  r.metadata = std::move(*m);
  Counter counter(r);
  r.ended_by = network::read_datagrams(
      *reader, [&](RealtimeTime t, const network::UdpDatagram& d) { counter.add(t, d); });
  r.captured = reader->frames();
  r.fragments = reader->fragments().fragments;
  r.datagrams_given_up = reader->fragments().given_up;
  counter.finish();
  return r;
}

}  // namespace rigor::ouster
