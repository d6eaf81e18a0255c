// `rigor convert`: what a LiDAR sent, as points, without a rig.
#include <fmt/format.h>

#include <cstring>
#include <nlohmann/json.hpp>

#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/files/output_file.h"
#include "bench/run/recording.h"
#include "bench/sensing/sample_files.h"
#include "calibration/procedures/recording_packets.h"
#include "cli/commands.h"
#include "cli/receiver_log.h"
#include "drivers/network/pcap_file.h"
#include "sensor-hal/record/recorder.h"

namespace rigor {
namespace {

constexpr const char* kChannel = "points";

struct Converted {
  std::uint64_t scans = 0, points = 0;
  std::vector<std::string> warnings;
};

std::span<const LidarPoint> points_of(const Sample& sample) {
  return {reinterpret_cast<const LidarPoint*>(sample.bytes().data()),
          sample.bytes().size() / sizeof(LidarPoint)};
}

Result<RecordingInput> read_clouds(const ConvertOptions& options, const TakeSample& take) {
  const std::filesystem::path& file = options.input;
  if (network::is_pcap(file)) {
    if (options.metadata.empty() && is_livox_recording(file)) return read_livox_recording(file, take);
    const auto metadata = options.metadata.empty() ? ouster_metadata_beside(file) : options.metadata;
    return metadata.empty() ? read_velodyne_recording(file, take)
                            : read_ouster_recording(file, metadata, take);
  }
  if (is_sick_recording(file)) return read_sick_recording(file, take);
  if (is_receiver_log(file)) return read_receiver_log(file, take);
  std::error_code none;
  if (!std::filesystem::is_regular_file(file, none))
    return fail(ErrorCode::not_found, file.string(), "expected a recording, found no such file");
  return fail(
      ErrorCode::bad_input, file.string(),
      "expected packets of a Velodyne, a Livox or an Ouster (pcap, pcapng), telegrams of a SICK scanner "
      "(.json) or what a satellite receiver sent (.ubx, .nmea, .log), got "
      "another file");
}

/// When it was recorded: the device's own clock counts from the hour, or from when it was switched on.
RealtimeTime recorded_at(const std::filesystem::path& file) {
  if (is_receiver_log(file)) return begin_of_receiver_log(file);
  if (!network::is_pcap(file)) return kVirtualEpoch.utc;
  auto reader = network::PcapReader::open(file);
  if (!reader) return kVirtualEpoch.utc;
  while (true) {
    const auto record = reader->next();
    if (!record || !*record) return kVirtualEpoch.utc;
    if ((*record)->udp) return (*record)->t;
  }
}

Result<Converted> to_pcd(const ConvertOptions& options) {
  Converted out;
  ProgressTask progress("read " + options.input.filename().string(), 0, "scans");
  Status written = fail(ErrorCode::bad_input, "--scan", "");
  const auto read = read_clouds(options, [&](const Sample& sample) {
    progress.set(static_cast<double>(out.scans));
    if (out.scans++ != static_cast<std::uint64_t>(options.scan)) return true;
    const auto points = points_of(sample);
    out.points = points.size();
    written = write_output(options.output,
                           [&](const std::filesystem::path& part) { return write_points_pcd(part, points); });
    return false;
  });
  if (!read) return tl::unexpected<Error>(read.error());
  out.warnings = read->warnings;
  if (!written && written.error().where == "--scan")
    return fail(ErrorCode::bad_input, "--scan",
                fmt::format("expected a number from 0 to {}, as the recording has {} scans, got {}",
                            out.scans - 1, out.scans, options.scan));
  if (!written) return tl::unexpected<Error>(written.error());
  out.scans = 1;
  return out;
}

Result<Converted> to_mcap(const ConvertOptions& options) {
  Converted out;
  std::size_t most = 0;
  std::optional<BenchTime> first;
  std::optional<ProgressTask> progress(std::in_place, "read " + options.input.filename().string(), 0,
                                       "scans");
  std::uint64_t scans = 0;
  const auto counted = read_clouds(options, [&](const Sample& sample) {
    if (!first) first = sample.stamp.t_capture;
    most = std::max(most, sample.bytes().size());
    progress->set(static_cast<double>(++scans));
    return true;
  });
  if (!counted) return tl::unexpected<Error>(counted.error());
  progress.emplace("convert", static_cast<double>(scans), "scans");
  const auto write = [&](const std::filesystem::path& part) -> Status {
    RecorderOptions how;
    how.virtual_time = true;  // nothing is skipped
    how.epoch = {*first, recorded_at(options.input), {}};
    how.writer.compression = record::Compression::zstd;
    RecordedChannel channel;
    const bool fixes = is_receiver_log(options.input);
    channel.name = fixes ? "gnss" : kChannel;
    channel.description.kind = fixes ? SampleKind::nav_fix : SampleKind::point_cloud;
    channel.description.frame_id = channel.name;
    channel.description.max_bytes = most;
    auto recorder =
        Recorder::create(part.string(), how, {std::move(channel)}, {},
                         {{"converted_from", options.input.filename().string()}, {"version", RIGOR_VERSION}});
    if (!recorder) return tl::unexpected<Error>(recorder.error());
    (*recorder)->begin(*first);
    const auto pool = make_sample_pool(4, most);
    const auto read = read_clouds(options, [&](const Sample& sample) {
      SampleSlot slot = pool->try_acquire();
      if (!slot) return false;
      Sample& copy = *slot;
      copy.info = sample.info;
      copy.stamp = sample.stamp;
      copy.size_bytes = sample.bytes().size();
      if (copy.size_bytes > 0) std::memcpy(copy.memory().data(), sample.bytes().data(), copy.size_bytes);
      (*recorder)->record(0, std::move(slot));
      (*recorder)->end_cycle(out.scans++, sample.stamp.t_release);
      out.points += points_of(sample).size();
      progress->set(static_cast<double>(out.scans));
      return !(*recorder)->failed();
    });
    const Status stopped = (*recorder)->stop();
    if (!read) return tl::unexpected<Error>(read.error());
    out.warnings = read->warnings;
    return stopped;
  };
  if (auto s = write_output(options.output, write); !s) return tl::unexpected<Error>(s.error());
  progress->finish();
  return out;
}

Result<Converted> convert(const ConvertOptions& options) {
  const auto ending = options.output.extension();
  if (ending != ".mcap" && ending != ".pcd")
    return fail(
        ErrorCode::bad_input, "-o",
        fmt::format("expected a file that ends in .mcap (all scans) or .pcd (one of them), got \"{}\"",
                    options.output.string()));
  if (ending == ".pcd" && is_receiver_log(options.input))
    return fail(ErrorCode::bad_input, "-o",
                "expected a file that ends in .mcap: a receiver's places are no point cloud; got \"" +
                    options.output.string() + "\"");
  if (ending == ".mcap" && options.scan_given)
    return fail(ErrorCode::bad_input, "--scan", "expected none with an .mcap, which gets all scans");
  InputFiles inputs;
  inputs.add("the recording", options.input);
  Outputs outputs(std::move(inputs));
  if (auto s = outputs.add(options.output, "-o", options.force ? Existing::replace : Existing::refuse); !s)
    return tl::unexpected<Error>(s.error());
  return ending == ".pcd" ? to_pcd(options) : to_mcap(options);
}

}  // namespace

int convert_command(const ConvertOptions& options) {
  const auto made = convert(options);
  if (!made) return report_error(made.error(), options.json);
  for (const std::string& w : made->warnings) fmt::print(stderr, "rigor: warning: {}\n", w);
  if (options.json)
    fmt::print("{}\n", json_text({{"output", options.output.string()},
                                  {"scans", made->scans},
                                  {"points", made->points},
                                  {"warnings", made->warnings}}));
  else
    fmt::print("{}: {} {}{}{}\n", options.output.string(), made->scans,
               is_receiver_log(options.input) ? "fix" : "scan",
               made->scans == 1                 ? ""
               : is_receiver_log(options.input) ? "es"
                                                : "s",
               is_receiver_log(options.input) ? "" : fmt::format(", {} points", made->points));
  return 0;
}

}  // namespace rigor
