// Parts of a run's report (result/run_report.h): which run it was, and what came of one channel, sink, pair
// or fault. Plain values: they outlive the run and its devices.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bench/run/run_outcome.h"
#include "rt-core/histogram.h"
#include "sensor-hal/channel/bridge.h"
#include "sensor-hal/channel/channel.h"

namespace rigor {

struct PairWatchReport;

/// Which run it was.
struct RunIdentity {
  std::string rig;             ///< its name
  std::filesystem::path file;  ///< of the rig
  bool wall_clock = true;
  std::uint64_t seed = 0;
  std::string version;         ///< of Rigor
  std::string utc;             ///< of the start, ISO 8601
  bool virtual_epoch = false;  ///< that is where all virtual runs begin, and not when this one was
  std::string renderer;        ///< empty: nothing was rendered
  std::string command;         ///< as typed, without secrets
  std::string machine;         ///< name, processor, kernel
  Duration spin;               ///< of the loop, before each cycle
  std::string application;     ///< empty: none
};

/// Where the samples of a source with faults went: taken = handed_on + dropped + disconnected + no_slot +
/// waiting.
struct FaultyReport {
  std::string name;  ///< of the channel; of a pair's side `left.real`
  std::uint64_t taken = 0, handed_on = 0, dropped = 0, disconnected = 0, no_slot = 0, waiting = 0;
  HealthSnapshot inner;  ///< of the source behind the faults
};

/// One number of a pair: real − simulated.
struct ValueDifference {
  std::string name, unit;
  double bias = 0, sigma = 0;
};

/// The real side of a pair against the simulated one.
struct PairReport {
  std::uint64_t compared = 0;
  std::uint64_t unlike = 0;   ///< of one instant, and not comparable
  std::uint64_t skipped = 0;  ///< not compared, the worker was behind
  std::uint64_t switches = 0;
  std::string active;  ///< the side that was handed on last: real or simulated
  std::uint64_t real_missing = 0, simulated_missing = 0;
  double bias = 0, sigma = 0;  ///< of all elements, in `unit`; they mean nothing where nothing was compared
  std::string unit;
  std::vector<ValueDifference> values;           ///< number by number; empty for pictures and clouds
  std::vector<DifferenceAt> series;              ///< over the run
  std::shared_ptr<const PairWatchReport> watch;  ///< null: the pair was not watched
};

struct ChannelReport {
  std::string name;
  SampleKind kind = SampleKind::none;
  std::string backend;      ///< of a pair both, `aravis | simulated`
  std::string replaced_by;  ///< virtual time: what stood in for the device; empty: nothing did
  Period period;            ///< nominal; 0: aperiodic
  Duration latency;
  PortCounters port;               ///< as the loop counted
  HealthSnapshot health;           ///< of its source
  std::uint64_t taken = 0;         ///< samples that the loop took from the source
  std::uint64_t before_start = 0;  ///< of these: captured before the run, and not shown
  Histogram age;                   ///< t_cycle − t_capture when a sample became visible
  Histogram arrival;               ///< t_arrival − t_capture
  std::uint64_t gap_count = 0;
  std::vector<Gap> gaps;           ///< the first of them
  std::vector<StatusSpan> status;  ///< the first changes
  std::vector<FaultyReport> faulty;
  std::optional<PairReport> pair;
  struct Picture {
    std::string file, caption;
  };
  std::vector<Picture> pictures;  ///< in the HTML report

  /// Taken and not yet due when the run ended.
  [[nodiscard]] std::uint64_t not_due_at_end() const {
    return taken - before_start - port.fresh - port.superseded - port.overflow;
  }
};

/// What one fault did.
struct FaultReport {
  std::uint32_t index = 0;  ///< in its channel
  std::string kind, text;   ///< text: as people read it
  std::string json;         ///< all its keys, as rigs have them
  bool live = false;        ///< injected while the run went on
  bool on = false, over = false;
  std::uint64_t times = 0;                                        ///< that it began
  std::uint64_t seen = 0, dropped = 0, changed = 0, delayed = 0;  ///< samples
  struct Span {
    double from_s = 0, until_s = 0;
  };
  std::vector<Span> spans;  ///< when it was on, since the start of the run
};

/// The faults of a channel or sink.
struct ChannelFaultReport {
  std::string channel;
  std::vector<FaultReport> faults;
  struct Earlier {
    std::uint64_t faults = 0, times = 0, seen = 0, dropped = 0, changed = 0, delayed = 0;
  };
  std::optional<Earlier> earlier;      ///< live ones that are no longer listed, all together
  std::optional<FaultyReport> source;  ///< where its samples went; none: a sink
};

struct SinkReport {
  std::string name, backend, replaced_by;
  SinkSnapshot commands;
};

/// Where the time of a simulated sensor went.
struct SensorTimeReport {
  std::string channel;
  std::uint64_t captures = 0;
  double wall_s = 0, world_s = 0, collect_s = 0, prepare_s = 0, light_s = 0, cpu_s = 0, longest_ms = 0;
};

/// What became of the messages and commands of a bridge. A sample that the loop gave it was dropped before it
/// was encoded, came after the last cycle, or became messages, each of which the transport accepted or
/// dropped.
struct RunBridgeReport {
  std::string name;
  BridgeReport traffic;
  std::uint64_t samples = 0;    ///< encoded
  std::uint64_t dropped = 0;    ///< samples and other entries that were not: the bridge was behind
  std::uint64_t after_end = 0;  ///< samples whose release came after the last cycle
  struct OfChannel {
    std::string name;
    std::uint64_t samples = 0, dropped = 0;
  };
  std::vector<OfChannel> channels;
  double cpu_s = 0;  ///< of the thread that encodes and sends

  [[nodiscard]] std::uint64_t messages() const;
  [[nodiscard]] std::uint64_t messages_dropped() const;
};

struct RecordingReport {
  std::string file;
  std::uint64_t messages = 0, bytes = 0, chunks = 0, samples = 0, dropped = 0, after_end = 0;
  double cpu_s = 0;  ///< of the thread that writes
};

}  // namespace rigor
