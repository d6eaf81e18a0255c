// Stands where a sink was in a run that is looked at again: knows the names of its values, takes every
// command, and moves nothing.
#pragma once

#include <utility>

#include "sensor-hal/channel/channel.h"

namespace rigor {

class ReplaySink final : public Sink {
 public:
  /// `params`: of the sink in the recorded rig; `registers` and `signals` are read, the rest is of no use
  /// here.
  explicit ReplaySink(ConfigNode params) : params_(std::move(params)) {}

  [[nodiscard]] bool command(const Command& command) noexcept override;
  void watch(const Heartbeat* heartbeat, Duration deadline) override;

 private:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext&) override { return {}; }
  Status do_start(BenchTime) override { return {}; }
  Status do_stop() override { return {}; }

  ConfigNode params_;
};

}  // namespace rigor
