// What the bench and an application in a process of its own say to each other (docs/application-protocol.md
// has the same for people): messages over a Unix stream socket, all numbers little-endian.
//
//   bench                                          process
//   ─────                                          ───────
//                                  ◀── hello       JSON: the protocol's version, who it is
//   setup ──▶                                      JSON: rig, parameters, inputs, outputs, where samples lie
//                                  ◀── ready       JSON: nothing, or the rate that it asks for
//   turn ──▶                                       what became visible since the turn before
//                                  ◀── commands    the answer to that turn; the bench sends no other before
//                                  it
//   finish ──▶                                     the run is over
//                                  ◀── done
//
// In place of ready, commands and done the process may send `failed` with a sentence, which ends the run.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "sensor-hal/channel/application.h"

namespace rigor::application {

inline constexpr std::uint32_t kProtocolVersion = 1;
inline constexpr std::size_t kMaxTextBytes = std::size_t{1} << 20;      ///< of a message in JSON
inline constexpr std::size_t kMaxCommandsBytes = std::size_t{1} << 16;  ///< of an answer

enum class MessageType : std::uint32_t { hello = 1, setup, ready, turn, commands, finish, done, failed };

/// In front of every message.
struct MessageHeader {
  std::uint32_t size_bytes = 0;  ///< of what follows
  MessageType type{};
};
static_assert(sizeof(MessageHeader) == 8);

/// The message of a turn, written into memory of a fixed size. No allocation after construction.
///
///   header; u64 cycle; i64 t [ns]; u32 ports; u32 samples;
///   ports × { u32 status (PortStatus) }, in the order of setup, and 4 bytes of 0 where their number is odd;
///   samples × { u32 input; u32 kind; u64 sequence; i64 t_capture, t_release, t_arrival, sigma_capture [ns];
///               u32 lost_before; u32 validity; u64 offset; u64 bytes; u32 info_bytes; u32 0; info }
class TurnMessage {
 public:
  TurnMessage(std::size_t inputs, std::size_t capacity_bytes);

  /// Appends a sample; false: there is no room for it. `offset`: of its bytes in the shared memory.
  bool add(std::uint32_t input, const Sample& sample, std::uint64_t offset) noexcept;
  /// The samples that were added are forgotten; how many these were.
  std::uint32_t clear() noexcept;
  void set_status(std::uint32_t input, PortStatus status) noexcept;
  [[nodiscard]] std::uint32_t samples() const noexcept { return samples_; }
  /// The message, complete. Valid until the next call of this object.
  [[nodiscard]] std::span<const std::byte> finish(std::uint64_t cycle, BenchTime t) noexcept;

 private:
  std::size_t inputs_, begin_, end_;
  std::uint32_t samples_ = 0;
  std::vector<std::byte> bytes_;
};

/// One command of an answer.
struct AnsweredCommand {
  std::uint32_t output = 0, count = 0;
  std::array<double, 16> value{};
};

/// Reads the answer to a turn: u64 cycle; u32 commands; u32 0; commands × { u32 output; u32 count; count ×
/// f64 }. Any thread, no allocation.
class AnswerReader {
 public:
  /// `body`: of a message of type `commands`. False: it is shorter than its beginning.
  bool open(std::span<const std::byte> body) noexcept;
  [[nodiscard]] std::uint64_t cycle() const noexcept { return cycle_; }
  enum class Next : std::uint8_t { command, end, malformed };
  /// malformed: cut off, an output that does not exist, more or fewer values than it takes.
  Next next(std::span<const std::size_t> values_of_output, AnsweredCommand& out) noexcept;

 private:
  std::span<const std::byte> rest_;
  std::uint64_t cycle_ = 0;
  std::uint32_t left_ = 0;
};

}  // namespace rigor::application
