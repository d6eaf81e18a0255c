// The C interface of FMUs, as far as Rigor calls it.
//
// Declared after the headers of the FMI Standard, versions 2.0.4 (fmi2TypesPlatform.h, fmi2FunctionTypes.h)
// and 3.0.2 (fmi3PlatformTypes.h, fmi3FunctionTypes.h): https://github.com/modelica/fmi-standard, Copyright
// (C) 2008-2011 MODELISAR consortium, 2012-2024 Modelica Association Project "FMI", 2-Clause BSD License.
// Types and order of arguments are theirs; the names are Rigor's.
#pragma once

#include <cstddef>
#include <cstdint>

namespace rigor::fmu {

using ValueReference = std::uint32_t;

/// fmi2Status and fmi3Status have the same values; `pending` is of FMI 2 alone.
enum FmiStatus : int { kFmiOk, kFmiWarning, kFmiDiscard, kFmiError, kFmiFatal, kFmiPending };

extern "C" {

// FMI 2.0
using Fmi2Logger = void (*)(void* environment, const char* instance, int status, const char* category,
                            const char* message, ...);
struct Fmi2Callbacks {
  Fmi2Logger logger;
  void* (*allocate)(std::size_t count, std::size_t size);
  void (*free)(void* memory);
  void (*step_finished)(void* environment, int status);
  void* environment;
};
using Fmi2Instantiate = void* (*)(const char* name, int type, const char* guid, const char* resources_uri,
                                  const Fmi2Callbacks* callbacks, int visible, int logging);
using FmiFreeInstance = void (*)(void* instance);
using Fmi2SetupExperiment = int (*)(void* instance, int tolerance_defined, double tolerance, double start,
                                    int stop_defined, double stop);
/// EnterInitializationMode of FMI 2; ExitInitializationMode, Terminate, EnterEventMode and the like of both.
using FmiPlain = int (*)(void* instance);
using Fmi2DoStep = int (*)(void* instance, double t, double step, int no_set_state_before);
using Fmi2GetBooleanStatus = int (*)(void* instance, int kind, int* value);

// FMI 3.0
using Fmi3Logger = void (*)(void* environment, int status, const char* category, const char* message);
using Fmi3InstantiateCoSimulation = void* (*)(const char* name, const char* token, const char* resources_path,
                                              bool visible, bool logging, bool event_mode_used,
                                              bool early_return_allowed, const ValueReference* intermediate,
                                              std::size_t intermediate_count, void* environment,
                                              Fmi3Logger logger, void* intermediate_update);
using Fmi3EnterInitializationMode = int (*)(void* instance, bool tolerance_defined, double tolerance,
                                            double start, bool stop_defined, double stop);
using Fmi3UpdateDiscreteStates = int (*)(void* instance, bool* need_update, bool* terminate,
                                         bool* nominals_changed, bool* states_changed,
                                         bool* next_event_defined, double* next_event);
using Fmi3DoStep = int (*)(void* instance, double t, double step, bool no_set_state_before,
                           bool* event_needed, bool* terminate, bool* early_return, double* last_successful);

}  // extern "C"

/// fmi2CoSimulation of fmi2Type, fmi2Terminated of fmi2StatusKind.
inline constexpr int kFmi2CoSimulation = 1;
inline constexpr int kFmi2Terminated = 3;

}  // namespace rigor::fmu
