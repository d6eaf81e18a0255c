// A device that is known by its signals, as one that is known by registers: each signal in two registers, an
// s32, most significant first, in steps of its own.
//
//   what it tells       input registers    2n, 2n + 1     n-th of the told signals, in their order
//   what it is told     holding registers  2n, 2n + 1     n-th of the commanded signals, in their order
//
// A value that is not known, or does not fit, reads as −2^31. A write of one of two registers takes effect
// with what the other one holds.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "sensor-hal/channel/providers.h"

namespace rigor {

/// One thread at a time, as the model behind it.
class SignalRegisters {
 public:
  /// `signals`: the model's; `step`: of each, in its unit.
  SignalRegisters(SignalModel& model, std::span<const SignalModel::Signal> signals,
                  std::span<const double> step)
      : model_(model) {
    for (std::size_t i = 0; i < signals.size(); ++i)
      (signals[i].commanded ? commanded_ : reported_).push_back({i, step[i]});
  }

  [[nodiscard]] bool read(RegisterTable table, std::uint16_t address, std::span<std::uint16_t> out,
                          BenchTime t) {
    const auto* entries = of(table);
    if (!entries || std::size_t{address} + out.size() > 2 * entries->size()) return false;
    for (std::size_t i = 0; i < out.size(); ++i) {
      const std::size_t at = address + i;
      const auto bits = bits_of((*entries)[at / 2], t);
      out[i] = static_cast<std::uint16_t>(at % 2 == 0 ? bits >> 16 : bits);
    }
    return true;
  }
  [[nodiscard]] bool write(RegisterTable table, std::uint16_t address, std::span<const std::uint16_t> in,
                           BenchTime t) {
    if (table != RegisterTable::holding_registers || std::size_t{address} + in.size() > 2 * commanded_.size())
      return false;
    bool taken = true;
    for (std::size_t n = address / 2; 2 * n < address + in.size(); ++n) {
      const Entry& e = commanded_[n];
      std::uint32_t bits = bits_of(e, t);
      for (std::size_t half = 0; half < 2; ++half) {
        const std::size_t at = 2 * n + half;
        if (at < address || at >= address + in.size()) continue;
        const std::uint32_t word = in[at - address];
        bits = half == 0 ? (bits & 0xFFFFu) | word << 16 : (bits & 0xFFFF0000u) | word;
      }
      taken = model_.write(e.signal, static_cast<std::int32_t>(bits) * e.step, t) && taken;
    }
    return taken;
  }

 private:
  struct Entry {
    std::size_t signal = 0;
    double step = 1;
  };
  [[nodiscard]] const std::vector<Entry>* of(RegisterTable table) const {
    if (table == RegisterTable::holding_registers) return &commanded_;
    return table == RegisterTable::input_registers ? &reported_ : nullptr;
  }
  [[nodiscard]] std::uint32_t bits_of(const Entry& e, BenchTime t) const {
    const double counts = std::round(model_.read(e.signal, t) / e.step);
    const bool fits = std::abs(counts) < 2147483648.0;
    return static_cast<std::uint32_t>(fits ? static_cast<std::int32_t>(counts)
                                           : std::numeric_limits<std::int32_t>::min());
  }

  SignalModel& model_;
  std::vector<Entry> commanded_, reported_;
};

}  // namespace rigor
