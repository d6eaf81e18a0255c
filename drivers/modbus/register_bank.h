// A device of plain registers: what a rig says that it has, with values that stay, are written, or move in
// time.
//
//   registers:
//     - { name: power, table: input_registers, address: 0, type: f32, value: 230,
//         wave: { amplitude: 5, period_s: 2 } }
//     - { name: valve, table: coils, address: 3 }
//
// A value moves as value + amplitude · sin(2π t / period), t from the first time it is asked; it is exact at
// any instant, so that the same instants give the same registers.
#pragma once

#include <map>
#include <memory>
#include <mutex>

#include "drivers/modbus/register_map.h"

namespace rigor::modbus {

class RegisterBank final : public RegisterModel {
 public:
  /// Reads the list `registers` of an emulator. Throws ConfigError.
  [[nodiscard]] static std::shared_ptr<RegisterBank> parse(const ConfigNode& n);

  [[nodiscard]] bool read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                          BenchTime t) override;
  [[nodiscard]] bool write(RegisterTable table, std::uint16_t address, std::span<const std::uint16_t> in,
                           BenchTime t) override;

 private:
  struct Moving {
    RegisterValue what;
    double value, amplitude;
    Duration period;
  };
  void move(BenchTime t);

  std::mutex mutex_;
  std::map<std::pair<RegisterTable, std::uint16_t>, std::uint16_t> cells_;
  std::vector<Moving> moving_;
  BenchTime begin_;
  bool begun_ = false;
};

}  // namespace rigor::modbus
