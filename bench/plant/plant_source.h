// Values of a plant as a channel of registers (or, through sensor-hal/channel/typed_source.h, a pose, an
// inertial unit, odometry):
//
//   height:
//     kind: registers
//     backend: fmu
//     plant: ball
//     signals: [height, speed]     # default: all that are not commanded, in their order
//     rate_hz: 100
//
// A capture at t0 + k·period has the values of the plant at that instant. Where the FMU has failed, instants
// are lost, the channel is `disconnected`, and an event says why; another one says that it is back.
#pragma once

#include <memory>
#include <vector>

#include "bench/plant/plant.h"
#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor::plant {

class Plants;

/// Codes of events.
enum PlantEvent : std::uint32_t { kEventBack = 0, kEventFault = 1, kEventLate = 2 };

class PlantSource final : public StreamSource, private PlantListener {
 public:
  /// Finds its plant when it is configured.
  explicit PlantSource(Plants& plants) : plants_(plants) {}
  ~PlantSource() override;
  void complete_until(BenchTime now) override;
  [[nodiscard]] SampleLease poll_event() noexcept override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  void plant_reached(BenchTime t) noexcept override;
  [[nodiscard]] BenchTime capture_time() const noexcept {
    return t0_ + config().period * static_cast<std::int64_t>(index_);
  }
  void capture() noexcept;
  void look_at_plant(BenchTime t);
  void tell(std::uint32_t code, double value, const std::string& text, BenchTime t) noexcept;

  Plants& plants_;
  std::shared_ptr<Plant> plant_;
  std::vector<std::size_t> signals_;
  bool virtual_time_ = false, subscribed_ = false, late_told_ = false;
  BenchTime t0_;
  std::uint64_t index_ = 0;
  std::uint64_t restarts_ = 0;
  std::unique_ptr<SamplePool> event_pool_;
  std::unique_ptr<SpscRing<SampleLease>> events_;
};

}  // namespace rigor::plant
