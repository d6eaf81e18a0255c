// What packet LiDARs in virtual time share: the emulated device in process, whose packets are decoded as they
// would be from the network. What moves in the world is where it is when a scan begins.
#pragma once

#include "drivers/lidar/sensor_source.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::packet_lidar {

class VirtualSensor : public SensorSource {
 public:
  /// `emulator_params`: the entry that stands for the device in the rig.
  VirtualSensor(DeviceParts parts, ConfigNode emulator_params)
      : parts_(std::move(parts)), emulator_params_(std::move(emulator_params)) {}
  void complete_until(BenchTime now) final {
    if (running_) send_until(now);
  }

 protected:
  Status do_arm(const ArmContext& context) final;
  Status do_start(BenchTime t0) final;
  Status do_stop() final;

  /// Setup: the device, its decoder and memory for samples.
  virtual Status open_device() = 0;
  /// Setup: the device begins at `t0`.
  virtual void begin(BenchTime t0) = 0;
  /// What the device sends until `now`.
  virtual void send_until(BenchTime now) = 0;

  /// Setup. bad_input: the channel's latency is less than what the device takes to send a whole sample.
  [[nodiscard]] Status check_latency(Duration least) const;
  /// `device.measure` of scan `k`, which begins at `t_begin`. A scan that fails is a protocol error.
  template <class Device, class Scan>
  void measure(Device& device, std::uint64_t k, BenchTime t_begin, Scan& out) {
    const WorldMotion motion = parts_.motion ? parts_.motion->motion_at(t_begin) : WorldMotion{};
    if (!device.measure(k, t_begin, motion, out))
      health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
  }

  DeviceParts parts_;
  ConfigNode emulator_params_;

 private:
  bool running_ = false;
};

}  // namespace rigor::packet_lidar
