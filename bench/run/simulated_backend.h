// The backend `simulated`: sensors that measure in the bench's world, and platforms of it that take commands.
// A rig has a world of its own, so that a backend of this name is made for each assembly.
#pragma once

#include "bench/run/bench_run.h"
#include "bench/sensing/simulation.h"
#include "bench/tune/engine_choices.h"
#include "sensor-hal/channel/registry.h"
#include "sensor-hal/channel/worker_pool.h"

namespace rigor {

inline constexpr const char* kSimulatedBackend = "simulated";

/// What simulated channels measure in and with. All of it outlives the sources and sinks.
struct SimulatedWorld {
  RunParts* parts = nullptr;         ///< rig, motion; receives the times of the sensors
  Simulation* simulation = nullptr;  ///< null: the rig names no world
  WorkerPool* workers = nullptr;
  EngineChoices renderers;  ///< by channel
};
/// Sources and sinks find what they need when they are configured. Setup context.
[[nodiscard]] Backend simulated_backend(SimulatedWorld world);

/// Whether the bench computes the motion of platform `index` of the rig: no emulator does, and no channel
/// reports it.
[[nodiscard]] bool moves_here(const RigConfig& rig, std::size_t index);

}  // namespace rigor
