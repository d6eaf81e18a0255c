#include "cli/inspect_livox.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "drivers/livox/pcap_report.h"

namespace rigor {
namespace {

nlohmann::json livox_json(const livox::PcapReport& r) {
  nlohmann::json j{{"file", r.file},
                   {"format", "pcap"},
                   {"device", "Livox Mid-360"},
                   {"captured_frames", r.captured},
                   {"packets", r.point_packets},
                   {"imu_packets", r.imu_packets},
                   {"commands", {{"requests", r.commands}, {"answers", r.answers}, {"pushes", r.pushes}}},
                   {"other_datagrams", r.other_datagrams},
                   {"malformed", {{"count", r.malformed}, {"by_fault", r.faults}}},
                   {"sources", r.sources},
                   {"data_types", r.data_types},
                   {"time_types", r.time_types},
                   {"duration_s", r.duration_s},
                   {"frames", {{"count", r.stream.frames}, {"incomplete", r.stream.frames_incomplete}}},
                   {"packets_lost", r.stream.packets_lost},
                   {"packets_late", r.stream.packets_late},
                   {"clock_steps", r.stream.clock_steps},
                   {"timestamp_ns", {{"first", r.first_timestamp_ns}, {"last", r.last_timestamp_ns}}},
                   {"rates",
                    {{"packets_per_s", r.packets_per_s},
                     {"points_per_s", r.points_per_s},
                     {"imu_packets_per_s", r.imu_packets_per_s}}},
                   {"valid_returns", r.stream.points},
                   {"without_return", r.without_return},
                   {"low_confidence", r.low_confidence},
                   {"returns_per_line", r.returns_per_line},
                   {"range_m", {{"minimum", r.minimum_range_m}, {"maximum", r.maximum_range_m}}},
                   {"whole", !r.ended_by}};
  if (r.ended_by) j["ended_by"] = r.ended_by->text();
  return j;
}

std::string livox_text(const livox::PcapReport& r) {
  std::string t =
      fmt::format("{}: {} frames captured, {:.3f} s, a Livox Mid-360\n", r.file, r.captured, r.duration_s);
  t += fmt::format("  point packets    {} at {:.1f}/s, {:.0f} points/s\n", r.point_packets, r.packets_per_s,
                   r.points_per_s);
  for (const auto& [source, n] : r.sources) t += fmt::format("    from {} {}\n", source, n);
  for (const auto& [type, n] : r.data_types) t += fmt::format("    {} {}\n", type, n);
  for (const auto& [type, n] : r.time_types) t += fmt::format("    time: {} {}\n", type, n);
  t += fmt::format("  frames           {} of 100 ms, {} incomplete\n", r.stream.frames,
                   r.stream.frames_incomplete);
  t += fmt::format("  lost             {} packets; {} late; {} clock steps\n", r.stream.packets_lost,
                   r.stream.packets_late, r.stream.clock_steps);
  t += fmt::format(
      "  returns          {} from {:.3f} to {:.3f} m; {} points without one, {} of low confidence\n",
      r.stream.points, r.minimum_range_m, r.maximum_range_m, r.without_return, r.low_confidence);
  for (std::size_t i = 0; i < r.returns_per_line.size(); ++i)
    t += fmt::format("    line {} {}\n", i, r.returns_per_line[i]);
  t += fmt::format("  IMU packets      {} at {:.1f}/s\n", r.imu_packets, r.imu_packets_per_s);
  if (r.commands + r.answers + r.pushes > 0)
    t += fmt::format("  commands         {}, {} answers, {} pushes\n", r.commands, r.answers, r.pushes);
  if (r.malformed + r.other_datagrams > 0)
    t += fmt::format("  malformed        {}; other datagrams {}\n", r.malformed, r.other_datagrams);
  for (const auto& [fault, n] : r.faults) t += fmt::format("    {} {}\n", fault, n);
  return t;
}

}  // namespace

int inspect_livox_command(const InspectOptions& options) {
  std::optional<ProgressTask> reading(std::in_place, "read " + options.file.filename().string());
  auto report = livox::inspect_pcap(options.file);
  reading.reset();
  if (!report) return report_error(report.error(), options.json);
  fmt::print("{}", options.json ? json_text(livox_json(*report)) + "\n" : livox_text(*report));
  if (!report->ended_by) return 0;
  if (!options.json) std::fflush(stdout);
  return options.json ? 1 : report_error(*report->ended_by, false);
}

}  // namespace rigor
