// A recording as a channel: the same samples at the same places, in the cycles in which they were seen.
//
//   Recording rec = Recording::open("run.mcap")           once for all channels
//   source = ReplaySource(rec, "left")                    samples, read ahead by a thread
//   script = rec.visibility("left")                       what port `left` showed in each cycle
//   loop:  while (sample = source.poll(now)) port.push(sample);
//          port.obey(script.at(cycle).status, .sequence, now)
//
// Where the recording has visibility, the source gives the samples that were seen, of a pair from the side
// that was handed on then; without it (a file from elsewhere) all samples of the topic, at their release.
// Times are shifted so that the recorded first cycle is the replay's: by nothing, if the replay starts at the
// same bench time.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "rt-core/port.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/channel.h"
#include "sensor-hal/channel/registry.h"

namespace rigor {

/// What one port showed, cycle by cycle. Only changes are stored.
class VisibilityScript {
 public:
  struct Visible {
    PortStatus status = PortStatus::never;
    std::uint64_t sequence = 0;  ///< of the visible sample, where there is one
    bool simulated = false;      ///< of a pair: which side was handed on
  };
  struct Change {
    std::uint64_t cycle = 0;
    Visible visible;
  };
  explicit VisibilityScript(std::vector<Change> changes) : changes_(std::move(changes)) {}

  /// Any cycle; quick for increasing ones. Wait-free. One thread. A port that was fresh and about which the
  /// next cycle says nothing is stale there.
  [[nodiscard]] Visible at(std::uint64_t cycle) const noexcept;
  [[nodiscard]] const std::vector<Change>& changes() const noexcept { return changes_; }

 private:
  std::vector<Change> changes_;  // increasing cycle
  mutable std::size_t at_ = 0;
};

/// What a recording says of its run. Setup context; shared by the replay sources that read it.
class Recording {
 public:
  /// not_found, bad_input, protocol. Reads all of `/rigor/visibility`.
  [[nodiscard]] static Result<std::shared_ptr<const Recording>> open(const std::string& path);

  [[nodiscard]] const std::string& path() const noexcept { return path_; }
  /// Of the record `rigor`: rig, seed, clock, …
  [[nodiscard]] const std::map<std::string, std::string>& metadata() const noexcept { return metadata_; }
  /// Null: the recording has none for this port.
  [[nodiscard]] const VisibilityScript* visibility(const std::string& channel) const;
  /// Whether the loop ran this cycle; false for those that it skipped. Any thread.
  [[nodiscard]] bool ran(std::uint64_t cycle) const noexcept;
  /// Bench time of the first cycle, and one more than the last cycle that is known.
  [[nodiscard]] BenchTime t0() const noexcept { return t0_; }
  [[nodiscard]] std::uint64_t cycles() const noexcept { return cycles_; }
  [[nodiscard]] std::vector<std::string> topics() const;

 private:
  friend class ReplaySource;
  struct Skipped {
    std::uint64_t first = 0, count = 0;
  };
  std::string path_;
  std::map<std::string, std::string> metadata_;
  std::map<std::string, VisibilityScript> scripts_;
  std::vector<Skipped> skipped_;               // by first
  std::map<std::string, std::string> topics_;  // topic → message type
  BenchTime t0_;
  std::uint64_t cycles_ = 0;
};

/// Keys: `slots: 32` samples read ahead and in use; of one that is made without a recording also
/// `file: run.mcap`, from the rig's folder, and `channel: left`, its name there (the channel's own).
class ReplaySource final : public Source {
 public:
  /// Opens the file that its keys name when it is configured.
  ReplaySource();
  /// `channel`: the name in the recording; empty: that of the configuration.
  explicit ReplaySource(std::shared_ptr<const Recording> recording, std::string channel = {});
  ~ReplaySource() override;

  [[nodiscard]] SampleLease poll(BenchTime now) noexcept override;
  void complete_until(BenchTime now) override;

 private:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_stop() override;

  struct Reader;
  bool from_keys_ = true;
  std::shared_ptr<const Recording> recording_;
  std::string channel_;
  std::size_t slots_ = 0;
  std::unique_ptr<Reader> reader_;
};

/// `backend: replay`: a channel of an earlier run in place of a device. Serves in virtual time itself.
[[nodiscard]] Backend replay_backend();

}  // namespace rigor
