#include "drivers/livox/pcap_report.h"

#include <algorithm>
#include <cmath>

#include "drivers/livox/livox_command.h"
#include "drivers/network/pcap_file.h"

namespace rigor::livox {
namespace {

constexpr int kLookedAt = 2000;  ///< datagrams

bool is_its_port(std::uint16_t port) {
  for (const std::uint16_t p : {kSearchPort, kCommandPort, kStatePort, kPointPort, kImuPort, kHostCommandPort,
                                kHostStatePort, kHostPointPort, kHostImuPort})
    if (port == p) return true;
  return false;
}

class Counter {
 public:
  explicit Counter(PcapReport& report) : r_(report), stream_({.time = packet_lidar::TimeSource::fixed}) {}

  void add(RealtimeTime t, const network::UdpDatagram& udp) {
    if (const auto c = parse_command(udp.payload)) {
      ++(c->answer ? r_.answers : c->id == CommandId::push ? r_.pushes : r_.commands);
      return;
    }
    PacketFault fault{};
    const auto packet = Packet::parse(udp.payload, fault);
    if (!packet) {
      if (!is_its_port(udp.source_port) && !is_its_port(udp.destination_port)) {
        ++r_.other_datagrams;
        return;
      }
      ++r_.malformed;
      ++r_.faults[std::string(text_of(fault))];
      return;
    }
    if (packet->data_type() == DataType::imu) {
      ++r_.imu_packets;
      return;
    }
    if (r_.point_packets++ == 0) t_first_ = t, r_.first_timestamp_ns = packet->timestamp_ns();
    t_last_ = t;
    r_.last_timestamp_ns = packet->timestamp_ns();
    ++r_.sources[network::sender_of(udp)];
    ++r_.data_types[std::string(name_of(packet->data_type()))];
    ++r_.time_types[std::string(name_of(packet->time_type()))];
    count(*packet);
    stream_.take(udp.payload, BenchTime(0), [](const packet_lidar::Cloud&) {});
  }

  void finish() {
    r_.stream = stream_.counters();
    r_.duration_s = (t_last_ - t_first_).seconds();
    if (!(r_.duration_s > 0)) return;
    r_.packets_per_s = static_cast<double>(r_.point_packets - 1) / r_.duration_s;
    r_.points_per_s = static_cast<double>(points_) / r_.duration_s;
    r_.imu_packets_per_s = static_cast<double>(r_.imu_packets) / r_.duration_s;
  }

 private:
  void count(const Packet& packet) {
    points_ += packet.dots();
    for (std::uint32_t i = 0; i < packet.dots(); ++i) {
      const Point p = packet.point(i);
      r_.low_confidence += (p.tag & 0x3F) != 0;
      if (!p.is_return()) {
        ++r_.without_return;
        continue;
      }
      const double range_m = std::hypot(double{p.x_m}, double{p.y_m}, double{p.z_m});
      r_.minimum_range_m = returns_ == 0 ? range_m : std::min(r_.minimum_range_m, range_m);
      r_.maximum_range_m = std::max(r_.maximum_range_m, range_m);
      ++returns_;
      ++r_.returns_per_line[i % kLines];
    }
  }

  PcapReport& r_;
  PointStream stream_;
  RealtimeTime t_first_, t_last_;
  std::uint64_t points_ = 0, returns_ = 0;
};

}  // namespace

bool is_livox_recording(const std::filesystem::path& file) {
  auto reader = network::PcapReader::open(file);
  if (!reader) return false;
  for (int i = 0; i < kLookedAt; ++i) {
    const auto record = reader->next();
    if (!record || !*record) return false;
    if (!(*record)->udp) continue;
    const Bytes payload = (*record)->udp->payload;
    PacketFault fault{};
    if (Packet::parse(payload, fault) || parse_command(payload)) return true;
  }
  return false;
}

Result<PcapReport> inspect_pcap(const std::filesystem::path& file) {
  auto reader = network::PcapReader::open(file);
  if (!reader) return tl::unexpected<Error>(reader.error());
  PcapReport r;
  r.file = file.string();
  Counter counter(r);
  r.ended_by = network::read_datagrams(
      *reader, [&](RealtimeTime t, const network::UdpDatagram& d) { counter.add(t, d); });
  r.captured = reader->frames();
  counter.finish();
  return r;
}

}  // namespace rigor::livox
