#include "cli/receiver_log.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>

#include "bench/console/terminal.h"
#include "drivers/gnss/nmea.h"
#include "drivers/gnss/receiver_stream.h"
#include "rt-core/epoch.h"

namespace rigor {
namespace {

using namespace gnss;

/// The whole file through a stream, until `go_on` says no.
Result<std::unique_ptr<ReceiverStream>> run_through(const std::filesystem::path& file,
                                                    ReceiverStream::Handler handler,
                                                    const std::function<bool()>& go_on) {
  std::ifstream in(file, std::ios::binary);
  if (!in)
    return fail(ErrorCode::not_found, file.string(),
                "expected a recording of a receiver, found no such file");
  ReceiverStream::Options options;
  options.time = TimeSource::fixed;
  auto stream = std::make_unique<ReceiverStream>(options, std::move(handler));
  std::array<char, 4096> piece;
  while (in && go_on()) {
    in.read(piece.data(), piece.size());
    stream->take({reinterpret_cast<const std::uint8_t*>(piece.data()), static_cast<std::size_t>(in.gcount())},
                 BenchTime(0));
  }
  if (go_on()) stream->finish();
  return stream;
}

std::string iso(const std::optional<RealtimeTime>& t) {
  if (!t) return "unknown";
  const UtcTime u = utc_time(*t);
  return fmt::format("{:04}-{:02}-{:02}T{:02}:{:02}:{:02}.{:03}Z", u.year, u.month, u.day, u.hour, u.minute,
                     u.second, u.nanosecond / 1'000'000);
}

std::string name_of(const Message& m) {
  if (m.kind == Message::Kind::rtcm)
    return m.payload.size() < 2 ? "RTCM" : fmt::format("RTCM {}", m.payload[0] << 4 | m.payload[1] >> 4);
  if (m.kind == Message::Kind::nmea) return std::string(m.text.substr(0, m.text.find(',')));
  const auto id = static_cast<unsigned>(m.ubx);
  for (const auto& [known, name] : {std::pair{UbxId::nav_pvt, "NAV-PVT"},
                                    {UbxId::nav_dop, "NAV-DOP"},
                                    {UbxId::nav_cov, "NAV-COV"},
                                    {UbxId::nav_hpposllh, "NAV-HPPOSLLH"},
                                    {UbxId::nav_timegps, "NAV-TIMEGPS"},
                                    {UbxId::nav_sat, "NAV-SAT"},
                                    {UbxId::nav_eoe, "NAV-EOE"},
                                    {UbxId::rxm_rawx, "RXM-RAWX"},
                                    {UbxId::tim_tp, "TIM-TP"},
                                    {UbxId::mon_ver, "MON-VER"}})
    if (known == m.ubx) return std::string("UBX ") + name;
  return fmt::format("UBX {:02X}-{:02X}", id >> 8, id & 0xFF);
}

struct Report {
  std::map<std::string, std::uint64_t> messages;
  std::uint64_t solutions = 0;
  std::map<std::string, std::uint64_t> by_status;
  std::optional<RealtimeTime> first, last;
  std::optional<DeviceTime> begin, end;
  std::vector<std::int64_t> steps_ns;
  double latitude_deg[2] = {90, -90}, longitude_deg[2] = {180, -180}, height_m[2] = {INFINITY, -INFINITY};
  double fastest_mps = 0;
  std::uint64_t skies = 0, most_in_view = 0, most_used = 0;
};

Report make_report(const std::filesystem::path& file, Result<std::unique_ptr<ReceiverStream>>& stream) {
  Report r;
  static constexpr const char* kStatus[] = {"no fix", "fix", "with corrections", "RTK float", "RTK fixed"};
  stream = run_through(file,
                       {.solution =
                            [&](const Solution& s, const ReceiverStream::Place&) {
                              ++r.solutions;
                              ++r.by_status[kStatus[static_cast<int>(s.status)]];
                              if (s.utc && !r.first) r.first = s.utc;
                              if (s.utc) r.last = s.utc;
                              if (r.end) r.steps_ns.push_back((s.t_device - *r.end).ns());
                              if (!r.begin) r.begin = s.t_device;
                              r.end = s.t_device;
                              if (s.satellites_used > r.most_used) r.most_used = s.satellites_used;
                              if (!s.has_fix()) return;
                              const auto widen = [](double(&range)[2], double v) {
                                if (!std::isfinite(v)) return;
                                range[0] = std::min(range[0], v), range[1] = std::max(range[1], v);
                              };
                              widen(r.latitude_deg, s.latitude_deg);
                              widen(r.longitude_deg, s.longitude_deg);
                              widen(r.height_m, s.height_m);
                              if (s.speed_mps > r.fastest_mps) r.fastest_mps = s.speed_mps;
                            },
                        .sky =
                            [&](const Sky& s, const ReceiverStream::Place&) {
                              ++r.skies;
                              r.most_in_view = std::max<std::uint64_t>(r.most_in_view, s.satellites.size());
                            },
                        .pulse = {},
                        .raw = {},
                        .message = [&](const Message& m) { ++r.messages[name_of(m)]; }},
                       [] { return true; });
  return r;
}

}  // namespace

bool is_receiver_log(const std::filesystem::path& file) {
  const std::string ending = file.extension().string();
  if (ending == ".ubx" || ending == ".nmea") return true;
  if (ending != ".log") return false;
  std::ifstream in(file, std::ios::binary);
  Buffer head(65536);
  in.read(reinterpret_cast<char*>(head.data()), static_cast<std::streamsize>(head.size()));
  head.resize(static_cast<std::size_t>(std::max<std::streamsize>(0, in.gcount())));
  MessageStream messages;
  messages.add(head);
  return messages.next().has_value();
}

Result<RecordingInput> read_receiver_log(const std::filesystem::path& file, const TakeSample& take) {
  RecordingInput input;
  input.topic = "receiver";
  std::optional<DeviceTime> first;
  Sample sample;
  bool on = true;
  auto stream = run_through(file,
                            {.solution =
                                 [&](const Solution& s, const ReceiverStream::Place&) {
                                   if (!on) return;
                                   if (!first) first = s.t_device;
                                   sample.info = nav_fix_of(s);
                                   sample.stamp = {};
                                   sample.stamp.sequence = input.samples++;
                                   sample.stamp.t_capture = BenchTime((s.t_device - *first).ns());
                                   sample.stamp.t_release = sample.stamp.t_arrival = sample.stamp.t_capture;
                                   on = take(sample);
                                 },
                             .sky = {},
                             .pulse = {},
                             .raw = {},
                             .message = {}},
                            [&] { return on; });
  if (!stream) return tl::unexpected<Error>(stream.error());
  if (input.samples == 0)
    return fail(ErrorCode::bad_input, file.string(),
                "expected UBX (NAV-PVT) or NMEA (RMC, GGA) of a receiver, found no solution in it");
  return input;
}

RealtimeTime begin_of_receiver_log(const std::filesystem::path& file) {
  std::optional<RealtimeTime> begin;
  (void)run_through(file,
                    {.solution =
                         [&](const Solution& s, const ReceiverStream::Place&) {
                           if (!begin) begin = s.utc;
                         },
                     .sky = {},
                     .pulse = {},
                     .raw = {},
                     .message = {}},
                    [&] { return !begin; });
  return begin.value_or(kVirtualEpoch.utc);
}

int inspect_receiver_log_command(const InspectOptions& options) {
  if (options.repair)
    return report_error(
        {ErrorCode::bad_input, options.file.string(),
         "expected a recording of Rigor (MCAP), got a receiver's: there is nothing to repair"},
        options.json);
  Result<std::unique_ptr<ReceiverStream>> stream = fail(ErrorCode::internal, "", "");
  const Report r = make_report(options.file, stream);
  if (!stream) return report_error(stream.error(), options.json);
  const auto& c = (*stream)->messages().counters();
  const auto& e = (*stream)->epochs().counters();
  std::vector<std::int64_t> steps = r.steps_ns;
  std::int64_t usual_ns = 0;
  if (!steps.empty()) {
    std::nth_element(steps.begin(), steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2),
                     steps.end());
    usual_ns = steps[steps.size() / 2];
  }
  const auto gaps = std::count_if(r.steps_ns.begin(), r.steps_ns.end(),
                                  [&](std::int64_t s) { return usual_ns > 0 && s > usual_ns * 3 / 2; });
  const double duration_s = r.begin ? (*r.end - *r.begin).seconds() : 0;
  const double rate_hz = usual_ns > 0 ? 1e9 / static_cast<double>(usual_ns) : 0;
  if (options.json) {
    nlohmann::json j{{"file", options.file.string()},
                     {"format", "satellite receiver"},
                     {"bytes", c.bytes},
                     {"messages", r.messages},
                     {"bad_checksums", c.bad_checksums},
                     {"bad_lengths", c.bad_lengths},
                     {"malformed", e.malformed},
                     {"garbage_bytes", c.garbage},
                     {"solutions", r.solutions},
                     {"by_status", r.by_status},
                     {"first", iso(r.first)},
                     {"last", iso(r.last)},
                     {"duration_s", duration_s},
                     {"rate_hz", rate_hz},
                     {"gaps", gaps},
                     {"satellites", {{"in_view_max", r.most_in_view}, {"used_max", r.most_used}}}};
    fmt::print("{}\n", json_text(j));
    return r.solutions > 0 ? 0 : 1;
  }
  fmt::print("{}: {} bytes of a satellite receiver, {} messages\n", options.file.string(), c.bytes,
             c.ubx + c.nmea + c.rtcm);
  fmt::print("  from       {} to {}, {:.3f} s\n", iso(r.first), iso(r.last), duration_s);
  fmt::print("  solutions  {} at {:.2f} Hz, {} gaps\n", r.solutions, rate_hz, gaps);
  for (const auto& [status, n] : r.by_status) fmt::print("    {:<18} {}\n", status, n);
  if (r.latitude_deg[0] <= r.latitude_deg[1])
    fmt::print(
        "  place      {:.7f}° to {:.7f}° N, {:.7f}° to {:.7f}° E, {:.3f} to {:.3f} m, up to {:.2f} m/s\n",
        r.latitude_deg[0], r.latitude_deg[1], r.longitude_deg[0], r.longitude_deg[1], r.height_m[0],
        r.height_m[1], r.fastest_mps);
  fmt::print("  satellites up to {} used, {} signals in view\n", r.most_used, r.most_in_view);
  fmt::print("  broken     {} checksums, {} lengths, {} malformed, {} bytes of no message\n", c.bad_checksums,
             c.bad_lengths, e.malformed, c.garbage);
  for (const auto& [name, n] : r.messages) fmt::print("    {:<18} {}\n", name, n);
  if (r.solutions > 0) return 0;
  std::fflush(stdout);
  return report_error({ErrorCode::bad_input, options.file.string(),
                       "expected UBX (NAV-PVT) or NMEA (RMC, GGA) of a receiver, found no solution in it"},
                      false);
}

}  // namespace rigor
