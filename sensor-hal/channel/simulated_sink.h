// Commands to a device that is computed in this process: the commanded signals of a SignalModel behind the
// interface of sinks. Each takes effect in the model at the very t_effect of its command.
//
//   virtual time   applied by complete_until, before the cycle that may see what came of it
//   wall clock     a thread of its own applies each when its instant has come (the model is told t_effect,
//   not
//                  when the thread got to it), and writes the `safe` values when the loop is silent or over
//
// Keys:
//   signals: [v, w]        commanded signals of the model, in the order of a command's values
//   safe: { v: 0, w: 0 }   what it is told at start, when the loop falls silent, and at stop; optional
#pragma once

#include <functional>
#include <memory>
#include <thread>
#include <vector>

#include "rt-core/deadline.h"
#include "rt-core/heartbeat.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/channel.h"
#include "sensor-hal/channel/providers.h"

namespace rigor {

/// The device, found by a sink's keys. bad_input; may throw ConfigError.
using DeviceFinder = std::function<Result<std::shared_ptr<SignalModel>>(const ChannelConfig& config)>;

class SimulatedSink final : public Sink {
 public:
  /// Looks its device up when it is configured.
  explicit SimulatedSink(DeviceFinder find) : find_(std::move(find)) {}
  explicit SimulatedSink(std::shared_ptr<SignalModel> model) : model_(std::move(model)) {}
  ~SimulatedSink() override;

  [[nodiscard]] bool command(const Command& command) noexcept override;
  void complete_until(BenchTime now) override;
  void watch(const Heartbeat* heartbeat, Duration deadline) override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  void run();
  void apply_until(BenchTime now);
  void apply(const Command& command);
  void make_safe(BenchTime t);

  DeviceFinder find_;  ///< empty: `model_` is there from the beginning
  std::shared_ptr<SignalModel> model_;
  std::vector<std::size_t> signals_;                  ///< of the model, in the order of a command's values
  std::vector<std::pair<std::size_t, double>> safe_;  ///< signal of the model, value
  std::unique_ptr<SpscRing<Command>> ring_;
  bool virtual_time_ = false, want_safe_ = false;
  Duration loop_period_ = milliseconds(1);
  const Heartbeat* heartbeat_ = nullptr;
  Duration heartbeat_deadline_ = milliseconds(100);
  Deadline deadline_;
  std::thread thread_;
};

}  // namespace rigor
