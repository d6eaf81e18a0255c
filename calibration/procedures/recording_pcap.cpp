#include <cstring>
#include <optional>

#include "calibration/procedures/recording_packets.h"
#include "drivers/network/pcap_file.h"
#include "drivers/ouster/frame_stream.h"
#include "drivers/velodyne/packet_decoder.h"

namespace rigor {
namespace {

using namespace velodyne;
using network::PcapReader;

struct Verdict {
  Model model;
  std::vector<std::string> warnings;
};

/// Whose packets these are: their timing outweighs the byte that names the product, which some early devices
/// have wrong.
Result<Verdict> judge(const std::filesystem::path& file) {
  auto reader = PcapReader::open(file);
  if (!reader) return tl::unexpected<Error>(reader.error());
  ModelEvidence evidence;
  std::uint64_t packets = 0;
  std::uint8_t product = 0;
  while (packets < 2000) {
    auto record = reader->next();
    if (!record || !*record) break;
    PacketFault fault{};
    if (!(*record)->udp) continue;
    const auto packet = DataPacket::parse((*record)->udp->payload, fault);
    if (!packet) continue;
    evidence.add(*packet);
    product = packet->product();
    ++packets;
  }
  if (packets == 0)
    return fail(ErrorCode::bad_input, file.string(),
                "expected data packets of a Velodyne VLP-16 or HDL-32E (UDP, 1206 bytes), found none in " +
                    std::to_string(reader->frames()) +
                    " frames; `rigor inspect` tells what the recording holds");
  const auto by_byte = model_of(product), by_timing = evidence.model();
  if (!by_byte && !by_timing)
    return fail(ErrorCode::bad_input, file.string(),
                "expected packets of a VLP-16 or HDL-32E, got product byte " + std::to_string(product) +
                    " and a timing that is neither's");
  Verdict v{by_timing ? *by_timing : *by_byte, {}};
  if (by_timing && by_byte != by_timing) {
    char byte[8];
    std::snprintf(byte, sizeof byte, "0x%02x", product);
    v.warnings.push_back(file.string() + ": the packets' product byte " + byte + " says " +
                         (by_byte ? std::string(facts_of(*by_byte).name) : "no known product") +
                         ", their timing is that of a " + std::string(facts_of(*by_timing).name) +
                         ": read as the latter");
  }
  return v;
}

}  // namespace

bool is_velodyne_recording(const std::filesystem::path& file) {
  const auto e = file.extension();
  return e == ".pcap" || e == ".pcapng" || e == ".cap";
}

Result<RecordingInput> read_velodyne_recording(const std::filesystem::path& file, const TakeSample& take) {
  auto verdict = judge(file);
  if (!verdict) return tl::unexpected<Error>(verdict.error());
  auto decoder = PacketDecoder::create(verdict->model, factory_calibration(verdict->model));
  if (!decoder) return tl::unexpected<Error>(decoder.error());
  auto reader = PcapReader::open(file);
  if (!reader) return tl::unexpected<Error>(reader.error());

  RecordingInput result;
  result.topic = std::string(decoder->facts().name);
  result.warnings = verdict->warnings;
  DecodedPacket decoded;
  HourClock clock;
  std::vector<LidarPoint> points;
  Sample sample;
  std::optional<DeviceTime> begun;
  double last_azimuth = -1;
  bool enough = false;
  std::uint64_t malformed = 0;
  const auto hand = [&] {
    if (points.empty()) return;
    const std::size_t bytes = points.size() * sizeof(LidarPoint);
    if (sample.memory().size() < bytes) sample.reserve(2 * bytes);
    std::memcpy(sample.memory().data(), points.data(), bytes);
    sample.size_bytes = bytes;
    sample.info = PointCloudInfo{static_cast<std::uint32_t>(points.size())};
    sample.stamp = {};
    sample.stamp.t_capture = sample.stamp.t_release = sample.stamp.t_arrival = BenchTime(begun->ns());
    sample.stamp.sequence = result.samples++;
    enough = !take(sample);
    points.clear();
  };
  while (!enough) {
    auto record = reader->next();
    if (!record) {
      result.warnings.push_back(record.error().text());
      break;
    }
    if (!*record) break;
    PacketFault fault{};
    if (!(*record)->udp || (*record)->udp->payload.size() != kDataBytes) continue;
    const auto packet = DataPacket::parse((*record)->udp->payload, fault);
    if (!packet) {
      ++malformed;
      continue;
    }
    const DeviceTime t = clock.unwrap(packet->timestamp_us());
    decoder->decode(*packet, decoded);
    for (std::uint32_t s = 0; s < decoded.sequence_count && !enough; ++s) {
      const auto& sequence = decoded.sequences[s];
      if (last_azimuth >= 0 && sequence.azimuth_cdeg < last_azimuth - kTurn_cdeg / 2.0) hand();
      last_azimuth = sequence.azimuth_cdeg;
      if (points.empty()) begun = t + Duration(sequence.offset_ns);
      const auto shift = static_cast<std::int32_t>((t - *begun).ns());
      for (std::uint32_t i = sequence.first; i < sequence.first + sequence.count; ++i) {
        points.push_back(decoded.points[i]);
        points.back().t_offset_ns += shift;
      }
    }
  }
  if (!enough) hand();
  if (malformed > 0)
    result.warnings.push_back(file.string() + ": " + std::to_string(malformed) +
                              " packets were damaged and passed over");
  if (result.samples == 0)
    return fail(ErrorCode::bad_input, file.string(), "expected returns in the packets, found none");
  return result;
}

std::filesystem::path ouster_metadata_beside(const std::filesystem::path& file) {
  auto beside = file;
  beside.replace_extension(".json");
  return beside != file && ouster::load_metadata(beside) ? beside : std::filesystem::path();
}

Result<RecordingInput> read_ouster_recording(const std::filesystem::path& file,
                                             const std::filesystem::path& metadata, const TakeSample& take,
                                             const std::optional<ouster::ImageOptions>& image) {
  auto m = ouster::load_metadata(metadata);
  if (!m) return tl::unexpected<Error>(m.error());
  if (image)
    if (auto s = ouster::check_field(m->profile, image->field); !s) return tl::unexpected<Error>(s.error());
  auto reader = PcapReader::open(file);
  if (!reader) return tl::unexpected<Error>(reader.error());
  ouster::FrameStream stream(*m, {.time = packet_lidar::TimeSource::fixed, .image = image});
  RecordingInput result;
  result.topic = m->product_line;
  Sample sample;
  sample.reserve(stream.image() ? stream.image()->bytes().size()
                                : ouster::FrameStream::max_points(*m) * sizeof(LidarPoint));
  bool enough = false;
  const packet_lidar::HandCloud hand = [&](const packet_lidar::Cloud& c) {
    if (enough) return;
    if (stream.image()) {
      sample.size_bytes = c.pixels.size();
      std::memcpy(sample.memory().data(), c.pixels.data(), sample.size_bytes);
      sample.info = stream.image()->info();
    } else {
      sample.size_bytes = c.points.size() * sizeof(LidarPoint);
      if (!c.points.empty()) std::memcpy(sample.memory().data(), c.points.data(), sample.size_bytes);
      sample.info = PointCloudInfo{static_cast<std::uint32_t>(c.points.size())};
    }
    sample.stamp = {};
    sample.stamp.t_capture = sample.stamp.t_release = sample.stamp.t_arrival = c.t_capture;
    sample.stamp.validity = c.validity;
    sample.stamp.sequence = result.samples++;
    enough = !take(sample);
  };
  while (!enough) {
    auto record = reader->next();
    if (!record) {
      result.warnings.push_back(record.error().text());
      break;
    }
    if (!*record) break;
    if ((*record)->udp && (*record)->udp->payload.size() == stream.layout().packet_bytes)
      stream.take((*record)->udp->payload, BenchTime(0), hand);
  }
  if (!enough) stream.finish(hand);
  const auto& c = stream.counters();
  if (c.malformed > 0)
    result.warnings.push_back(file.string() + ": " + std::to_string(c.malformed) +
                              " packets were damaged and passed over");
  if (c.other_initialization > 0)
    result.warnings.push_back(
        file.string() + ": " + std::to_string(c.other_initialization) +
        " packets are of a sensor that was configured anew since its metadata were taken");
  if (result.samples == 0)
    return fail(ErrorCode::bad_input, file.string(),
                "expected lidar packets of an " + m->product_line + " (UDP, " +
                    std::to_string(stream.layout().packet_bytes) + " bytes by " + metadata.string() +
                    "), and a frame from its beginning, found none");
  return result;
}

}  // namespace rigor
