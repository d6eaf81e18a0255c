// How long the samples of a channel take from capture to arrival, and the latency_ms of the rig that follows.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "calibration/procedures/latency_samples.h"

namespace rigor {

struct LatencyCalibrationOptions {
  std::vector<std::filesystem::path> inputs;  ///< recordings (.mcap) of runs in wall-clock time, or folders
  std::vector<std::string> channels;          ///< empty: all of them
  calibration::LatencyOptions fit;            ///< quantile and confidence
  /// For devices without a clock: a channel whose every sample triggers one, or `SINK:VALUE`, which does so
  /// when it leaves 0. Empty: the capture is as stamped.
  std::string trigger;
  double trigger_to_capture_ms = 0;  ///< half of an exposure
};

struct ChannelLatency {
  std::string channel;      ///< `left`; of a pair `left/real`, `left/simulated`
  std::string rig_channel;  ///< `left`
  LatencySamples from;
  calibration::LatencyFit fit;
  std::int64_t sigma_ns = 0;               ///< of the capture, the median
  std::optional<std::int64_t> present_ns;  ///< latency_ms of the rig; none: the rigs of the recordings differ
  std::int64_t put_ns = 0;                 ///< the latency to put into the rig
  bool by_median = false;     ///< the driver stamps the arrival less latency_ms: the typical latency counts
  std::size_t late_then = 0;  ///< samples that would arrive after their release with it
  std::int64_t after_trigger_ns = 0;  ///< capture as stamped less that by the trigger, the median
  std::vector<std::string> warnings;
  /// The simulated side of a pair: its latency_ms is that of the device.
  [[nodiscard]] bool simulated_side() const { return channel == rig_channel + "/simulated"; }
  /// Of the rig: `channels.left.latency_ms`.
  [[nodiscard]] std::string key() const { return "channels." + rig_channel + ".latency_ms"; }
  /// For `--set`: `channels.left.latency_ms=12.3`.
  [[nodiscard]] std::string rig_override() const;
};

struct LatencyCalibration {
  std::vector<std::filesystem::path> inputs;  ///< the files
  std::string rig_file;                       ///< of the first recording; empty: it does not say
  std::vector<ChannelLatency> channels;
  std::vector<Error> unknown;         ///< channels that cannot be measured, by `where`, and why
  std::vector<std::string> warnings;  ///< of the recordings and the channels
  bool interrupted = false;           ///< of what was read until then
  /// Those whose latency goes into the rig: of a pair the device's, unless the other side alone was asked
  /// for.
  [[nodiscard]] std::vector<const ChannelLatency*> for_rig() const;
};

/// Any thread; allocates 40 bytes a sample; shows progress on stderr unless that is switched off. Errors:
/// not_found; bad_input: a quantile or confidence of 1 or more, no such channel (those that there are are
/// listed), a channel that was asked for and cannot be measured, or none that can, a run in virtual time;
/// protocol (a damaged recording).
[[nodiscard]] Result<LatencyCalibration> calibrate_latency(const LatencyCalibrationOptions& options,
                                                           const StopToken& stop = {});

}  // namespace rigor
