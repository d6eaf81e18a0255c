#include "cli/inspect_ouster.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "drivers/ouster/pcap_report.h"

namespace rigor {
namespace {

nlohmann::json to_json(const ouster::PcapReport& r) {
  const ouster::Metadata& m = r.metadata;
  nlohmann::json j{{"file", r.file},
                   {"format", "pcap"},
                   {"device", "Ouster"},
                   {"sensor",
                    {{"product_line", m.product_line},
                     {"serial", m.serial},
                     {"firmware", m.firmware},
                     {"profile", std::string(name_of(m.profile))},
                     {"lidar_mode", name_of(m.mode)},
                     {"beams", m.pixels_per_column},
                     {"column_window", {m.window.first, m.window.last}}}},
                   {"captured_frames", r.captured},
                   {"fragments", {{"count", r.fragments}, {"datagrams_given_up", r.datagrams_given_up}}},
                   {"packets", r.lidar_packets},
                   {"imu_packets", r.imu_packets},
                   {"other_datagrams", r.other_datagrams},
                   {"malformed", {{"count", r.malformed}, {"by_fault", r.faults}}},
                   {"sources", r.sources},
                   {"duration_s", r.duration_s},
                   {"frames",
                    {{"count", r.frames.frames},
                     {"incomplete", r.frames_incomplete},
                     {"lost", r.frames.frames_lost},
                     {"packets_lost", r.frames.packets_lost},
                     {"columns_lost", r.frames.columns_lost},
                     {"packets_late", r.frames.packets_late},
                     {"restarts", r.frames.restarts},
                     {"other_initialization", r.frames.other_initialization}}},
                   {"columns_not_good", r.columns_not_good},
                   {"timestamp_ns", {{"first", r.first_timestamp_ns}, {"last", r.last_timestamp_ns}}},
                   {"rates",
                    {{"packets_per_s", r.packets_per_s},
                     {"imu_packets_per_s", r.imu_packets_per_s},
                     {"frames_per_s", r.frame_rate_hz}}},
                   {"valid_returns", r.returns},
                   {"second_returns", r.second_returns},
                   {"returns_per_row", r.returns_per_row},
                   {"range_m", {{"minimum", r.minimum_range_m}, {"maximum", r.maximum_range_m}}},
                   {"whole", !r.ended_by}};
  if (r.ended_by) j["ended_by"] = r.ended_by->text();
  return j;
}

std::string to_text(const ouster::PcapReport& r) {
  const ouster::Metadata& m = r.metadata;
  std::string t = fmt::format("{}: {} frames captured, {:.3f} s\n", r.file, r.captured, r.duration_s);
  t += fmt::format("  sensor           {} {}, firmware {}: {} beams, {}, {}\n", m.product_line, m.serial,
                   m.firmware, m.pixels_per_column, name_of(m.mode), name_of(m.profile));
  if (r.lidar_packets == 0)
    return t +
           fmt::format(
               "  no lidar packets of this sensor; {} malformed, {} other datagrams: do the metadata belong "
               "to this recording?\n",
               r.malformed, r.other_datagrams);
  t += fmt::format("  lidar packets    {} at {:.1f}/s\n", r.lidar_packets, r.packets_per_s);
  for (const auto& [source, n] : r.sources) t += fmt::format("    from {} {}\n", source, n);
  if (r.fragments > 0)
    t += fmt::format("    in {} fragments; {} datagrams lack one\n", r.fragments, r.datagrams_given_up);
  t += fmt::format("  frames           {}, {} incomplete, {} lost{}\n", r.frames.frames, r.frames_incomplete,
                   r.frames.frames_lost,
                   r.frame_rate_hz > 0 ? fmt::format("; {:.3f} Hz", r.frame_rate_hz) : "");
  t += fmt::format("  lost             {} packets, {} columns; {} late; {} columns that came are not good\n",
                   r.frames.packets_lost, r.frames.columns_lost, r.frames.packets_late, r.columns_not_good);
  if (r.frames.other_initialization > 0)
    t += fmt::format(
        "  initialization   {} packets are of a sensor that was configured anew since these metadata\n",
        r.frames.other_initialization);
  t += fmt::format("  valid returns    {}{} from {:.3f} to {:.3f} m\n", r.returns,
                   r.second_returns > 0 ? fmt::format(", {} of them second ones,", r.second_returns) : "",
                   r.minimum_range_m, r.maximum_range_m);
  t += fmt::format("  IMU packets      {} at {:.1f}/s\n", r.imu_packets, r.imu_packets_per_s);
  if (r.malformed + r.other_datagrams > 0)
    t += fmt::format("  malformed        {}; other datagrams {}\n", r.malformed, r.other_datagrams);
  for (const auto& [fault, n] : r.faults) t += fmt::format("    {} {}\n", fault, n);
  t += "    row  altitude  azimuth   returns\n";
  for (std::size_t i = 0; i < r.returns_per_row.size(); ++i)
    t += fmt::format("  {:>5}  {:>7.2f}° {:>7.2f}°  {:>8}\n", i, m.beam_altitude_deg[i],
                     m.beam_azimuth_deg[i], r.returns_per_row[i]);
  return t;
}

}  // namespace

int inspect_ouster_command(const InspectOptions& options, const std::filesystem::path& metadata) {
  std::optional<ProgressTask> reading(std::in_place, "read " + options.file.filename().string());
  auto report = ouster::inspect_pcap(options.file, metadata);
  reading.reset();
  if (!report) return report_error(report.error(), options.json);
  fmt::print("{}", options.json ? json_text(to_json(*report)) + "\n" : to_text(*report));
  if (!report->ended_by) return 0;
  if (!options.json) std::fflush(stdout);
  return options.json ? 1 : report_error(*report->ended_by, false);
}

}  // namespace rigor
