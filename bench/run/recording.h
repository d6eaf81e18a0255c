// The recording of a run, between the rig's channels and the recorder.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "bench/files/output_file.h"
#include "bench/run/bench_run.h"
#include "rt-core/epoch.h"
#include "sensor-hal/channel/registry.h"
#include "sensor-hal/record/recorder.h"

namespace rigor {

/// The file of a run's recording: this run's alone (a lock that other runs see), under its own name from the
/// first byte on, so that it is found when power goes. What had the name before is renamed (Existing::keep)
/// or replaced at the moment when the new file takes the name. Setup context.
class RecordingFile {
 public:
  /// not_writable: also where another run is writing it. disk_full, io.
  [[nodiscard]] static Result<RecordingFile> create(const std::filesystem::path& file, Existing existing);
  RecordingFile(RecordingFile&& o) noexcept;
  RecordingFile& operator=(RecordingFile&& o) noexcept;
  ~RecordingFile();

  /// To write it from its beginning; the sink may outlive this object, the lock does not.
  [[nodiscard]] Result<std::unique_ptr<record::ByteSink>> sink(const record::FileSinkOptions& options) const;
  /// Nothing came of the run: removes it, and gives an earlier one its name back.
  void abandon();

 private:
  RecordingFile() = default;
  [[nodiscard]] Status take_name(const std::filesystem::path& part, Existing existing);

  std::filesystem::path file_, target_, kept_;
  int fd_ = -1;
  bool device_ = false;  ///< /dev/null and its like
};

/// The lens of a simulated channel (of a pair: of its simulated side), as ROS has it; empty where the rig
/// names no sensor. Of the cameras that `frames.stereo` names together R and P are those of the rectified
/// pair, where the frames say how the one sits in the other.
[[nodiscard]] std::optional<record::msg::CameraInfo> camera_info(const RunParts& parts,
                                                                 const ChannelEntry& entry);

/// The channels as recordings and the live view tell of them, in the order of `parts.channels`. Setup
/// context, after the channels are configured.
[[nodiscard]] Result<std::vector<RecordedChannel>> recorded_channels(const RunParts& parts);
/// What `/tf_static` and `/tf` say of this run, or of the recording that is replayed; null: nothing. Each
/// caller has one of its own. Errors: those of record::recorded_frames.
[[nodiscard]] Result<std::unique_ptr<record::FrameSource>> frame_source(const RunParts& parts,
                                                                        const EpochPair& epoch);

/// A recorder that writes to `file`, and waits for Recorder::begin. Channels are named to it in the order of
/// `parts.channels`. `metadata`: what is known of the run beyond its rig. Setup context, after the channels
/// are configured.
[[nodiscard]] Result<std::unique_ptr<Recorder>> open_recording(RunParts& parts, const RecordingFile& file,
                                                               const EpochPair& epoch,
                                                               std::map<std::string, std::string> metadata);

/// A file that an option names; empty: none.
struct NamedOutput {
  std::filesystem::path file;
  const char* option;
};

/// Before the run: that recording, report, trace, logs and what the application writes can be written and are
/// none of its inputs. Errors of Outputs::add. A replay writes no logs.
[[nodiscard]] Status check_run_outputs(const RigConfig& rig, const Registry& registry,
                                       const std::vector<NamedOutput>& more, InputFiles inputs,
                                       Existing existing, bool replay = false);

/// What devices and applications of the rig write themselves, as the registry says: logs of buses (a replay
/// writes none), files of an application. Just before they do: makes the folders, and keeps what is there.
[[nodiscard]] Status prepare_outputs(const RigConfig& rig, const Registry& registry, Existing existing,
                                     bool replay = false);

/// Where a recording has the digest of what the application saw. Recordings of earlier versions have another
/// digest under another name: nothing is compared with it.
inline constexpr const char* kInputDigestKey = "input_sha256";

/// What a recording says of the run that made it.
struct RecordedRun {
  std::string rig_text, rig_file;
  BenchTime t0;
  EpochPair epoch;
  std::uint64_t cycles = 0;   ///< grid points of the run
  std::string input_sha256;   ///< as printed by the run, where it could be
  std::uint64_t dropped = 0;  ///< samples that the recorder had to skip
};
[[nodiscard]] std::map<std::string, std::string> run_metadata(const RunParts& parts, const EpochPair& epoch);
/// From the file's metadata; bad_input where it is not a recording of a run.
[[nodiscard]] Result<RecordedRun> read_recorded_run(const std::filesystem::path& file);
/// The rig of the run, by the name of its file, so that what it names by relative paths is found. bad_input.
[[nodiscard]] Result<RigConfig> recorded_rig(const RecordedRun& run, const std::filesystem::path& recording,
                                             const std::vector<ConfigOverride>& overrides = {});

}  // namespace rigor
