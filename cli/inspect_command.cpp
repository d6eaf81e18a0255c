#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include <nlohmann/json.hpp>

#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/files/output_file.h"
#include "calibration/procedures/recording_packets.h"
#include "cli/commands.h"
#include "cli/inspect_fmu.h"
#include "cli/inspect_livox.h"
#include "cli/inspect_ouster.h"
#include "cli/receiver_log.h"
#include "drivers/network/pcap_file.h"
#include "drivers/velodyne/pcap_report.h"
#include "sensor-hal/record/inspect.h"
#include "sensor-hal/record/mcap_repair.h"

namespace rigor {
namespace {

using velodyne::PcapReport;

/// null: not known.
nlohmann::json model_json(const std::optional<velodyne::Model>& model) {
  return model ? nlohmann::json(std::string(velodyne::facts_of(*model).name)) : nlohmann::json();
}
bool mismatch(const PcapReport& r) {
  return r.model_by_byte && r.model_by_timing && *r.model_by_byte != *r.model_by_timing;
}

nlohmann::json to_json(const PcapReport& r) {
  nlohmann::json lasers = nlohmann::json::array();
  for (std::size_t i = 0; i < r.returns_per_laser.size(); ++i)
    lasers.push_back(
        {{"laser", i}, {"elevation_deg", r.elevation_deg[i]}, {"returns", r.returns_per_laser[i]}});
  nlohmann::json j{
      {"file", r.file},
      {"format", "pcap"},
      {"frames", r.frames},
      {"packets", r.data_packets},
      {"position_packets", r.position_packets},
      {"other_frames", r.other_frames},
      {"malformed", {{"count", r.malformed}, {"by_fault", r.faults}}},
      {"azimuth_360_packets", r.full_turns},
      {"sources", r.sources},
      {"duration_s", r.duration_s},
      {"model",
       {{"decoded_as", r.model_known ? model_json(r.model) : nlohmann::json()},
        {"by_product_byte", model_json(r.model_by_byte)},
        {"product_byte", r.product_byte},
        {"by_timing", model_json(r.model_by_timing)},
        {"mismatch", mismatch(r)}}},
      {"return_modes", r.return_modes},
      {"revolutions", r.revolutions},
      {"turns", r.turns},
      {"valid_returns", r.valid_returns},
      {"points_decoded", r.points_handed_on},
      {"returns_per_laser", lasers},
      {"range_m", {{"minimum", r.minimum_range_m}, {"maximum", r.greatest_range_m}}},
      {"rates",
       {{"packets_per_s", r.packets_per_s},
        {"position_packets_per_s", r.position_packets_per_s},
        {"rotation_hz", r.rotation_hz}}},
      {"gaps", {{"count", r.gaps}, {"packets_lost", r.packets_lost}, {"longest_ms", r.longest_gap_ms}}},
      {"clock_steps", r.clock_steps},
      {"pps", r.pps},
      {"nmea", {{"first", r.first_nmea}, {"last", r.last_nmea}}},
      {"whole", !r.ended_by}};
  if (r.ended_by) j["ended_by"] = r.ended_by->text();
  return j;
}

std::string to_text(const PcapReport& r) {
  std::string t = fmt::format("{}: {} frames, {:.3f} s\n", r.file, r.frames, r.duration_s);
  if (r.data_packets == 0)
    return t + fmt::format(
                   "  no data packets of a Velodyne; {} malformed, {} other frames. A recording of an "
                   "Ouster needs its metadata: --metadata FILE.json\n",
                   r.malformed, r.other_frames);
  t += fmt::format("  model            {}", r.model_known ? velodyne::facts_of(r.model).name : "not known");
  if (mismatch(r))
    t += fmt::format(
        " by its timing; its product byte 0x{:02X} says {}: a rig that reads it needs `model: {}`",
        r.product_byte, velodyne::facts_of(*r.model_by_byte).name, velodyne::facts_of(r.model).key);
  else if (!r.model_by_byte)
    t += fmt::format(" (product byte 0x{:02X} is no known one)", r.product_byte);
  t += fmt::format("\n  data packets     {} at {:.1f}/s\n", r.data_packets, r.packets_per_s);
  for (const auto& [source, n] : r.sources) t += fmt::format("    from {} {}\n", source, n);
  for (const auto& [mode, n] : r.return_modes) t += fmt::format("    returns {} {}\n", mode, n);
  t += fmt::format("  revolutions      {} whole, {:.2f} turns at {:.3f} Hz\n", r.revolutions, r.turns,
                   r.rotation_hz);
  t += fmt::format("  valid returns    {} from {:.3f} to {:.3f} m\n", r.valid_returns, r.minimum_range_m,
                   r.greatest_range_m);
  t += fmt::format("  gaps             {}, {} packets lost, longest {:.1f} ms\n", r.gaps, r.packets_lost,
                   r.longest_gap_ms);
  t += fmt::format("  position packets {} at {:.1f}/s\n", r.position_packets, r.position_packets_per_s);
  for (const auto& [pps, n] : r.pps) t += fmt::format("    PPS {} {}\n", pps, n);
  if (!r.last_nmea.empty()) t += fmt::format("    last {}\n", r.last_nmea);
  if (r.malformed + r.other_frames > 0)
    t += fmt::format("  malformed        {}; other frames {}\n", r.malformed, r.other_frames);
  for (const auto& [fault, n] : r.faults) t += fmt::format("    {} {}\n", fault, n);
  if (r.full_turns > 0) t += fmt::format("  azimuth 36000    {} packets, read as 0 degrees\n", r.full_turns);
  t += "  laser  elevation   returns\n";
  for (std::size_t i = 0; i < r.returns_per_laser.size(); ++i)
    t += fmt::format("  {:>5}  {:>7.2f}°  {:>8}\n", i, r.elevation_deg[i], r.returns_per_laser[i]);
  return t;
}

std::string read_task(const InspectOptions& options) { return "read " + options.file.filename().string(); }

/// A recording that breaks off is told as far as it goes, and is an error.
int inspect_pcap_command(const InspectOptions& options) {
  if (options.repair)
    return report_error({ErrorCode::bad_input, options.file.string(),
                         "expected a recording of Rigor (MCAP), got a pcap: there is nothing to repair"},
                        options.json);
  if (options.metadata.empty() && is_livox_recording(options.file)) return inspect_livox_command(options);
  const auto metadata = options.metadata.empty() ? ouster_metadata_beside(options.file) : options.metadata;
  if (!metadata.empty()) return inspect_ouster_command(options, metadata);
  std::optional<ProgressTask> reading(std::in_place, read_task(options));
  auto report = velodyne::inspect_pcap(options.file);
  reading.reset();
  if (!report) return report_error(report.error(), options.json);
  fmt::print("{}", options.json ? json_text(to_json(*report)) + "\n" : to_text(*report));
  if (!report->ended_by) return 0;
  if (!options.json) std::fflush(stdout);
  return options.json ? 1 : report_error(*report->ended_by, false);
}

/// By the index, and then the checksums over the whole file: what the index does not cover is not left
/// unsaid.
Result<record::RecordingReport> inspect_all(const std::string& file) {
  auto report = record::inspect(file);
  if (!report || !report->health.good()) return report;
  auto scanned = record::McapReader::open(file, {.scan = true, .skip_damaged = true, .any_schema = true});
  if (!scanned) return tl::unexpected<Error>(scanned.error());
  const record::Health& found = (*scanned)->health();
  if (found.good()) return report;
  const bool indexed = report->health.indexed;
  report->health = found;
  report->health.indexed = indexed;
  return report;
}

/// What is damaged is told as far as it goes, and is an error.
int report_damage(const std::string& file, const record::Health& health, bool as_json) {
  std::fflush(stdout);
  if (as_json) return 1;
  const std::size_t more = health.notes.size() > 1 ? health.notes.size() - 1 : 0;
  return report_error(
      {ErrorCode::protocol, file,
       fmt::format(
           "expected a whole recording, got one that is damaged{}{}; `rigor inspect {} --repair` keeps what "
           "can be read",
           health.notes.empty() ? std::string() : ": " + health.notes.front(),
           more > 0 ? fmt::format(", and {} more", more) : "", file)},
      false);
}

/// What the scans of a SICK scanner's telegrams hold.
int inspect_sick_command(const InspectOptions& options) {
  if (options.repair)
    return report_error({ErrorCode::bad_input, options.file.string(),
                         "expected a recording of Rigor (MCAP), got telegrams: there is nothing to repair"},
                        options.json);
  std::uint64_t points = 0, most = 0, gaps = 0;
  double minimum_m = std::numeric_limits<double>::infinity(), maximum_m = 0, strongest = 0, longest_s = 0;
  std::optional<BenchTime> first, last;
  std::vector<double> periods_s;
  std::optional<ProgressTask> reading(std::in_place, read_task(options), 0, "scans");
  std::uint64_t scans = 0;
  const auto read = read_sick_recording(options.file, [&](const Sample& sample) {
    const std::size_t n = sample.bytes().size() / sizeof(LidarPoint);
    const auto* p = reinterpret_cast<const LidarPoint*>(sample.bytes().data());
    for (std::size_t i = 0; i < n; ++i) {
      const double range_m = std::hypot(double{p[i].x_m}, double{p[i].y_m}, double{p[i].z_m});
      minimum_m = std::min(minimum_m, range_m), maximum_m = std::max(maximum_m, range_m);
      strongest = std::max(strongest, double{p[i].remission});
    }
    points += n, most = std::max<std::uint64_t>(most, n);
    if (last) periods_s.push_back((sample.stamp.t_capture - *last).seconds());
    if (!first) first = sample.stamp.t_capture;
    last = sample.stamp.t_capture;
    reading->set(static_cast<double>(++scans));
    return true;
  });
  reading.reset();
  if (!read) return report_error(read.error(), options.json);
  double period_s = 0;
  if (!periods_s.empty()) {
    std::vector<double> sorted = periods_s;
    std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2),
                     sorted.end());
    period_s = sorted[sorted.size() / 2];
    for (const double p : periods_s) gaps += p > 1.5 * period_s, longest_s = std::max(longest_s, p);
  }
  const double rate_hz = period_s > 0 ? 1 / period_s : 0, duration_s = first ? (*last - *first).seconds() : 0;
  if (points == 0) minimum_m = 0;
  const bool whole = read->warnings.empty();
  if (options.json)
    fmt::print("{}\n", json_text({{"file", options.file.string()},
                                  {"format", "SICK telegrams"},
                                  {"scans", read->samples},
                                  {"duration_s", duration_s},
                                  {"rate_hz", rate_hz},
                                  {"points", points},
                                  {"points_per_scan_max", most},
                                  {"range_m", {{"minimum", minimum_m}, {"maximum", maximum_m}}},
                                  {"remission_max", strongest},
                                  {"gaps", {{"count", gaps}, {"longest_ms", longest_s * 1e3}}},
                                  {"whole", whole},
                                  {"warnings", read->warnings}}));
  else
    fmt::print(
        "{}: {} scans of a SICK scanner, {:.3f} s\n  rate      {:.2f} Hz, {} gaps, longest {:.1f} ms\n"
        "  points    {}, at most {} a scan, from {:.3f} to {:.3f} m, remission up to {:g}\n",
        options.file.string(), read->samples, duration_s, rate_hz, gaps, longest_s * 1e3, points, most,
        minimum_m, maximum_m, strongest);
  if (whole) return 0;
  std::fflush(stdout);
  return options.json ? 1 : report_error({ErrorCode::protocol, "", read->warnings.front()}, false);
}

}  // namespace

int inspect_command(const InspectOptions& options) {
  const std::string file = options.file.string();
  if (network::is_pcap(options.file)) return inspect_pcap_command(options);
  if (!options.metadata.empty())
    return report_error({ErrorCode::bad_input, "--metadata",
                         "expected none but with packets of an Ouster (pcap), got it with another file"},
                        options.json);
  if (is_fmu(options.file)) return inspect_fmu_command(options);
  if (is_sick_recording(options.file)) return inspect_sick_command(options);
  if (is_receiver_log(options.file)) return inspect_receiver_log_command(options);
  if (!options.repair) {
    std::optional<ProgressTask> reading(std::in_place, read_task(options));
    auto report = inspect_all(file);
    reading.reset();
    if (!report) return report_error(report.error(), options.json);
    fmt::print("{}", options.json ? json_text(record::to_json(*report)) + "\n" : record::to_text(*report));
    return report->health.good() ? 0 : report_damage(file, report->health, options.json);
  }
  std::filesystem::path output = options.output;
  if (output.empty()) output = std::filesystem::path(options.file).replace_extension(".repaired.mcap");
  InputFiles inputs;
  inputs.add("the recording that is repaired", options.file);
  Outputs outputs(std::move(inputs));
  if (auto s = outputs.add(output, "-o", options.force ? Existing::replace : Existing::refuse); !s)
    return report_error(s.error(), options.json);
  Result<record::RepairReport> report = fail(ErrorCode::internal, file, "not repaired");
  const Status written = write_output(output, [&](const std::filesystem::path& part) -> Status {
    auto source = record::open_file_source(file);
    if (!source) return tl::unexpected<Error>(source.error());
    auto sink = record::open_file_sink(part.string());
    if (!sink) return tl::unexpected<Error>(sink.error());
    ProgressTask repairing("repair", 0, "MB written");
    repairing.follow([&part] {
      std::error_code none;
      const auto bytes = std::filesystem::file_size(part, none);
      return none ? 0.0 : static_cast<double>(bytes) / 1e6;
    });
    report = record::repair(std::move(*source), std::move(*sink));
    return report ? Status{} : Status(tl::unexpected<Error>(report.error()));
  });
  if (!written) return report_error(written.error(), options.json);
  if (options.json)
    fmt::print("{}\n", nlohmann::json{{"output", output.string()},
                                      {"was_good", report->was_good},
                                      {"messages", report->messages},
                                      {"attachments_lost", report->attachments_lost},
                                      {"input_bytes", report->input_bytes},
                                      {"output_bytes", report->output_bytes}}
                           .dump(2));
  else
    fmt::print("{}: {} messages kept, {} of {} bytes{}\n", output.string(), report->messages,
               report->output_bytes, report->input_bytes,
               report->was_good ? "; nothing was wrong with the original" : "");
  return 0;
}

}  // namespace rigor
