// The answer of an application to a turn: whatever comes, no command has more values than its output takes,
// and none is read from beyond the message.
#include <array>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "bench/application/process_protocol.h"

using rigor::application::AnsweredCommand;
using rigor::application::AnswerReader;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  // In memory of exactly its size: a byte beyond is seen by the sanitizer.
  const std::vector<std::uint8_t> exact(data, data + size);
  static constexpr std::array<std::size_t, 3> kOutputs{2, 1, 16};
  AnswerReader reader;
  if (!reader.open(std::as_bytes(std::span(exact)))) return 0;
  AnsweredCommand command;
  std::size_t read = 0;
  while (reader.next(kOutputs, command) == AnswerReader::Next::command) {
    if (command.output >= kOutputs.size() || command.count != kOutputs[command.output]) std::abort();
    read += 8 + command.count * sizeof(double);
    if (read > size) std::abort();
  }
  return 0;
}
