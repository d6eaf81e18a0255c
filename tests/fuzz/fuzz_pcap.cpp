// A recording of packets as it comes from anywhere (pcap, pcapng), through libpcap: what `rigor inspect` says
// of it, and the clouds that a rig's recording channel makes of it.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <optional>

#include "drivers/network/pcap_file.h"
#include "drivers/velodyne/cloud_stream.h"
#include "drivers/velodyne/pcap_report.h"

using namespace rigor;
using namespace rigor::velodyne;
using rigor::network::PcapReader;

namespace {

void check(bool holds) {
  if (!holds) std::abort();
}

void check_report(const PcapReport& r) {
  std::uint64_t of_lasers = 0, of_sources = 0, broken = 0;
  for (const std::uint64_t n : r.returns_per_laser) of_lasers += n;
  for (const auto& [name, n] : r.sources) of_sources += n;
  for (const auto& [name, n] : r.faults) broken += n;
  check(of_lasers == r.valid_returns && of_sources == r.data_packets && broken == r.malformed);
  check(r.data_packets + r.position_packets + r.other_frames + r.malformed == r.frames);
  check(r.points_handed_on == r.valid_returns);
  check(std::isfinite(r.duration_s) && std::isfinite(r.rotation_hz) && std::isfinite(r.packets_per_s) &&
        std::isfinite(r.position_packets_per_s) && std::isfinite(r.longest_gap_ms) && r.longest_gap_ms >= 0);
  for (const std::string* text : {&r.first_nmea, &r.last_nmea})
    check(std::all_of(text->begin(), text->end(), [](char c) { return c >= 0x20 && c < 0x7F; }));
  check(r.minimum_range_m >= 0 && r.greatest_range_m >= r.minimum_range_m);
}

constexpr std::size_t kMaxPoints = 5000;

/// Making a stream takes longer than most inputs: there is one for each model, as new for each input.
CloudStream& fresh_stream(Model model) {
  const auto make = [](Model m) {
    CloudStreamOptions options;
    options.time = TimeSource::arrival;
    options.max_points = kMaxPoints;
    return CloudStream(PacketDecoder::create(m, factory_calibration(m)).value(), options);
  };
  static CloudStream vlp16 = make(Model::vlp16), hdl32e = make(Model::hdl32e);
  CloudStream& s = model == Model::hdl32e ? hdl32e : vlp16;
  s.reset();
  return s;
}

/// As the channel reads it: due at the distances that the stamps have.
void play(Bytes file, Model model) {
  std::FILE* stream = fmemopen(const_cast<std::uint8_t*>(file.data()), file.size(), "r");
  if (!stream) return;
  auto reader = PcapReader::open(stream, "fuzz");
  check(reader.has_value());  // it was inspected
  CloudStream& clouds = fresh_stream(model);
  std::optional<RealtimeTime> first;
  const BenchTime t0(1'000'000'000);
  while (true) {
    const auto record = reader->next();
    if (!record || !*record) break;
    if (!(*record)->udp) continue;
    if (!first) first = (*record)->t;
    clouds.take((*record)->udp->payload, t0 + ((*record)->t - *first), [&](const Cloud& c) {
      check(c.points.size() <= kMaxPoints);
      for (const LidarPoint& p : c.points) check(std::isfinite(p.x_m) && p.ring < facts_of(model).lasers);
    });
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const Bytes file(data, size);
  const auto report = inspect_pcap(file, "fuzz");
  if (!report) {
    check(report.error().code == ErrorCode::bad_input && !report.error().message.empty());
    return 0;
  }
  check_report(*report);
  if (report->data_packets != 0) play(file, report->model);
  return 0;
}
