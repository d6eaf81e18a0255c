// Commands to registers of a Modbus device, over TCP or a serial line.
//
// The loop pushes commands into a ring; a thread of its own writes each at its t_effect and watches the
// loop's heartbeat. It makes the device safe by writing the `safe:` values
//   - at arm, so that the device is in a known state before the loop starts,
//   - when the loop is silent for longer than the deadline, or says that it stopped,
//   - at stop.
// What was commanded before the loop fell silent is then thrown away. When the device is gone, the thread
// connects again, and first of all writes what the device is to have by then: the safe values, or the last
// command.
//
// When this process dies, nobody writes safe values: only the device's own watchdog can. Where the rig names
// it (`watchdog`), its timeout is written at arm and after each reconnection, and the last command is written
// again whenever a third of the timeout passed without a new one, as long as the loop lives.
#pragma once

#include <vector>

#include "drivers/modbus/register_channel.h"
#include "sensor-hal/channel/backoff.h"
#include "sensor-hal/channel/paced_sink.h"

namespace rigor::modbus {

/// `health().connected`: the device took the last write.
class ModbusSink final : public PacedSink {
 public:
  ~ModbusSink() override;
  /// What the device refused or left unanswered so far.
  [[nodiscard]] std::vector<std::string> warnings() const override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return true; }
  Status do_arm(const ArmContext& context) override;
  Status do_stop() override;

 private:
  void tick() override;
  void apply(const Command& command) override;
  void keep_safe() override;
  void after() override;  // refreshes the device's watchdog
  LinkStatus write(const RegisterMap& map, const std::vector<std::uint16_t>& raw);
  [[nodiscard]] bool set_watchdog();
  void make_safe();
  void try_again();
  void count_link();

  SinkSettings settings_;
  Link link_;
  std::vector<std::uint16_t> raw_, next_raw_, check_;
  Backoff backoff_;          // of connecting again
  MonotonicTime next_safe_;  // of asking a device that refused its safe values
  MonotonicTime next_refresh_;
  std::uint64_t reconnects_ = 0, repeated_ = 0;
  bool safe_ = false;  // the device has the safe values, as far as anyone knows
  bool has_command_ = false;
};

}  // namespace rigor::modbus
