// A device of plain registers, and what the tests need around it.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <chrono>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#include "drivers/modbus/modbus_emulator.h"
#include "sensor-hal/channel/providers.h"

namespace rigor::modbus {

/// 256 registers in each table; remembers every write and the instants of the reads.
class Bank final : public RegisterModel {
 public:
  static constexpr std::size_t kSize = 256;
  using Tables = std::array<std::array<std::uint16_t, kSize>, 4>;
  struct Write {
    RegisterTable table;
    std::uint16_t address;
    std::vector<std::uint16_t> values;
    BenchTime t;
  };

  [[nodiscard]] bool read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                          BenchTime t) override {
    const std::lock_guard lock(mutex_);
    if (address + out.size() > kSize) return false;
    if (on_read_) on_read_(t, tables_);
    std::copy_n(tables_[static_cast<std::size_t>(table)].begin() + address, out.size(), out.begin());
    reads_.push_back(t);
    return true;
  }
  [[nodiscard]] bool write(RegisterTable table, std::uint16_t address, std::span<const std::uint16_t> in,
                           BenchTime t) override {
    const std::lock_guard lock(mutex_);
    if (address + in.size() > kSize) return false;
    std::copy(in.begin(), in.end(), tables_[static_cast<std::size_t>(table)].begin() + address);
    writes_.push_back({table, address, {in.begin(), in.end()}, t});
    return true;
  }
  void set(RegisterTable table, std::uint16_t address, std::vector<std::uint16_t> values) {
    const std::lock_guard lock(mutex_);
    std::copy(values.begin(), values.end(), tables_[static_cast<std::size_t>(table)].begin() + address);
  }
  [[nodiscard]] std::uint16_t get(RegisterTable table, std::uint16_t address) {
    const std::lock_guard lock(mutex_);
    return tables_[static_cast<std::size_t>(table)][address];
  }
  [[nodiscard]] std::uint16_t holding(std::uint16_t address) {
    return get(RegisterTable::holding_registers, address);
  }
  [[nodiscard]] std::vector<Write> writes() {
    const std::lock_guard lock(mutex_);
    return writes_;
  }
  [[nodiscard]] std::vector<BenchTime> reads() {
    const std::lock_guard lock(mutex_);
    return reads_;
  }
  /// What happens to the registers just before each read.
  void on_read(std::function<void(BenchTime, Tables&)> change) {
    const std::lock_guard lock(mutex_);
    on_read_ = std::move(change);
  }

 private:
  std::mutex mutex_;
  std::function<void(BenchTime, Tables&)> on_read_;
  Tables tables_{};
  std::vector<Write> writes_;
  std::vector<BenchTime> reads_;
};

inline DeviceParts parts_of(std::shared_ptr<RegisterModel> registers) {
  DeviceParts parts;
  parts.registers = std::move(registers);
  return parts;
}
inline ConfigNode yaml(const std::string& text) {
  auto n = ConfigDocument::parse(text, "rig.yaml");
  EXPECT_TRUE(n.has_value()) << (n ? "" : n.error().text());
  return n ? *n : ConfigNode();
}

/// Waits until `true_now`; false when it was not within `at_most`.
template <class F>
bool eventually(Duration at_most, F&& true_now) {
  const auto end = monotonic_now() + at_most;
  while (monotonic_now() < end) {
    if (true_now()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true_now();
}

/// An emulated device on loopback, on a free port or on one that is given.
class Device {
 public:
  explicit Device(std::shared_ptr<RegisterModel> model, std::uint16_t port = 0,
                  const std::string& more = "") {
    emulator_.attach(parts_of(std::move(model)));
    ChannelConfig c;
    c.name = "device";
    c.params = yaml("port: " + std::to_string(port) + "\n" + more);
    auto s = emulator_.configure(c);
    EXPECT_TRUE(s) << s.error().text();
    s = emulator_.arm({});
    EXPECT_TRUE(s) << s.error().text();
    s = emulator_.start(bench_now());
    EXPECT_TRUE(s) << s.error().text();
  }
  [[nodiscard]] std::uint16_t port() const { return emulator_.port(); }
  ModbusEmulator& operator*() { return emulator_; }
  ModbusEmulator* operator->() { return &emulator_; }

 private:
  ModbusEmulator emulator_;
};

}  // namespace rigor::modbus
