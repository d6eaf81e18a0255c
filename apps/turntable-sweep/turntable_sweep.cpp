#include "apps/turntable-sweep/turntable_sweep.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>

namespace rigor {
namespace {

class TurntableSweep final : public Application {
 public:
  Status configure(ConfigNode params, const ApplicationPorts& ports, Period loop_period) override {
    auto read = catch_config([&] {
      amplitude_rad_ = params.number_or("amplitude_deg", 30, {.min = 0, .max = 180}) * std::numbers::pi / 180;
      sweep_period_s_ = params.number_or("period_s", 8, {.min = 0.1, .max = 1e6});
      const double rate_hz = params.number_or("rate_hz", 50, {.min = 0.1, .max = loop_period.hz()});
      command_every_ = static_cast<std::uint64_t>(std::llround(loop_period.hz() / rate_hz));
      const std::string table = params.text("table");
      params.finish();
      const auto it = ports.outputs.find(table);
      if (it == ports.outputs.end()) {
        std::string names;
        for (const auto& [name, port] : ports.outputs) names += (names.empty() ? "" : ", ") + name;
        throw params.error("table", "expected the name of a sink (" + names + "), got \"" + table + "\"");
      }
      table_ = it->second;
      if (table_->describe().names.size() != 2)
        throw params.error(
            "table", "expected a sink with two registers, enable and target rate in degrees per second");
      return 0;
    });
    return read ? Status{} : Status(tl::unexpected<Error>(read.error()));
  }

  void step(std::uint64_t cycle, BenchTime t_cycle) noexcept override {
    if (!started_) {
      t_start_ = t_cycle;
      started_ = true;
    }
    if (cycle % command_every_ != 0) return;
    const double omega = 2 * std::numbers::pi / sweep_period_s_;
    const double rate_radps = amplitude_rad_ * omega * std::cos(omega * (t_cycle - t_start_).seconds());
    const std::array<double, 2> values{1.0, rate_radps * 180 / std::numbers::pi};
    (void)table_->send(t_cycle, values);  // a full ring is counted by the sink
  }

 private:
  CommandPort* table_ = nullptr;
  double amplitude_rad_ = 0, sweep_period_s_ = 1;
  std::uint64_t command_every_ = 1;
  BenchTime t_start_;
  bool started_ = false;
};

}  // namespace

std::unique_ptr<Application> make_turntable_sweep() { return std::make_unique<TurntableSweep>(); }

}  // namespace rigor
