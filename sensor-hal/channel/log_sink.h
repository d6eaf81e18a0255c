// Backend `log`: a sink that moves nothing: what an application wants to have recorded of itself, such as its
// estimate of where it is. What it is told goes to `/rigor/commands` of the recording like every command.
//
// Keys:
//   signals: [x, y, yaw]      names of the values, 1 to 16
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {

class LogSink final : public Sink {
 public:
  [[nodiscard]] bool command(const Command&) noexcept override {
    counters_.accepted.fetch_add(1, std::memory_order_relaxed);
    counters_.applied.fetch_add(1, std::memory_order_relaxed);
    return true;
  }
  void watch(const Heartbeat*, Duration) override {}

 protected:
  Status do_configure(const ChannelConfig& config) override {
    description_ = {};
    for (const ConfigNode& item : config.params.list("signals")) {
      description_.names.push_back(item.as_text());
      description_.units.emplace_back();
    }
    if (description_.names.empty() || description_.names.size() > Command{}.value.size())
      throw config.params.error("signals", "expected 1 to 16 names");
    description_.kind = SampleKind::register_block;
    description_.frame_id = config.name;
    return {};
  }
  Status do_arm(const ArmContext&) override {
    health_.connected.store(true, std::memory_order_release);
    return {};
  }
  Status do_stop() override { return {}; }
};

[[nodiscard]] inline Backend log_backend() {
  Backend b;
  b.name = "log";
  b.summary = "values of the application, for the recording";
  b.make_sink = [] { return std::make_unique<LogSink>(); };
  b.same_in_virtual_time = true;
  return b;
}

}  // namespace rigor
