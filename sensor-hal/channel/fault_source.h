// A source with faults: stands in front of any other (a device, a simulator, a recording, a side of a pair)
// and does to its samples what `faults` in its keys says, and what is asked for while a run goes on. The
// kinds and their keys: fault_spec.h.
//
//   inner ──poll──▶ [ lost? ] ─▶ [ stuck, values, bytes: a copy is changed ] ─▶ [ stamp ] ─▶ [ held back ]
//   ──▶ loop
//
// Whatever the order in `faults`: losses come first, then what is stuck, then changes in the order of the
// list, then times. A sample whose values change, and the one that a stuck channel goes on to repeat, is
// copied into a slot of the decorator's own; the memory for that is taken at arm, or, for a fault that is
// asked for later, by the thread that asks. Samples of more than 16 KiB are copied and changed by a worker,
// where there are workers: the loop hands them on when that is done.
//
//   delay, jitter   t_release stays; t_arrival is when it was handed on. Samples do not overtake each other:
//                   what comes behind a delayed one waits, and counts as delayed. Samples with bytes hold
//                   their slot of the inner source meanwhile (`slots` there).
//   timestamp, …    t_capture and t_release move; t_arrival does not. In virtual time a sample is handed on
//   at
//                   its new release or its old one, whichever is later; on the wall clock as it came.
//   stuck           content of the first sample that came while the fault was on, with the stamps of those
//   that
//                   come; with `freeze` the old time of capture too.
//   disconnect      what comes is lost; `connected` is false, and after it reconnects counts one more.
//   slow_consumer   unread: the inner source is not polled, its ring and its slots fill up. hold: so many
//                   leases are kept.
//
// Losses are counted in health().lost and in the next sample's lost_before. The accounts:
//   taken = handed_on + dropped + disconnected + no_slot + waiting
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <vector>

#include "rt-core/fixed_ring.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/fault_injector.h"
#include "sensor-hal/channel/simulated_source.h"
#include "sensor-hal/channel/slot_wait.h"

namespace rigor {

class FaultySource final : public FollowerSource {
 public:
  /// `workers` may be null; they outlive the source. Configures, arms, starts and stops `inner`, which is in
  /// state created.
  explicit FaultySource(std::unique_ptr<Source> inner, WorkerPool* workers = nullptr,
                        FrameSignalFinder find_signal = {});
  /// The same, of a source that measures when it is told to (a simulated side): so does this one.
  FaultySource(std::unique_ptr<FollowerSource> inner, WorkerPool* workers, FrameSignalFinder find_signal);
  ~FaultySource() override;

  void begin_cycle(BenchTime now) noexcept override;
  [[nodiscard]] SampleLease poll(BenchTime now) noexcept override;
  /// Faults that begin and end, then what the inner source tells.
  [[nodiscard]] SampleLease poll_event() noexcept override;
  void complete_until(BenchTime now) override;
  bool request_at(std::uint64_t index, BenchTime t_capture) noexcept override;
  [[nodiscard]] std::vector<std::string> warnings() const override { return inner_->warnings(); }
  [[nodiscard]] std::vector<std::string> forecasts() const override { return inner_->forecasts(); }
  [[nodiscard]] HealthSnapshot health() const noexcept override;

  [[nodiscard]] FaultInjector& faults() noexcept { return faults_; }
  [[nodiscard]] const FaultInjector& faults() const noexcept { return faults_; }
  [[nodiscard]] const Source& inner() const noexcept { return *inner_; }

  /// Of this run. Written by the loop, read by any thread.
  struct Accounts {
    std::atomic<std::uint64_t> taken{0};         ///< samples that the inner source gave
    std::atomic<std::uint64_t> handed_on{0};     ///< to the loop
    std::atomic<std::uint64_t> dropped{0};       ///< drop, burst_loss
    std::atomic<std::uint64_t> disconnected{0};  ///< came while the device was made to be gone
    std::atomic<std::uint64_t> no_slot{0};       ///< to be changed, and no slot to change it in
    std::atomic<std::uint64_t> waiting{0};       ///< held back now, or when the run ended
  };
  [[nodiscard]] const Accounts& accounts() const noexcept { return accounts_; }

 private:
  static constexpr std::size_t kWaiting = 256;
  static constexpr std::size_t kInlineBytes = 16 << 10;
  struct Job {
    SampleLease from;
    SampleSlot to;
    std::array<SampleEdit, FaultInjector::kMost> edits{};
    std::size_t edit_count = 0;
  };
  /// Where samples are changed. The strand goes first: its job uses the others.
  struct EditBuffers {
    EditBuffers(std::size_t slots, std::size_t bytes);
    std::unique_ptr<SamplePool> pool;
    std::size_t slot_bytes;
    SpscRing<Job> jobs;
    SpscRing<SampleLease> done;  ///< what the strand made of the jobs, in their order
    std::unique_ptr<WorkerPool::Strand> strand;
  };
  struct Waiting {
    SampleLease sample;     ///< empty while a job makes it
    BenchTime at;           ///< not before
    std::uint64_t job = 0;  ///< of the strand, counted from 1; 0: none
    bool own = false;       ///< in a slot of the room
  };
  /// What the active faults make of one sample.
  struct Verdict {
    const Fault* stuck = nullptr;
    bool keeps = false;  ///< a stuck fault kept it, to repeat it
    std::array<SampleEdit, FaultInjector::kMost> edits;
    std::size_t edit_count = 0;
    Duration delay, shift;
    std::uint32_t validity = 0;
    bool delayed = false, lost = false;
  };

  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

  Status make_buffers(FaultKind kind);
  void take_in(BenchTime now) noexcept;
  [[nodiscard]] bool cycle_allows_reading(BenchTime now) noexcept;
  void admit(SampleLease&& sample) noexcept;
  [[nodiscard]] BenchTime restamp(Stamp& stamp, const Verdict& v) noexcept;
  void judge(const SampleLease& sample, Verdict& v) noexcept;
  [[nodiscard]] SampleSlot take_slot(EditBuffers* buffers) noexcept;
  [[nodiscard]] std::uint64_t change(SampleLease& sample, const Verdict& v, EditBuffers& buffers,
                                     SampleSlot&& slot) noexcept;
  void lose(const Stamp& stamp, std::atomic<std::uint64_t>& account) noexcept;

  std::unique_ptr<Source> inner_;
  FollowerSource* follower_ = nullptr;  ///< inner_, where it is one
  WorkerPool* workers_;
  FrameSignalFinder find_signal_;
  FaultInjector faults_;

  std::mutex buffers_mutex_;  ///< setup and the thread that injects; never the loop
  bool armed_ = false;        ///< guarded by buffers_mutex_
  std::unique_ptr<EditBuffers> owned_buffers_;
  std::atomic<EditBuffers*> buffers_{nullptr};

  // the run
  bool virtual_time_ = false, running_ = false;
  SlotWait slot_wait_;
  Period loop_period_ = milliseconds(1);
  SampleLease ahead_;  ///< virtual time: one whose release has not come
  FixedRing<Waiting, kWaiting> waiting_;
  std::size_t own_waiting_ = 0;
  BenchTime last_at_;
  std::uint32_t lost_before_ = 0;
  std::atomic<std::uint64_t> incomplete_{0}, returns_{0};  ///< of this run, beside what the inner one counts
  std::atomic<bool> gone_{false};                          ///< made to be
  Accounts accounts_;
};

}  // namespace rigor
