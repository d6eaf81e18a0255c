// Between the bytes of a frame and the values of its signals.
//
// Decoding gives NaN for signals that the frame does not show: multiplexed away, or beyond its length.
// Encoding refuses what a signal cannot hold: nothing is clipped, no bit of the frame is changed by a refused
// value. Integers of more than 53 bits lose their last digits, as every double does.
//
// Any thread, no allocation.
#pragma once

#include <cstdint>
#include <span>

#include "drivers/can/dbc.h"
#include "sensor-hal/types/sample.h"

namespace rigor::can {

enum class EncodeStatus : std::uint8_t {
  good,
  not_a_number,
  out_of_range,  ///< more than the bits hold, or outside of the stated minimum and maximum
};

/// The bits of a signal as they stand, right-aligned. The signal lies within the data.
[[nodiscard]] std::uint64_t read_raw(const Signal& s, std::span<const std::uint8_t> data) noexcept;
void write_raw(const Signal& s, std::span<std::uint8_t> data, std::uint64_t raw) noexcept;
/// Whether all bits of the signal are in the first `length` bytes.
[[nodiscard]] bool within(const Signal& s, std::size_t length) noexcept;

[[nodiscard]] double value_of(const Signal& s, std::uint64_t raw) noexcept;
/// Rounds to the nearest raw value, halves away from zero.
[[nodiscard]] EncodeStatus raw_of(const Signal& s, double value, std::uint64_t& raw) noexcept;

/// Whether the frame shows the signal: its multiplexors select it, and the frame is long enough.
[[nodiscard]] bool is_shown(const Message& m, std::size_t signal,
                            std::span<const std::uint8_t> data) noexcept;

/// One signal of a frame; NaN where it is not shown.
[[nodiscard]] double decode(const Message& m, std::size_t signal,
                            std::span<const std::uint8_t> data) noexcept;
/// All signals, in the order of the message; `out` has as many elements.
void decode(const Message& m, std::span<const std::uint8_t> data, std::span<double> out) noexcept;

/// A frame of the message with all signals at their start values (not shown ones at 0), its length filled up
/// to one that a frame can have.
[[nodiscard]] CanFrame blank_frame(const Message& m) noexcept;
/// Writes all shown signals. NaN: the signal keeps the bits that the frame has. `bad`: index of what did not
/// fit; the frame is then as it was.
[[nodiscard]] EncodeStatus encode(const Message& m, std::span<const double> values, CanFrame& frame,
                                  std::size_t& bad) noexcept;

}  // namespace rigor::can
