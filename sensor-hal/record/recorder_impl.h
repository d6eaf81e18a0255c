// Inside of the recorder: what the loop (recorder.cpp) and the writer's thread (recorder_writer.cpp) share,
// and what belongs to one of them. recorder_topics.cpp sets both up.
#pragma once

#include <semaphore.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <ctime>
#include <limits>
#include <mutex>
#include <queue>
#include <thread>
#include <tuple>

#include "rt-core/spsc_ring.h"
#include "rt-core/stage_time.h"
#include "sensor-hal/channel/fault_injector.h"
#include "sensor-hal/record/recorder.h"
#include "sensor-hal/record/sample_codec.h"

namespace rigor {

struct Recorder::Impl {
  /// One entry of the ring to the writer.
  struct Item {
    enum class Kind : std::uint8_t {
      none,
      begin,
      sample,
      copy,
      visibility,
      skipped,
      command,
      event,
      fault,
      window,
      end_cycle
    } kind = Kind::none;
    PortStatus status = PortStatus::never;
    PairSide side = PairSide::real;
    bool has_sample = false;
    std::uint32_t channel = 0;
    std::uint64_t cycle = 0;  // visibility, skipped, end_cycle
    BenchTime t;              // begin: t0
    SampleLease lease;        // sample, copy, event
    Stamp stamp;              // visibility: of the visible sample; skipped: sequence is the count
    Command command;
    FaultChange change;
  };

  /// One stream of samples: a channel, or one side of a pair.
  struct Stream {
    std::string name;  // "left", "left/real"
    std::unique_ptr<record::SampleEncoder> encoder;
    std::vector<std::uint16_t> ids;  // MCAP channels of the encoder's streams
    std::optional<record::msg::CameraInfo> camera;
    std::uint16_t camera_id = 0;
    std::size_t lease_budget = 0;
    std::atomic<std::uint32_t> leases{0};  // counted up by the loop, down by the writer
    std::atomic<std::uint64_t> dropped{0}, written{0};
  };
  struct Waiting {
    BenchTime release;
    std::uint32_t stream = 0;
    std::uint64_t sequence = 0;
    bool copy = false;
    SampleLease lease;
    bool operator<(const Waiting& o) const {  // the earliest on top
      return std::tie(o.release, o.stream, o.sequence) < std::tie(release, stream, sequence);
    }
  };
  class SideObserver final : public PairObserver {
   public:
    void on_side_sample(PairSide side, const SampleLease& sample) noexcept override {
      recorder->record_side(channel, side, sample);
    }
    void on_window(const SampleLease& window) noexcept override { recorder->record_window(channel, window); }
    Recorder* recorder = nullptr;
    std::uint32_t channel = 0;
  };

  /// One entry of the ring of motions.
  struct MotionAt {
    BenchTime t;
    WorldMotion motion;
  };

  /// Of a pair: where the newest sample of each side lies, and from which side the visible one is. The sides
  /// have pools of their own, so an address belongs to one side for ever.
  struct Sides {
    std::array<const Sample*, 2> newest{};
    PairSide shown = PairSide::real;
  };

  RecorderOptions options;
  std::vector<RecordedChannel> channels;
  std::vector<RecordedSink> sinks;
  Duration to_utc;

  // Loop to writer.
  std::optional<SpscRing<Item>> ring;
  SpscRing<MotionAt> motions{256};
  bool want_motion = false;  // constant from open() on
  BenchTime next_motion;     // loop thread
  BenchTime first_motion;    // loop thread: of the grid
  std::unique_ptr<SamplePool> copies;
  std::atomic<std::uint32_t> copies_held{0};
  std::atomic<std::uint64_t> bytes_held{0};
  std::vector<std::unique_ptr<Stream>> streams;  // channel·2 + side
  std::vector<SideObserver> observers;
  std::vector<Sides> sides;  // loop thread
  std::atomic<std::uint64_t> other_dropped{0};
  std::atomic<bool> failed{false};
  std::atomic<bool> stopping{false};
  bool stopped = false;
  sem_t wake{}, done{};

  // Writer.
  std::thread thread;
  std::map<std::string, std::string> metadata, closing_metadata;
  std::map<std::string, std::uint16_t, std::less<>> schemas;
  std::unique_ptr<record::MessageWriter> writer;
  record::CdrWriter cdr;
  std::priority_queue<Waiting> waiting;
  std::vector<Item> of_cycle;
  std::uint16_t tf_id = 0, clock_id = 0;  // 0: there is none
  std::uint32_t motion_count = 0;
  record::msg::TFMessage transforms;
  BenchTime t0;  // of the run
  std::uint16_t visibility_id = 0, events_id = 0, commands_id = 0, faults_id = 0, diagnostics_id = 0;
  std::uint64_t last_log_ns = 0;
  std::uint32_t visibility_count = 0, event_count = 0, fault_count = 0, window_count = 0;
  std::uint64_t noted_drops = 0;
  BenchTime noted_at{std::numeric_limits<std::int64_t>::min()};
  bool begun = false, any_cycle = false;
  BenchTime last_t;
  std::uint64_t cycles = 0;  // one more than the last that was ended
  record::msg::PortVisibility visibility;

  mutable std::mutex error_mutex;
  std::optional<Error> error;
  std::atomic<std::uint64_t> samples_written{0}, messages{0}, bytes{0}, chunks{0}, after_end{0};
  std::atomic<std::int64_t> cpu_ns{0};

  Impl() {
    sem_init(&wake, 0, 0);
    sem_init(&done, 0, 0);
  }
  ~Impl() {
    sem_destroy(&wake);
    sem_destroy(&done);
  }

  static void nap(std::int64_t ns) {
    const timespec t{0, ns};
    nanosleep(&t, nullptr);
  }
  /// At most `most_ns`.
  static void wait_on(sem_t& s, std::int64_t most_ns) {
    timespec until{};
    clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_nsec += most_ns;
    until.tv_sec += until.tv_nsec / 1'000'000'000;
    until.tv_nsec %= 1'000'000'000;
    (void)sem_clockwait(&s, CLOCK_MONOTONIC, &until);
  }
  static void wait_on(sem_t& s) {
    while (sem_wait(&s) != 0 && errno == EINTR) {
    }
  }

  // ---- setup ----
  Status open(std::unique_ptr<record::MessageWriter> to);

  // ---- loop ----
  bool push(Item&& item) noexcept;
  void sample(std::uint32_t stream, const SampleLease& lease) noexcept;
  void drop(Stream& s) noexcept {
    s.dropped.fetch_add(1, std::memory_order_relaxed);
    if (options.fail_on_drop) {
      // The text is made by error(): this is the loop.
      failed.store(true, std::memory_order_release);
    }
  }

  // ---- writer ----
  Status write_beginning(BenchTime t0);
  Status add_topics();
  Result<std::uint16_t> add_topic(const std::string& topic, std::string_view type, const char* qos = "");
  Status add_frames();
  Status add_motion_topics();
  void write_motions(BenchTime until);
  void work();
  void take(Item&& item);
  void end_cycle(const Item& tick);
  void write_released(BenchTime t);
  void write_sample(Waiting&& w);
  void let_go(const Waiting& w);
  void write_visibility();
  void note_drops(BenchTime t);
  void finish();
  std::uint64_t log_time(BenchTime t) {
    const std::int64_t ns = t.ns() + to_utc.ns();
    return last_log_ns = std::max(last_log_ns, ns < 0 ? std::uint64_t{0} : static_cast<std::uint64_t>(ns));
  }
  template <class M>
  void write(std::uint16_t id, std::uint32_t sequence, BenchTime t, const M& message);
  bool check(const Status& status) {
    if (status) return true;
    set_error(status.error());
    return false;
  }
  void set_error(Error e) {
    {
      const std::lock_guard lock(error_mutex);
      if (!error) error = std::move(e);
    }
    failed.store(true, std::memory_order_release);
  }
  /// Whether the file can still take something: after an error it cannot.
  bool writable() const {
    const std::lock_guard lock(error_mutex);
    return !error;
  }
  std::uint64_t all_dropped() const {
    std::uint64_t n = other_dropped.load(std::memory_order_relaxed);
    for (const auto& s : streams)
      if (s) n += s->dropped.load(std::memory_order_relaxed);
    return n;
  }
  void publish_statistics() {
    const auto& s = writer->statistics();
    messages.store(s.messages, std::memory_order_relaxed);
    bytes.store(s.file_bytes, std::memory_order_relaxed);
    chunks.store(s.chunks, std::memory_order_relaxed);
    cpu_ns.store(StageTime::thread_cpu().ns(), std::memory_order_relaxed);
  }
};

}  // namespace rigor
