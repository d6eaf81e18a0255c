// An FMU in a process of its own: what it does to its memory, and how it ends, is its own affair.
//
// The process is `rigor fmu-host`, of the same user and with the same rights: it keeps a defect of an FMU
// away from the run, it is no guard against an FMU that means harm.
#pragma once

#include <atomic>
#include <memory>

#include "rt-core/stop.h"
#include "rt-core/time.h"
#include "sim/fmu/fmu_instance.h"

namespace rigor::plant {

struct ProcessLimits {
  Duration start = seconds(30);  ///< until it is initialised
  Duration answer = seconds(5);  ///< for one step: longer, and it hangs
  /// True: a step is not waited for any longer. Outlives the instance; null: nobody interrupts.
  const std::atomic<bool>* interrupted = nullptr;
};

/// As fmu::load_instance. The process ends with the instance, and with the thread that made it. unavailable:
/// it ended, with the signal; timeout: it hangs, and was killed. Setup context; `step` on any one thread.
[[nodiscard]] Result<std::unique_ptr<fmu::FmuInstance>> start_instance(
    const fmu::ModelDescription& description, const fmu::InstanceSetup& setup, const ProcessLimits& limits,
    StopToken stop);

}  // namespace rigor::plant
