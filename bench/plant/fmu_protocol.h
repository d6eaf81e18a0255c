// What the bench and the process of an FMU say to each other: messages of the application protocol
// (bench/application/process_protocol.h) with other bodies, in the byte order of the machine, which is one.
//
//   bench                                  process
//                          ◀── hello       JSON
//   setup ──▶                              JSON: folder, start values, indices of inputs and outputs
//                          ◀── ready       JSON; the FMU is initialised
//   turn ──▶                               StepRequest, then count × f64: all inputs
//                          ◀── commands    StepAnswer, then count × f64: all outputs
//   finish ──▶                             JSON
//
// In place of ready and commands comes `failed` with a sentence; the process then ends.
#pragma once

#include <cstddef>
#include <cstdint>

namespace rigor::plant {

struct StepRequest {
  double t_s = 0, step_s = 0;
  std::uint32_t inputs_changed = 0;
  std::uint32_t read_only = 0;  ///< no step: the outputs as they are
  std::uint32_t count = 0, padding = 0;
};
static_assert(sizeof(StepRequest) == 32);
struct StepAnswer {
  std::uint32_t count = 0, padding = 0;
};
static_assert(sizeof(StepAnswer) == 8);

/// Values in one message: 16 MiB.
inline constexpr std::size_t kMaxStepValues = std::size_t{2} << 20;

}  // namespace rigor::plant
