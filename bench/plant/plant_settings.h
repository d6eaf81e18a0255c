// A plant of a rig, as its section says:
//
//   plants:
//     ball:
//       fmu: ../plants/BouncingBall.fmu
//       step_ms: 10              # communication step; default: the FMU's own (DefaultExperiment), else 10
//       start_time_s: 0          # default: the FMU's own, else 0
//       start_values: { e: 0.8, g: -1.62, x0: "1 2 3" }
//       signals:                 # default: every numeric input and output, by its name
//         height: { variable: h, unit: cm, type: Float64, causality: output, variability: continuous }
//         speed: v               # short for { variable: v }
//         gain: { variable: k, commanded: true }    # a tunable parameter
//         flow: { variable: pipe.flow }             # member `flow` of the terminal `pipe`
//         y: { variable: y }                        # an array: y[1], y[2], …
//       sandbox: true            # false: in this process
//       deadline_ms: 10          # wall clock: for one step, from the instant at which it begins; default:
//       the step answer_timeout_s: 5      # a step that takes longer hangs: the process is killed
//       start_timeout_s: 30      # until it is initialised
//       on_fault: disconnect     # or restart
//       restart_after_ms: 100    # bench time
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "bench/plant/fmu_process.h"
#include "rt-core/time.h"
#include "sensor-hal/rig/rig.h"
#include "sim/fmu/model_description.h"
#include "sim/fmu/units.h"

namespace rigor::plant {

/// A value that the rig names.
struct PlantSignal {
  std::string name, unit;
  bool commanded = false;
  std::size_t position = 0;  ///< among the values of the inputs (commanded) or outputs
  fmu::VariableType type = fmu::VariableType::float64;
  fmu::Conversion conversion;   ///< from the variable's unit to the signal's
  double register_step = 1e-3;  ///< of its register, in its unit
};

struct PlantSettings {
  std::string name;
  std::filesystem::path file;
  Duration step, deadline, restart_after;
  double start_time_s = 0;
  bool sandbox = true, restart = false;
  ProcessLimits limits;
  fmu::StartValues start_values;
  std::vector<PlantSignal> signals;
  std::vector<std::size_t> inputs, outputs;  ///< variables of the FMU
  std::vector<double> input_start;           ///< values of the inputs at the start
};

/// Checks the section against the FMU; structural parameters among the start values change the description.
/// Throws ConfigError that names the variables that there are.
[[nodiscard]] PlantSettings read_plant(const PlantEntry& entry, fmu::ModelDescription& description);
/// Only the file, for whoever has to unpack it first.
[[nodiscard]] std::filesystem::path fmu_file_of(const PlantEntry& entry);

}  // namespace rigor::plant
