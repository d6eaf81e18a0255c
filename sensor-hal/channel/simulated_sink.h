// Commands to a device that is computed in this process: the commanded signals of a SignalModel behind the
// interface of sinks. Each takes effect in the model at the very t_effect of its command.
//
//   virtual time   applied by complete_until, before the cycle that may see what came of it
//   wall clock     a thread of its own applies each when its instant has come (the model is told t_effect,
//                  not when the thread got to it), and writes the `safe` values when the loop is silent or
//                  over
//
// Keys:
//   signals: [v, w]        commanded signals of the model, in the order of a command's values
//   safe: { v: 0, w: 0 }   what it is told at start, when the loop falls silent, and at stop; optional
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "sensor-hal/channel/paced_sink.h"
#include "sensor-hal/channel/providers.h"

namespace rigor {

/// The device, found by a sink's keys. bad_input; may throw ConfigError.
using DeviceFinder = std::function<Result<std::shared_ptr<SignalModel>>(const ChannelConfig& config)>;

class SimulatedSink final : public PacedSink {
 public:
  /// Looks its device up when it is configured.
  explicit SimulatedSink(DeviceFinder find) : find_(std::move(find)) {}
  explicit SimulatedSink(std::shared_ptr<SignalModel> model) : model_(std::move(model)) {}
  ~SimulatedSink() override;

  void complete_until(BenchTime now) override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  void apply(const Command& command) override;
  void keep_safe() override;
  void after() override;
  void make_safe(BenchTime t);

  DeviceFinder find_;  ///< empty: `model_` is there from the beginning
  std::shared_ptr<SignalModel> model_;
  std::vector<std::size_t> signals_;                  ///< of the model, in the order of a command's values
  std::vector<std::pair<std::size_t, double>> safe_;  ///< signal of the model, value
  bool virtual_time_ = false, is_safe_ = false;
};

}  // namespace rigor
