// The samples of a run as messages: the topics that a recording has, encoded only where somebody listens.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "bench/live/estimate.h"
#include "bench/live/hub.h"
#include "bench/run/bench_run.h"
#include "bench/run/tap.h"
#include "rt-core/epoch.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor::live {

/// What the tap must have for these channels. Setup context, after they are armed.
[[nodiscard]] std::vector<LiveTap::StreamSpec> stream_specs(const RunParts& parts);

/// Setup context constructs, the server's thread calls. `parts` is only read while it is made.
class LiveChannels {
 public:
  static constexpr std::uint32_t kSmallWidth_px = 320;
  static constexpr Duration kTick = milliseconds(40);
  /// Pictures and clouds of more bytes than this are taken every second tick.
  static constexpr std::size_t kLarge = 256u << 10;
  /// Numbers are taken every so many ticks where nobody listens, for those who come later.
  static constexpr std::uint64_t kUnheardTicks = 5;

  /// A recording that is replayed gives its frames; where they cannot be read, there are none.
  LiveChannels(const RunParts& parts, const EpochPair& epoch);
  /// Adds the channels to the hub.
  void add_to(Hub& hub);
  /// Each tick: encodes and publishes what came of what is wanted, asks for the next. `estimate` (may be
  /// null) is told what came of the truth and of what was commanded.
  void pump(Hub& hub, LiveTap& tap, LiveEstimate* estimate);
  [[nodiscard]] std::uint64_t utc_ns(BenchTime t) const;

 private:
  struct Stream {
    bool used = false;
    SampleKind kind = SampleKind::none;
    std::size_t max_bytes = 0;
    std::string topic, camera_topic, frame_id;
    std::unique_ptr<record::SampleEncoder> encoder;
    std::vector<std::uint32_t> ids;  ///< of the encoder's streams
    std::optional<record::msg::CameraInfo> camera;
    std::uint32_t small_id = 0, camera_id = 0;  ///< 0: none
    std::uint64_t next_tick = 0;
    bool kept = false;  ///< numbers
  };
  [[nodiscard]] static bool listened(const Hub& hub, const Stream& s);
  void publish(Hub& hub, Stream& s, const Sample& sample);
  void publish_events(Hub& hub, LiveTap& tap, LiveEstimate* estimate);
  void publish_frames(Hub& hub, LiveTap& tap);
  template <class M>
  void publish_message(Hub& hub, std::uint32_t id, BenchTime t, const M& message);
  [[nodiscard]] record::msg::Header header(BenchTime t, const std::string& frame_id) const;

  EpochPair epoch_;
  std::vector<Stream> streams_;  // 2·channel + side
  std::vector<std::string> channel_names_, sink_names_;
  std::vector<std::vector<std::string>> value_names_;  // of the sinks
  std::uint32_t events_id_ = 0, faults_id_ = 0, commands_id_ = 0;
  std::unique_ptr<record::FrameSource> frames_;  ///< null: there are none
  bool virtual_time_ = false, clock_ = false;
  bool fixed_told_ = false;
  std::uint32_t tf_static_id_ = 0, tf_id_ = 0, clock_id_ = 0;  ///< 0: none
  std::uint64_t motion_count_ = 0;
  BenchTime clock_told_ = BenchTime::never();
  record::msg::TFMessage transforms_;
  std::uint64_t tick_ = 0;
  record::CdrWriter cdr_;
};

}  // namespace rigor::live
