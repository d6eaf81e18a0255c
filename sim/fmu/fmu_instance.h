// An FMU at work: initialised at its start time, stepped from instant to instant.
//
// Two kinds behind one interface: in this process (load_instance), and in a process of its own (bench/plant).
#pragma once

#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sim/fmu/unpacked_fmu.h"

namespace rigor::fmu {

class FmuInstance {
 public:
  virtual ~FmuInstance() = default;
  /// From t to t + step. `inputs` are set first where `inputs_changed`; `outputs` are those at t + step.
  /// protocol or unavailable: the FMU failed, with what it said; it is then of no more use. One thread at a
  /// time.
  [[nodiscard]] virtual Status step(double t_s, double step_s, std::span<const double> inputs,
                                    bool inputs_changed, std::span<double> outputs) = 0;
  /// Outputs at the instant that it has reached.
  [[nodiscard]] virtual Status read(std::span<double> outputs) = 0;
};

struct InstanceSetup {
  std::string name;              ///< of the plant, for the FMU and for messages
  std::filesystem::path folder;  ///< of an UnpackedFmu
  double start_time_s = 0;
  StartValues start_values;
  std::vector<std::size_t> inputs, outputs;  ///< variables, by their index in the description
};
/// How many values inputs or outputs have: elements of all their variables, one after another.
[[nodiscard]] std::size_t values_of(const ModelDescription& description,
                                    std::span<const std::size_t> variables);

/// Instantiates and initialises in this process. `description`: with the structural parameters of the setup.
/// unavailable: cannot be loaded; protocol: it failed; bad_input: a start value that it does not take. What
/// it logs from warnings on goes to stderr. Setup context.
[[nodiscard]] Result<std::unique_ptr<FmuInstance>> load_instance(const ModelDescription& description,
                                                                 const InstanceSetup& setup);

}  // namespace rigor::fmu
