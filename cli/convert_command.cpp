// `rigor convert`: what a LiDAR sent, as points or images, without a rig.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>

#include "bench/console/progress.h"
#include "bench/console/terminal.h"
#include "bench/files/output_file.h"
#include "bench/files/picture.h"
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
  double full_scale = 0;  ///< of a .png: the number that is white, the metres that are red
  std::vector<std::string> warnings;
};

std::span<const LidarPoint> points_of(const Sample& sample) {
  return {reinterpret_cast<const LidarPoint*>(sample.bytes().data()),
          sample.bytes().size() / sizeof(LidarPoint)};
}

std::optional<ouster::ImageOptions> image_of(const ConvertOptions& options) {
  const auto field = ouster::field_named(options.image);
  return field ? std::optional(ouster::ImageOptions{.field = *field}) : std::nullopt;
}

Result<RecordingInput> read_scans(const ConvertOptions& options, const TakeSample& take) {
  const std::filesystem::path& file = options.input;
  if (network::is_pcap(file)) {
    if (options.metadata.empty() && options.image.empty() && is_livox_recording(file))
      return read_livox_recording(file, take);
    const auto metadata = options.metadata.empty() ? ouster_metadata_beside(file) : options.metadata;
    if (!metadata.empty()) return read_ouster_recording(file, metadata, take, image_of(options));
    if (options.image.empty()) return read_velodyne_recording(file, take);
  }
  if (!options.image.empty())
    return fail(
        ErrorCode::bad_input, "--image",
        "expected packets of an Ouster (pcap, pcapng) and its metadata (--metadata, or a .json of the "
        "same name beside them), got " +
            file.string());
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

/// 8 bits for people: white is what one pixel in a hundred of those that are not 0 exceeds.
Status write_stretched_png(const std::filesystem::path& file, const ImageInfo& info,
                           std::span<const std::byte> bytes, double& full_scale) {
  const auto values = pixel_values(info, bytes);
  if (!values) return tl::unexpected<Error>(values.error());
  std::vector<double> lit;
  std::copy_if(values->begin(), values->end(), std::back_inserter(lit), [](double v) { return v > 0; });
  full_scale = 1;
  if (!lit.empty()) {
    const auto at = lit.begin() + static_cast<std::ptrdiff_t>(0.99 * static_cast<double>(lit.size() - 1));
    std::nth_element(lit.begin(), at, lit.end());
    full_scale = *at;
  }
  std::vector<std::uint8_t> grey;
  for (const double v : *values)
    grey.push_back(static_cast<std::uint8_t>(std::lround(std::min(1.0, v / full_scale) * 255)));
  const auto png = png_of(grey, static_cast<int>(info.width_px), static_cast<int>(info.height_px), 1);
  std::ofstream out(file, std::ios::binary);
  out.write(reinterpret_cast<const char*>(png.data()), static_cast<std::streamsize>(png.size()));
  if (out.flush()) return {};
  return fail(ErrorCode::io, file.string(), "expected to write the picture, could not");
}

Status write_one(const std::filesystem::path& file, const Sample& sample, Converted& out) {
  if (const auto* image = sample.as<ImageInfo>())
    return write_stretched_png(file, *image, sample.bytes(), out.full_scale);
  if (const auto* range = sample.as<RangeImageInfo>()) {
    const std::size_t pixels = std::size_t{range->width_px} * range->height_px;
    const std::span<const float> planes(reinterpret_cast<const float*>(sample.bytes().data()), 2 * pixels);
    return write_range_png(
        file, {range->width_px, range->height_px, planes.first(pixels), planes.last(pixels)}, out.full_scale);
  }
  out.points = points_of(sample).size();
  return write_points_pcd(file, points_of(sample));
}

/// As a .pcd or .png.
Result<Converted> to_one(const ConvertOptions& options) {
  Converted out;
  ProgressTask progress("read " + options.input.filename().string(), 0, "scans");
  Status written = fail(ErrorCode::bad_input, "--scan", "");
  const auto read = read_scans(options, [&](const Sample& sample) {
    progress.set(static_cast<double>(out.scans));
    if (out.scans++ != static_cast<std::uint64_t>(options.scan)) return true;
    written = write_output(options.output,
                           [&](const std::filesystem::path& part) { return write_one(part, sample, out); });
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
  ChannelDescription description;
  const auto counted = read_scans(options, [&](const Sample& sample) {
    if (!first) first = sample.stamp.t_capture;
    description.kind = sample.kind();
    if (const auto* image = sample.as<ImageInfo>()) {
      description.width_px = image->width_px, description.height_px = image->height_px;
      description.format = image->format;
    } else if (const auto* range = sample.as<RangeImageInfo>()) {
      description.width_px = range->width_px, description.height_px = range->height_px;
    }
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
    channel.name = is_receiver_log(options.input) ? "gnss"
                   : options.image.empty()        ? kChannel
                                                  : options.image.c_str();
    channel.description = description;
    channel.description.frame_id = channel.name;
    channel.description.max_bytes = most;
    auto recorder =
        Recorder::create(part.string(), how, {std::move(channel)}, {},
                         {{"converted_from", options.input.filename().string()}, {"version", RIGOR_VERSION}});
    if (!recorder) return tl::unexpected<Error>(recorder.error());
    (*recorder)->begin(*first);
    const auto pool = make_sample_pool(4, most);
    const auto read = read_scans(options, [&](const Sample& sample) {
      SampleSlot slot = pool->try_acquire();
      if (!slot) return false;
      Sample& copy = *slot;
      copy.info = sample.info;
      copy.stamp = sample.stamp;
      copy.size_bytes = sample.bytes().size();
      if (copy.size_bytes > 0) std::memcpy(copy.memory().data(), sample.bytes().data(), copy.size_bytes);
      (*recorder)->record(0, std::move(slot));
      (*recorder)->end_cycle(out.scans++, sample.stamp.t_release);
      if (sample.kind() == SampleKind::point_cloud) out.points += points_of(sample).size();
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
  const std::string one = options.image.empty() ? ".pcd" : ".png";
  if (ending != ".mcap" && ending != one)
    return fail(
        ErrorCode::bad_input, "-o",
        fmt::format("expected a file that ends in .mcap (all scans) or {} (one of them){}, got \"{}\"", one,
                    ending == ".png" ? "; a .png is of a field, which --image names" : "",
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
  return ending == ".mcap" ? to_mcap(options) : to_one(options);
}

}  // namespace

int convert_command(const ConvertOptions& options) {
  const auto made = convert(options);
  if (!made) return report_error(made.error(), options.json);
  for (const std::string& w : made->warnings) fmt::print(stderr, "rigor: warning: {}\n", w);
  const bool fixes = is_receiver_log(options.input), png = options.output.extension() == ".png";
  if (options.json) {
    nlohmann::json j{
        {"output", options.output.string()}, {"scans", made->scans}, {"warnings", made->warnings}};
    if (options.image.empty()) j["points"] = made->points;
    if (png) j["full_scale"] = made->full_scale;
    fmt::print("{}\n", json_text(j));
    return 0;
  }
  std::string what;
  if (options.image.empty() && !fixes) what = fmt::format(", {} points", made->points);
  if (png)
    what = options.image == "range" ? fmt::format("; red is {} m", made->full_scale)
                                    : fmt::format("; white is {}", made->full_scale);
  fmt::print("{}: {} {}{}{}\n", options.output.string(), made->scans, fixes ? "fix" : "scan",
             made->scans == 1 ? ""
             : fixes          ? "es"
                              : "s",
             what);
  return 0;
}

}  // namespace rigor
