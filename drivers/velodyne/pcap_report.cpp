#include "drivers/velodyne/pcap_report.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <functional>
#include <numbers>

#include "drivers/network/pcap_file.h"
#include "drivers/velodyne/packet_decoder.h"

namespace rigor::velodyne {
namespace {

using network::PcapReader;
using network::UdpDatagram;

/// How a datagram came, and what it is.
enum class Sort : std::uint8_t { data, position, broken, other };

Sort sort_of(const UdpDatagram& udp, std::optional<DataPacket>& data, std::optional<PositionPacket>& position,
             PacketFault& fault) {
  // By size first: recordings are made with other ports, too.
  if (udp.payload.size() == kDataBytes || udp.destination_port == kDataPort) {
    data = DataPacket::parse(udp.payload, fault);
    return data ? Sort::data : Sort::broken;
  }
  if (udp.payload.size() == kPositionBytes || udp.destination_port == kPositionPort) {
    position = parse_position(udp.payload);
    return position ? Sort::position : Sort::broken;
  }
  return Sort::other;
}

/// A recording is read twice.
using Open = std::function<Result<PcapReader>()>;

/// First pass: whose packets are these.
Result<ModelEvidence> find_evidence(const Open& open) {
  auto reader = open();
  if (!reader) return tl::unexpected<Error>(reader.error());
  ModelEvidence evidence;
  for (int n = 0; n < 1000;) {
    auto record = reader->next();
    if (!record || !*record) break;
    PacketFault fault{};
    if (!(*record)->udp) continue;
    if (const auto packet = DataPacket::parse((*record)->udp->payload, fault)) evidence.add(*packet), ++n;
  }
  return evidence;
}

/// Second pass.
class Counter {
 public:
  Counter(PcapReport& report, PacketDecoder decoder)
      : r_(report), decoder_(std::move(decoder)), facts_(decoder_.facts()) {
    r_.returns_per_laser.assign(facts_.lasers, 0);
    r_.minimum_range_m = 1e9;
  }

  void add(RealtimeTime t, const DataPacket& p) {
    if (r_.data_packets++ == 0) t_first_ = t;
    t_last_ = t;
    r_.product_byte = p.product();
    r_.full_turns += p.says_full_turn();
    ++r_.return_modes[std::string(name_of(p.mode()))];
    count_returns(p);
    follow_time(p);
    follow_rotor(p);
    decoder_.decode(p, decoded_);
    r_.points_handed_on += decoded_.point_count;
  }

  void finish() {
    r_.duration_s = (t_last_ - t_first_).seconds();
    if (r_.valid_returns == 0) r_.minimum_range_m = 0;
    r_.turns = turned_cdeg_ / kTurn_cdeg;
    const double device_s = static_cast<double>(device_ns_) * 1e-9;
    if (device_s <= 0) return;
    r_.rotation_hz = static_cast<double>(rate_cdeg_) / kTurn_cdeg / device_s;
    r_.packets_per_s = static_cast<double>(steps_) / device_s;
    if (r_.duration_s > 0)
      r_.position_packets_per_s = static_cast<double>(r_.position_packets) / r_.duration_s;
  }

 private:
  void count_returns(const DataPacket& p) {
    const std::size_t step = p.dual() ? 2 : 1;
    for (std::size_t block = 0; block < kBlocks; block += step)
      for (std::size_t channel = 0; channel < kChannels; ++channel) {
        const std::uint32_t a = p.at(block, channel).range_raw;
        count(channel, a);
        if (step == 2)
          if (const std::uint32_t b = p.at(block + 1, channel).range_raw; b != a) count(channel, b);
      }
  }
  void count(std::size_t channel, std::uint32_t raw) {
    if (raw == 0) return;
    ++r_.valid_returns;
    ++r_.returns_per_laser[channel % facts_.lasers];
    r_.minimum_range_m = std::min(r_.minimum_range_m, raw * kRangeUnit_m);
    r_.greatest_range_m = std::max(r_.greatest_range_m, raw * kRangeUnit_m);
  }
  void follow_time(const DataPacket& p) {
    const DeviceTime t = hour_.unwrap(p.timestamp_us());
    step_ns_ = 0;
    if (std::exchange(any_, true)) {
      const std::int64_t step = (t - last_).ns(), packet_ns = facts_.packet_ns(p.dual());
      if (step <= 0) {
        ++r_.clock_steps;
      } else {
        step_ns_ = step;
        if (step > packet_ns + packet_ns / 2) {
          ++r_.gaps;
          r_.packets_lost += static_cast<std::uint64_t>((step + packet_ns / 2) / packet_ns - 1);
          r_.longest_gap_ms = std::max(r_.longest_gap_ms, static_cast<double>(step - packet_ns) * 1e-6);
        }
      }
    }
    last_ = t;
  }
  void follow_rotor(const DataPacket& p) {
    for (std::size_t block = 0; block < kBlocks; ++block) {
      const std::uint32_t a = p.azimuth_cdeg(block);
      if (turning_) {
        turned_cdeg_ += static_cast<double>((a + kTurn_cdeg - azimuth_) % kTurn_cdeg);
        if (a < azimuth_ && azimuth_ - a > kTurn_cdeg / 2) {
          if (seen_cut_) ++r_.revolutions;
          seen_cut_ = true;
        }
      }
      turning_ = true;
      azimuth_ = a;
    }
    // Rates only across steps that lack nothing.
    if (step_ns_ > 0 && step_ns_ < facts_.packet_ns(p.dual()) * 3 / 2) {
      device_ns_ += step_ns_;
      ++steps_;
      rate_cdeg_ += (p.azimuth_cdeg(0) + kTurn_cdeg - first_azimuth_) % kTurn_cdeg;
    }
    first_azimuth_ = p.azimuth_cdeg(0);
  }

  PcapReport& r_;
  PacketDecoder decoder_;
  const DeviceFacts& facts_;
  DecodedPacket decoded_;
  HourClock hour_;
  bool any_ = false, turning_ = false, seen_cut_ = false;
  DeviceTime last_;
  RealtimeTime t_first_, t_last_;
  std::int64_t step_ns_ = 0, device_ns_ = 0;
  std::uint64_t steps_ = 0, rate_cdeg_ = 0;
  std::uint32_t azimuth_ = 0, first_azimuth_ = 0;
  double turned_cdeg_ = 0;
};

Result<PcapReport> inspect(const Open& open, std::string name) {
  const auto evidence = find_evidence(open);
  if (!evidence) return tl::unexpected<Error>(evidence.error());
  auto reader = open();
  if (!reader) return tl::unexpected<Error>(reader.error());

  PcapReport r;
  r.file = std::move(name);
  r.model_by_timing = evidence->model();
  std::optional<Counter> counter;
  while (true) {
    auto record = reader->next();
    if (!record) {
      r.ended_by = record.error();
      break;
    }
    if (!*record) break;
    ++r.frames;
    const auto& udp = (*record)->udp;
    std::optional<DataPacket> data;
    std::optional<PositionPacket> position;
    PacketFault fault{};
    switch (udp ? sort_of(*udp, data, position, fault) : Sort::other) {
      case Sort::data:
        if (!counter) {
          r.model_by_byte = model_of(data->product());
          r.model_known = r.model_by_timing || r.model_by_byte;
          r.model = r.model_by_timing.value_or(r.model_by_byte.value_or(Model::vlp16));
          const Calibration calibration = factory_calibration(r.model);
          for (const LaserCalibration& l : calibration.lasers)
            r.elevation_deg.push_back(l.elevation_rad * 180 / std::numbers::pi);
          auto decoder = PacketDecoder::create(r.model, calibration);
          if (!decoder) return tl::unexpected<Error>(decoder.error());
          counter.emplace(r, std::move(*decoder));
        }
        ++r.sources[network::sender_of(*udp)];
        counter->add((*record)->t, *data);
        break;
      case Sort::position:
        ++r.position_packets;
        ++r.pps[std::string(name_of(position->pps))];
        if (!position->nmea.empty()) {
          if (r.first_nmea.empty()) r.first_nmea = position->nmea;
          r.last_nmea = position->nmea;
        }
        break;
      case Sort::broken:
        ++r.malformed;
        ++r.faults[std::string(fault == PacketFault::none ? "not a position packet" : text_of(fault))];
        break;
      case Sort::other:
        ++r.other_frames;
        break;
    }
  }
  if (counter) counter->finish();
  return r;
}

}  // namespace

Result<PcapReport> inspect_pcap(const std::filesystem::path& file) {
  return inspect([&] { return PcapReader::open(file); }, file.string());
}

Result<PcapReport> inspect_pcap(std::span<const std::uint8_t> file, const std::string& name) {
  const auto open = [&]() -> Result<PcapReader> {
    // fmemopen() only reads in mode "r".
    std::FILE* stream = fmemopen(const_cast<std::uint8_t*>(file.data()), file.size(), "r");
    if (!stream)
      return fail(ErrorCode::bad_input, name,
                  std::string("expected a recording in memory: ") + std::strerror(errno));
    return PcapReader::open(stream, name);
  };
  return inspect(open, name);
}

}  // namespace rigor::velodyne
