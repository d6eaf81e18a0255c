// The recorder: everything a run saw, written off the loop.
//
//   loop                                            writer thread
//   begin(t0)              ──ring──▶                writes the metadata, and which topics there are
//   record(left, lease)       ──ring──▶             waits for the sample's release
//   record_visibility(...)                          …
//   end_cycle(k, t)                                 writes what was released by t, ordered by
//                                                   (release, channel, sequence), then what happened in k
//
// The loop hands leases over and goes on; nothing here can stop it. What the recorder may hold is limited, so
// that it cannot take all slots of a channel: `lease_budget` pictures of each channel and `budget_bytes` in
// all; samples of up to kCopyBytes are copied into memory of the recorder's own. What does not fit is
// skipped, counted, and noted in the file. In virtual time nothing is skipped: the calls wait, and end_cycle
// returns when the writer is through with the cycle, so that which slots are free never depends on the speed
// of a disk.
//
// Log time is UTC of the release (of the cycle, for events and commands), and never decreases: a sample that
// came late, after others with a later release were written, gets the log time of the last one. Its own times
// are in its stamp. Samples whose release comes after the last cycle are not written: nobody saw them.
//
// Topics: `/NAME/image` with `/NAME/image/settings`, `/NAME/image/stamp`, `/NAME/camera_info`;
// `/NAME/registers` and so on by kind; the sides of a pair `/NAME/real/…` and `/NAME/simulated/…`.
// `/rigor/visibility` says what the application saw: entries name a port, and for a pair the side that was
// handed on ("left/real"); all ports are listed in the first cycle, then those that changed; an entry without
// a name says that `sequence` cycles, this one the first, were skipped by the loop.
// `/tf_static` is the first message, `/tf` and in virtual time `/clock` come on a grid of their own
// (RecorderOptions::frames, frames_period), in front of the samples of their cycle.
// `/rigor/events`, `/rigor/faults`, `/rigor/commands`. Where a pair is watched, `/diagnostics` has a status
// for each of its windows (pair_diagnostics.h).
#pragma once

#include <atomic>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/epoch.h"
#include "rt-core/port.h"
#include "rt-core/result.h"
#include "sensor-hal/channel/channel.h"
#include "sensor-hal/channel/pair_source.h"
#include "sensor-hal/channel/pair_watch/window_fit.h"
#include "sensor-hal/record/frame_tree.h"
#include "sensor-hal/record/mcap_writer.h"
#include "sensor-hal/record/ros2_messages.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor {

struct FaultChange;

struct RecordedChannel {
  std::string name;
  ChannelDescription description;
  bool is_pair = false;
  /// Of an image channel: goes to `/NAME/camera_info` with each image (header and offsets are filled in).
  std::optional<record::msg::CameraInfo> camera = std::nullopt;
  /// Samples of this channel (of each side) held at a time, where they are not copied.
  std::size_t lease_budget = 6;
  /// False: its samples are not written, and have no topics.
  bool wanted = true;
  /// Of a pair that is watched: what its windows tell of, in their order.
  std::vector<pair_watch::Parameter> watched{};
  /// Of a channel of point clouds: how points lie in the messages.
  PointLayout points = PointLayout::rigor;
  /// Of a 2D scanner: its sweeps go to `/NAME/scan`, too. Of the real side of a pair, or the channel's own;
  /// of the simulated side.
  std::optional<record::ScanLine> scan = std::nullopt, simulated_scan = std::nullopt;
};

/// How the samples of a channel, or of one side of a pair, become messages: topic, frame, layout of points.
[[nodiscard]] record::SampleChannel sample_channel(const RecordedChannel& channel, PairSide side,
                                                   Duration to_utc, const std::string& root_frame);

struct RecordedSink {
  std::string name;
  std::vector<std::string> value_names;
};

struct RecorderOptions {
  bool virtual_time = false;
  /// Others read while it is written: topics are there before the run begins, and the writer's thread is
  /// woken in each cycle. False: topics come with the run, and the thread looks every 2 ms.
  bool live = false;
  bool fail_on_drop = false;   ///< a skipped sample makes failed() true
  std::size_t places = 16384;  ///< of the ring to the writer
  std::size_t budget_bytes = 256u << 20;
  EpochPair epoch = kVirtualEpoch;
  Period loop_period = milliseconds(1);  ///< goes into the metadata with t0, replay needs them
  /// `/tf_static` and `/tf`; null: neither. Asked by the writer's thread alone.
  std::shared_ptr<record::FrameSource> frames{};
  std::string root_frame = "world";         ///< in which poses are
  bool clock = false;                       ///< `/clock`
  Period frames_period = milliseconds(10);  ///< of `/tf` and `/clock`
  record::WriterOptions writer;
  record::FileSinkOptions file;
};

/// One run's recording. `create` and `stop`: setup thread. begin, record*, end_cycle: loop thread, noexcept,
/// wait-free, without allocation (in virtual time they may wait). The rest: any thread.
class Recorder {
 public:
  static constexpr std::size_t kCopyBytes = 256;

  /// `metadata`: what the run was: rig text, seed, model hashes, engines, clock, epoch, version. Samples,
  /// events and commands name channels and sinks by their place in these lists. Errors: not_writable,
  /// bad_input (two with one name).
  [[nodiscard]] static Result<std::unique_ptr<Recorder>> create(const std::string& path,
                                                                RecorderOptions options,
                                                                std::vector<RecordedChannel> channels,
                                                                std::vector<RecordedSink> sinks,
                                                                std::map<std::string, std::string> metadata);
  /// The same into any sink of bytes.
  [[nodiscard]] static Result<std::unique_ptr<Recorder>> create(std::unique_ptr<record::ByteSink> sink,
                                                                RecorderOptions options,
                                                                std::vector<RecordedChannel> channels,
                                                                std::vector<RecordedSink> sinks,
                                                                std::map<std::string, std::string> metadata);
  /// The same into any writer of messages.
  [[nodiscard]] static Result<std::unique_ptr<Recorder>> create(std::unique_ptr<record::MessageWriter> writer,
                                                                RecorderOptions options,
                                                                std::vector<RecordedChannel> channels,
                                                                std::vector<RecordedSink> sinks,
                                                                std::map<std::string, std::string> metadata);
  /// Stops if stop() was not called; an error is then lost.
  ~Recorder();
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  /// Once, before anything is recorded: the run begins at t0. Until then the file has only its header.
  void begin(BenchTime t0) noexcept;
  /// A sample of a channel that is no pair, in the order of its sequence; it may come before its release.
  void record(std::uint32_t channel, const SampleLease& sample) noexcept;
  void record_side(std::uint32_t channel, PairSide side, const SampleLease& sample) noexcept;
  /// For PairSource::observe: calls record_side.
  [[nodiscard]] PairObserver* observer(std::uint32_t channel) noexcept;
  /// What port `channel` showed from this cycle on: call it in the first cycle and when that has changed,
  /// before end_cycle. `sample`: the visible one, or empty. Which side of a pair it is from is known by what
  /// was recorded.
  void record_visibility(std::uint32_t channel, std::uint64_t cycle, BenchTime t, PortStatus status,
                         const SampleLease& sample) noexcept;
  /// The loop did not run `count` cycles, of which `first` is the first.
  void record_skipped(std::uint64_t first, std::uint64_t count, BenchTime t) noexcept;
  void record_command(std::uint32_t sink, const Command& command) noexcept;
  /// A sample of kind event that concerns a channel; beyond the last one: none, the text says what.
  void record_event(std::uint32_t channel, const SampleLease& event) noexcept;
  /// A fault began or ended; goes to /rigor/faults.
  void record_fault(const FaultChange& change) noexcept;
  /// A window of a pair that is watched, as PairObserver::on_window gives it; goes to /diagnostics.
  void record_window(std::uint32_t channel, const SampleLease& window) noexcept;
  /// Whether `/tf` or `/clock` are due in the cycle at `t`: record_motion() is then called in this cycle.
  [[nodiscard]] bool motion_due(BenchTime t) const noexcept;
  /// How the moving parts stand at `t`, as the bench knows it in this cycle.
  void record_motion(const WorldMotion& motion, BenchTime t) noexcept;
  /// Once a cycle, last.
  void end_cycle(std::uint64_t cycle, BenchTime t) noexcept;

  /// The recording cannot be completed: disk full, an error of the medium, or a skipped sample where that
  /// counts as one. What was written before stays readable.
  [[nodiscard]] bool failed() const noexcept { return failed_.load(std::memory_order_acquire); }
  [[nodiscard]] Error error() const;
  /// Setup, after the loop has ended and before stop: goes into the closing metadata record `rigor_recorder`.
  void add_closing_metadata(std::map<std::string, std::string> values);
  /// Writes the rest and closes the file. The first error of the run, if there was one. After the loop has
  /// ended.
  [[nodiscard]] Status stop();

  struct Statistics {
    std::uint64_t messages = 0, bytes = 0, chunks = 0;
    std::uint64_t samples = 0;  ///< written
    std::uint64_t dropped = 0;  ///< samples and other entries that were skipped or could not be written
    std::vector<std::uint64_t> dropped_by_channel;
    std::vector<std::uint64_t> samples_by_channel;  ///< written
    std::uint64_t after_end = 0;                    ///< samples whose release came after the last cycle
    double cpu_s = 0;                               ///< of the thread that encodes, compresses and writes
  };
  [[nodiscard]] Statistics statistics() const;

 private:
  struct Impl;
  explicit Recorder(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
  std::atomic<bool>& failed_;
};

/// The word in `/rigor/events` for an EventInfo::code.
[[nodiscard]] std::string_view event_kind(std::uint32_t code) noexcept;

/// What `/rigor/visibility` says in place of a status for cycles that the loop skipped.
inline constexpr std::uint8_t kVisibilitySkipped = 255;

}  // namespace rigor
