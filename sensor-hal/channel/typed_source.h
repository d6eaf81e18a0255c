// A channel of kind pose, imu, nav_fix or odometry whose device speaks in registers or in signals of a bus:
// stands in front of its source, which is configured as one of kind registers, and says what its values mean
// (typed_values.h). Stamps, losses and order are those of the source.
//
//   odometry:
//     kind: odometry
//     backend: modbus                 # or can, with signals of a DBC
//     wheel_radius_m: 0.2             # odometry of wheel angles alone
//     track_m: 1.12                   # the effective one
//     registers:
//       - { name: left_angle, table: input_registers, address: 0, type: s32, scale: 0.001, unit: rad }
//       …
//
// A sample that lacks a value it needs is marked incomplete.
#pragma once

#include <atomic>
#include <memory>
#include <optional>

#include "sensor-hal/channel/channel.h"
#include "sensor-hal/channel/typed_values.h"

namespace rigor {

class TypedSource final : public Source {
 public:
  /// `inner` is in state created; its samples are held by nobody else when it gives them.
  explicit TypedSource(std::unique_ptr<Source> inner) : inner_(std::move(inner)) {}
  ~TypedSource() override;

  void begin_cycle(BenchTime now) noexcept override;
  [[nodiscard]] SampleLease poll(BenchTime now) noexcept override;
  [[nodiscard]] SampleLease poll_event() noexcept override { return inner_->poll_event(); }
  void complete_until(BenchTime now) override { inner_->complete_until(now); }
  [[nodiscard]] std::vector<std::string> warnings() const override { return inner_->warnings(); }
  [[nodiscard]] std::vector<std::string> forecasts() const override { return inner_->forecasts(); }
  [[nodiscard]] HealthSnapshot health() const noexcept override;

 private:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override { return inner_->arm(context); }
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

  std::unique_ptr<Source> inner_;
  std::optional<TypedValues> values_;
  std::atomic<std::uint64_t> unknown_{0};  ///< samples that the source did not mark, and that lack a value
};

}  // namespace rigor
