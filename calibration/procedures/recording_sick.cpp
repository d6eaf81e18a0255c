#include <cstring>
#include <fstream>
#include <sstream>

#include "calibration/procedures/recording_packets.h"
#include "drivers/sick/scan_geometry.h"
#include "drivers/sick/telegram.h"

namespace rigor {
namespace {

using namespace sick;

int hex_digit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

/// Appends the payload that begins at `at` (behind the opening quote); colons between bytes are left out.
/// False: something that is no hex.
bool read_payload(const std::string& text, std::size_t at, Buffer& out) {
  out.clear();
  while (at + 1 < text.size() && text[at] != '"') {
    if (text[at] == ':') {
      ++at;
      continue;
    }
    const int high = hex_digit(text[at]), low = hex_digit(text[at + 1]);
    if (high < 0 || low < 0) return false;
    out.push_back(static_cast<std::uint8_t>(16 * high + low));
    at += 2;
  }
  return at < text.size() && text[at] == '"';
}

}  // namespace

bool is_sick_recording(const std::filesystem::path& file) { return file.extension() == ".json"; }

Result<RecordingInput> read_sick_recording(const std::filesystem::path& file, const TakeSample& take) {
  std::ifstream in(file, std::ios::binary);
  if (!in) return fail(ErrorCode::not_found, file.string(), "expected a recording, there is none");
  std::stringstream all;
  all << in.rdbuf();
  const std::string text = std::move(all).str();
  constexpr std::string_view kKey = "\"tcp.payload\"";

  RecordingInput result;
  result.topic = "SICK LMDscandata";
  // Questions and answers lie one behind the other in the file, each whole: a parser for both directions.
  FrameParser parser;
  Buffer payload;
  ScanData scan;
  CloudMaker maker;
  MicrosecondClock clock;
  Sample sample;
  std::uint64_t payloads = 0, broken = 0;
  bool enough = false;
  for (std::size_t at = 0; !enough && (at = text.find(kKey, at)) != std::string::npos;) {
    at = text.find('"', at + kKey.size());
    if (at == std::string::npos) break;
    ++payloads;
    if (!read_payload(text, ++at, payload)) {
      ++broken;
      continue;
    }
    parser.add(payload);
    for (Bytes body = parser.next(); body.data() && !enough; body = parser.next()) {
      const auto telegram = parse_telegram(body);
      if (!telegram || telegram->name != "LMDscandata" ||
          (telegram->type != "sSN" && telegram->type != "sRA"))
        continue;
      if (decode_scan(telegram->values, scan) != ScanError::none) {
        ++broken;
        continue;
      }
      const ScanInstants instants = scan_instants(scan, clock);
      std::size_t most = 0;
      for (const auto& c : scan.channels16)
        if (c.echo_of("DIST") >= 0) most += c.values.size();
      if (sample.memory().size() < most * sizeof(LidarPoint)) sample.reserve(most * sizeof(LidarPoint));
      std::uint32_t count = 0;
      if (!maker.fill(scan, instants.beam_step, sample.memory(), count)) {
        ++broken;
        continue;
      }
      sample.size_bytes = count * sizeof(LidarPoint);
      sample.info = PointCloudInfo{count};
      sample.stamp = {};
      sample.stamp.t_capture = sample.stamp.t_release = sample.stamp.t_arrival =
          BenchTime(instants.first_beam.ns());
      sample.stamp.sequence = result.samples++;
      enough = !take(sample);
    }
  }
  if (result.samples == 0)
    return fail(ErrorCode::bad_input, file.string(),
                "expected telegrams `sSN LMDscandata` in the fields tcp.payload, found none in " +
                    std::to_string(payloads) + " payloads");
  if (broken > 0)
    result.warnings.push_back(file.string() + ": " + std::to_string(broken) +
                              " payloads or scans were damaged and passed over");
  return result;
}

}  // namespace rigor
