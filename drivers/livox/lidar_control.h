// What a Mid-360 answers to its hosts: searching, parameters, reboot, GPS time. No socket; the emulator
// carries datagrams, its lock guards this.
//
//   switched on → SELFCHECK → MOTORSTARTUP → what work_tgt_mode says (SAMPLING at first)
//
// Parameters take effect at once; the device's own address, only after a reboot. Fields of view, detection
// mode, attitude and pins are kept and told, and change nothing.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "drivers/livox/livox_command.h"
#include "rt-core/time.h"

namespace rigor::livox {

class LidarControl {
 public:
  struct Identity {
    std::string serial = "47MDL00010101", product = "Mid-360";
    std::uint32_t ipv4 = 0x7F000001;
    std::uint16_t command_port = kCommandPort;
    Duration start_up;  ///< from switching on until it measures
  };
  /// How it is set when it is switched on.
  struct Setup {
    DataType data_type = DataType::cartesian_mm;
    HostAddress state_host, point_host, imu_host;
    bool imu = true;
    WorkState target = WorkState::sampling;
  };
  /// What decides about its packets.
  struct Active {
    Setup setup;
    WorkState state = WorkState::self_check;
    MonotonicTime switched_on;
    std::int64_t gps_less_device_ns = 0;  ///< where a host has set it
    bool gps = false;
    std::uint64_t generation = 0;  ///< another one: something of this has changed
  };

  LidarControl(const Identity& identity, const Setup& setup, MonotonicTime now);

  /// The answer to a datagram; empty: none. `searching`: it came to the port for searching, which answers to
  /// nothing else.
  [[nodiscard]] std::vector<std::uint8_t> answer(Bytes datagram, bool searching, MonotonicTime now);
  /// What it pushes to its state_host.
  [[nodiscard]] std::vector<std::uint8_t> push(MonotonicTime now);
  [[nodiscard]] Active active(MonotonicTime now);

 private:
  using Value = std::vector<std::uint8_t>;
  [[nodiscard]] WorkState state(MonotonicTime now) const;
  [[nodiscard]] Setup setup() const;
  void switch_on(MonotonicTime now);
  void pass(MonotonicTime now);
  void measure_itself(MonotonicTime now);
  [[nodiscard]] Value configure(Bytes data);
  [[nodiscard]] Value inquire(Bytes data);
  [[nodiscard]] Value gps_time(Bytes data, MonotonicTime now);

  Identity identity_;
  std::map<Key, Value> values_;
  MonotonicTime switched_on_, reboot_at_;
  bool reboots_ = false, gps_ = false;
  std::int64_t gps_less_device_ns_ = 0;
  std::uint32_t power_ups_ = 0, sequence_ = 0;
  std::uint64_t generation_ = 0;
};

}  // namespace rigor::livox
