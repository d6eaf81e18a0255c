#include "drivers/modbus/register_bank.h"

#include <cmath>
#include <numbers>

namespace rigor::modbus {

std::shared_ptr<RegisterBank> RegisterBank::parse(const ConfigNode& n) {
  auto bank = std::make_shared<RegisterBank>();
  const auto items = n.list("registers");
  if (items.empty() || items.size() > 1000)
    throw n.error("registers", "expected 1 to 1000 registers, got " + std::to_string(items.size()));
  for (const auto& item : items) {
    const double value = item.number_or("value", 0);
    const auto wave = item.map_or_absent("wave");
    Moving m{{}, value, 0, {}};
    if (wave.present()) {
      m.amplitude = wave.number("amplitude");
      m.period = seconds_from(wave.number("period_s", {.min = 1e-3, .max = 1e6}));
      wave.finish();
    }
    m.what = parse_register(item, RegisterMap::Access::read);
    const auto width_of = width(m.what.type);
    std::vector<std::uint16_t> raw(width_of, 0);
    for (std::uint16_t i = 0; i < width_of; ++i) {
      // Fields of one register add up.
      const auto cell =
          bank->cells_.try_emplace({m.what.table, static_cast<std::uint16_t>(m.what.address + i)}, 0);
      raw[i] = cell.first->second;
      if (!cell.second && !m.what.is_field())
        throw item.error("address", "expected registers of its own, got some that another one has too");
    }
    for (const double x : {value, value + m.amplitude, value - m.amplitude})
      if (encode(m.what, x, raw) != EncodeStatus::good)
        throw item.error(x == value ? "value" : "wave",
                         "expected values that the register can hold, got one that it cannot");
    (void)encode(m.what, value, raw);
    for (std::uint16_t i = 0; i < width_of; ++i)
      bank->cells_[{m.what.table, static_cast<std::uint16_t>(m.what.address + i)}] = raw[i];
    if (wave.present()) bank->moving_.push_back(std::move(m));
  }
  return bank;
}

void RegisterBank::move(BenchTime t) {
  if (!begun_) begin_ = t, begun_ = true;
  std::array<std::uint16_t, 4> raw{};
  for (const auto& m : moving_) {
    const double turns = std::fmod((t - begin_).seconds(), m.period.seconds()) / m.period.seconds();
    const auto n = width(m.what.type);
    for (std::uint16_t i = 0; i < n; ++i)
      raw[i] = cells_[{m.what.table, static_cast<std::uint16_t>(m.what.address + i)}];
    (void)encode(m.what, m.value + m.amplitude * std::sin(2 * std::numbers::pi * turns), {raw.data(), n});
    for (std::uint16_t i = 0; i < n; ++i)
      cells_[{m.what.table, static_cast<std::uint16_t>(m.what.address + i)}] = raw[i];
  }
}

bool RegisterBank::read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                        BenchTime t) {
  const std::lock_guard lock(mutex_);
  move(t);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const auto cell = cells_.find({table, static_cast<std::uint16_t>(address + i)});
    if (cell == cells_.end()) return false;
    out[i] = cell->second;
  }
  return true;
}

bool RegisterBank::write(RegisterTable table, std::uint16_t address, std::span<const std::uint16_t> in,
                         BenchTime) {
  const std::lock_guard lock(mutex_);
  for (std::size_t i = 0; i < in.size(); ++i)
    if (!cells_.contains({table, static_cast<std::uint16_t>(address + i)})) return false;
  for (std::size_t i = 0; i < in.size(); ++i)
    cells_[{table, static_cast<std::uint16_t>(address + i)}] = in[i];
  return true;
}

}  // namespace rigor::modbus
