// Recordings of what a LiDAR sent, as samples: packets of a Velodyne, a Livox or an Ouster (pcap, pcapng) and
// telegrams of a SICK scanner (JSON as Wireshark and SICK's own converter write it, one `tcp.payload` in hex
// for each segment).
#pragma once

#include <filesystem>
#include <optional>

#include "calibration/procedures/recording_input.h"
#include "drivers/ouster/frame_image.h"

namespace rigor {

/// By the file's name: .pcap, .pcapng, .cap.
[[nodiscard]] bool is_velodyne_recording(const std::filesystem::path& file);
/// Point clouds, one for each revolution (the first and the last as far as they were recorded), points by
/// laser id; the model by the timing of its packets, and a product byte that says otherwise is a warning. The
/// positions are those of the manual: no specimen's corrections. not_found, bad_input (no packets of a
/// Velodyne in it).
[[nodiscard]] Result<RecordingInput> read_velodyne_recording(const std::filesystem::path& file,
                                                             const TakeSample& take);

/// Whether a pcap or pcapng has packets of a Livox Mid-360 among its first.
[[nodiscard]] bool is_livox_recording(const std::filesystem::path& file);
/// Point clouds, one for each 100 ms of the device's time that was recorded from its beginning; points by
/// line. not_found, bad_input (no packets of its points in it).
[[nodiscard]] Result<RecordingInput> read_livox_recording(const std::filesystem::path& file,
                                                          const TakeSample& take);

/// The metadata of an Ouster beside a recording: F.json of F.pcap, where it is that. Empty: there are none.
[[nodiscard]] std::filesystem::path ouster_metadata_beside(const std::filesystem::path& file);
/// Point clouds, one for each frame that was recorded from its beginning; points by row. not_found, bad_input
/// (no packets of a sensor with this metadata in it). With `image` images or range images in place of points;
/// bad_input: the packets do not have its field.
[[nodiscard]] Result<RecordingInput> read_ouster_recording(
    const std::filesystem::path& file, const std::filesystem::path& metadata, const TakeSample& take,
    const std::optional<ouster::ImageOptions>& image = {});

/// By the file's name: .json.
[[nodiscard]] bool is_sick_recording(const std::filesystem::path& file);
/// Point clouds, one for each scan; remission is the RSSI as sent. not_found, bad_input (no scans in it).
[[nodiscard]] Result<RecordingInput> read_sick_recording(const std::filesystem::path& file,
                                                         const TakeSample& take);

}  // namespace rigor
