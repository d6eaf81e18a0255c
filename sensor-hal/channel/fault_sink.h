// A sink with faults: what happens to commands on their way to the device. Which kinds: fault_spec.h.
//
//   drop, burst_loss, disconnect   the command is lost; the bench does not know (`command` returns true)
//   delay, jitter                  t_effect is later; commands do not overtake each other
//   stuck                          the values of the first command that came while it was on
//   bias, drift, noise, spike      of a register, in its unit
//
// The loop's heartbeat and the safe values are the inner sink's own: no fault stands between them and the
// device. Its counters are the inner sink's, with what was lost here among accepted and dropped.
#pragma once

#include <atomic>
#include <memory>

#include "sensor-hal/channel/fault_injector.h"

namespace rigor {

class FaultySink final : public Sink {
 public:
  /// Configures, arms, starts and stops `inner`, which is in state created.
  explicit FaultySink(std::unique_ptr<Sink> inner);
  ~FaultySink() override;

  [[nodiscard]] bool command(const Command& command) noexcept override;
  void complete_until(BenchTime now) override;
  void watch(const Heartbeat* heartbeat, Duration deadline) override { inner_->watch(heartbeat, deadline); }
  [[nodiscard]] std::vector<std::string> warnings() const override { return inner_->warnings(); }
  [[nodiscard]] HealthSnapshot health() const noexcept override { return inner_->health(); }
  [[nodiscard]] SinkSnapshot counters() const noexcept override;

  [[nodiscard]] FaultInjector& faults() noexcept { return faults_; }
  [[nodiscard]] const FaultInjector& faults() const noexcept { return faults_; }
  [[nodiscard]] const Sink& inner() const noexcept { return *inner_; }

 private:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

  std::unique_ptr<Sink> inner_;
  FaultInjector faults_;
  Period loop_period_ = milliseconds(1);
  BenchTime last_effect_;
  bool any_ = false;
  std::atomic<std::uint64_t> lost_{0};  ///< of this run
};

}  // namespace rigor
