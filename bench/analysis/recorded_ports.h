// The ports of a recorded run, cycle by cycle, as its application saw them; no device, application or thread
// is needed for that.
//
//   auto ports = RecordedPorts::open(file, rig, run);
//   while (more = ports->next(), more && *more)          // the next cycle that the loop ran
//     for (auto& [port, command] : ports->commands())    // what the application commanded in it
//       …
//
// Statuses are those of `/rigor/visibility`; samples that a newer one overtook in their cycle are counted as
// the run counted them. Of pictures, scans and range images a sample has its stamp alone, and so has a sample
// that was visible and that the recorder had to skip. Memory does not grow with the recording.
#pragma once

#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "bench/run/recording.h"
#include "sensor-hal/channel/application.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

class RecordedPorts {
 public:
  struct Given {
    const CommandPort* port = nullptr;
    Command command;
  };
  /// `rig`: the recorded one, which outlives this object. not_found, bad_input, protocol. Setup context, as
  /// all that follows.
  [[nodiscard]] static Result<std::unique_ptr<RecordedPorts>> open(const std::filesystem::path& file,
                                                                   const RigConfig& rig,
                                                                   const RecordedRun& run);
  ~RecordedPorts();

  /// What an application of the run would be given; channels that were not recorded are not among it.
  [[nodiscard]] const ApplicationPorts& ports() const;
  /// False: the recording has no cycle more. protocol, io.
  [[nodiscard]] Result<bool> next();
  [[nodiscard]] BenchTime now() const;
  [[nodiscard]] std::span<const Given> commands() const;
  /// So far: cycles that the loop ran, and that it skipped; samples that were visible and are not recorded.
  [[nodiscard]] std::uint64_t cycles() const;
  [[nodiscard]] std::uint64_t skipped() const;
  [[nodiscard]] std::uint64_t missing_samples() const;

 private:
  struct Impl;
  explicit RecordedPorts(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor
