// Samples of one simulated channel of a rig, without a run: what `rigor sense` takes.
//
//   auto probe = SensorProbe::open(*load_rig("rig.yaml", {}), {.channel = "right", .truth = true});
//   const auto capture = (*probe)->capture(2.0);
//   capture->sample.as<ImageInfo>(); capture->truth.range_m;
//
// The sample is that of a virtual run at that instant, if the world stood as it does at the start (joints as
// given): same index, same draws. One thread at a time; the world stays open between captures.
#pragma once

#include <array>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/rig/rig.h"
#include "sensor-hal/types/sample.h"
#include "sim/sensors/measurement.h"

namespace rigor {

struct SensorProbeOptions {
  std::string channel;
  std::vector<std::pair<std::string, double>> joints_deg;  ///< by name; others stand at 0
  bool ideal = false;                                      ///< without the sensor's errors
  std::vector<std::string> only;                           ///< of its effects these alone; empty: all
  std::string renderer;                                    ///< rays or raster; empty: as the rig says
  /// Ground truth comes along. A camera of the renderer `scene`, which knows none, gets that of the same
  /// picture by rays.
  bool truth = false;
};

struct Capture {
  Sample sample;                                 ///< its t_capture is set; release and arrival are not
  std::uint64_t index = 0;                       ///< of the capture, which keys the noise
  GroundTruth truth;                             ///< empty where none was asked for
  std::vector<std::array<float, 3>> directions;  ///< of a range image: each pixel's ray in the sensor's frame
};

class SensorProbe {
 public:
  /// Reads the world. bad_input: the rig has no such simulated channel or no world; an unknown joint or
  /// effect; truth or effects of a sensor that does not look. not_found, unavailable. Setup context.
  [[nodiscard]] static Result<std::unique_ptr<SensorProbe>> open(RigConfig rig, SensorProbeOptions options);
  ~SensorProbe();
  /// Kind of the channel: what `open` refuses of rig and options without the world.
  [[nodiscard]] static Result<SampleKind> kind_of(const RigConfig& rig, const SensorProbeOptions& options);

  /// The sample whose capture is the last at or before `at_s` since the start. bad_input: not from 0 to a
  /// year. Setup context; allocates, may take seconds.
  [[nodiscard]] Result<Capture> capture(double at_s);

  [[nodiscard]] SampleKind kind() const;
  [[nodiscard]] const RigConfig& rig() const;
  /// Which renderer measures, for people; empty before the first capture and where none does.
  [[nodiscard]] std::string renderer() const;

 private:
  struct Impl;
  explicit SensorProbe(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor
