// What an application that computes apart from the loop is shown, turn by turn, and what becomes of its
// answers: the same for a process and for a shared object.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "bench/application/process_protocol.h"
#include "sensor-hal/channel/application.h"

namespace rigor::application {

class Turns {
 public:
  /// How the application finds the bytes of a sample: an offset in memory that it maps, or an address.
  using PlaceOf = std::uint64_t (*)(const Sample&) noexcept;
  /// Setup context.
  Turns(const ApplicationPorts& ports, std::size_t capacity_bytes, PlaceOf place_of);

  // Loop thread; no allocation.

  /// In every cycle: what became visible in it.
  void collect() noexcept;
  /// For an application that has seen nothing yet: the newest sample of each input.
  void restart() noexcept;
  /// The message of a turn; `given` follows where it was taken. Valid until then.
  [[nodiscard]] std::span<const std::byte> make(std::uint64_t cycle, BenchTime t) noexcept;
  void given() noexcept;
  /// It is not looked at any more.
  void release_samples() noexcept;
  /// After the last cycle: what was not shown is counted. Setup context.
  void end() noexcept;
  /// Whether the body of an answer is one to the turn of `cycle`: else nothing of it holds.
  [[nodiscard]] bool is_answer(std::span<const std::byte> body, std::uint64_t cycle) const noexcept;
  /// Gives the commands of such an answer.
  void command(std::span<const std::byte> body, BenchTime t) noexcept;

  ApplicationFacts facts;

 private:
  struct Input {
    const SamplePort* port = nullptr;
    bool by_place = false;  ///< pictures, scans: shown where they lie, the newest of a turn alone
    bool again = false;     ///< `next` was counted already
    SampleLease next;       ///< not shown yet
    SampleLease shown;      ///< may be looked at until a newer one is shown
  };
  void add(std::uint32_t input, const SampleLease& sample) noexcept;
  [[nodiscard]] std::uint64_t forget() noexcept;

  PlaceOf place_of_;
  std::vector<Input> inputs_;
  std::vector<CommandPort*> outputs_;
  std::vector<std::size_t> values_of_output_;
  TurnMessage message_;
  std::uint32_t again_ = 0;  ///< samples in the message that were counted already
};

}  // namespace rigor::application
