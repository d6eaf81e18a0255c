// A sensor that is computed: an ImageProvider or a SampleProvider behind the channel interface.
//
//   grid     t0 + phase + k·period                         capture index k is the sample's sequence
//   cycle    the first one at or after that instant        reads the motion, takes a slot, queues the request
//   worker   measures into the slot                        whenever it gets to it; what is immediate
//                                                          (SampleProvider) the loop measures itself
//   loop     polls it, ready long before t_release = t_capture + latency, or late
//
// What is measured depends on the request alone: capture index, instant, motion, exposure. So the samples of
// a run are the same on any number of threads. Whether a slot is free is decided on the loop's thread too,
// for the same reason.
//
// In wall time `arm` takes a few samples to warm up and to know how long one takes, while nothing else is
// measured. Where the mean is longer than the period, `forecasts` names a rate that this machine can keep;
// where the longest is longer than the channel's latency, `warnings` says so.
//
// Keys (all optional):
//   phase_us: 0          offset of the grid
//   slots: 16            samples measured, pending, held by the application and by the recorder
//   max_backlog: 2       wall time: requests that may wait for a worker; one more is skipped, counted as lost
// and of images:
//   exposure_us: 4000    default: the provider's
//   gain_db: 0
//   pixel_format: Mono8  by the names of the PFNC
//   region: { x_px: 0, y_px: 0, width_px: 640, height_px: 480 }
#pragma once

#include <array>
#include <atomic>
#include <functional>
#include <memory>
#include <optional>
#include <variant>

#include "rt-core/fixed_ring.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/follower_source.h"
#include "sensor-hal/channel/providers.h"
#include "sensor-hal/channel/slot_wait.h"
#include "sensor-hal/channel/worker_pool.h"

namespace rigor {

class Measurer;

/// What measures, made of a channel's keys. bad_input, unavailable; may throw ConfigError.
using AnyProvider = std::variant<std::shared_ptr<ImageProvider>, std::shared_ptr<SampleProvider>>;
using ProviderMaker = std::function<Result<AnyProvider>(const ChannelConfig& config)>;

class SimulatedSource final : public FollowerSource {
 public:
  /// `motion` may be null (nothing moves); it and `workers` outlive the source. The provider is used by one
  /// thread at a time; it is not shared with another source.
  SimulatedSource(std::shared_ptr<ImageProvider> provider, const MotionSource* motion, WorkerPool& workers);
  SimulatedSource(std::shared_ptr<SampleProvider> provider, const MotionSource* motion, WorkerPool& workers);
  /// Makes its provider when it is configured.
  SimulatedSource(ProviderMaker make, const MotionSource* motion, WorkerPool& workers);
  ~SimulatedSource() override;

  void begin_cycle(BenchTime now) noexcept override;
  [[nodiscard]] SampleLease poll(BenchTime now) noexcept override;
  void complete_until(BenchTime now) override;
  bool request_at(std::uint64_t index, BenchTime t_capture) noexcept override;
  [[nodiscard]] std::vector<std::string> warnings() const override;
  [[nodiscard]] std::vector<std::string> forecasts() const override;

  /// Setup thread, armed in wall time: the longest of the captures that warmed up.
  [[nodiscard]] Duration warm_capture() const noexcept { return warm_; }

 private:
  struct Request {
    SampleProvider::Request what;
    SampleSlot slot;
    std::uint32_t lost_before = 0;
  };

  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;
  void request_next() noexcept;
  void measure_next();
  void measure(Request& request);
  Status warm_up();

  ProviderMaker make_;  ///< empty: `measurer_` is there from the beginning
  std::unique_ptr<Measurer> measurer_;
  const MotionSource* motion_;
  WorkerPool& workers_;

  // configuration
  Period period_;
  Duration latency_, phase_;
  std::size_t slots_ = 0;
  std::uint64_t max_backlog_ = 0;
  std::size_t most_waiting_ = 0;

  // the run
  bool virtual_time_ = false;
  bool immediate_ = false;
  bool running_ = false;
  BenchTime t_start_;
  BenchTime next_capture_;
  bool on_grid_ = false;  ///< asked by begin_cycle, where the simulated side of a pair is asked by that
  std::uint64_t next_index_ = 0;
  std::uint32_t lost_before_ = 0;
  SlotWait slot_wait_;
  std::unique_ptr<SamplePool> pool_;
  std::size_t pool_bytes_ = 0;
  std::optional<SpscRing<Request>> requests_;
  std::optional<SpscRing<SampleLease>> results_;
  std::unique_ptr<WorkerPool::Strand> strand_;
  std::atomic<std::uint32_t> failed_before_{0};  // worker: failed captures since the last good one
  Duration warm_, warm_mean_;                    ///< the mean without the first one

  // Virtual time, on the loop's thread: releases of the requests that are not known to be done, and how many
  // are.
  FixedRing<BenchTime> releases_;
  std::uint64_t completed_ = 0;
};

}  // namespace rigor
