// From a rig file to parts that can run: which source stands behind which channel, which emulator stands for
// which device when time is virtual. The only place where drivers, simulators and the HAL meet.
#pragma once

#include <memory>

#include "bench/devices/device_world.h"
#include "bench/plant/plants.h"
#include "bench/run/bench_run.h"
#include "bench/sensing/simulation.h"
#include "sensor-hal/channel/registry.h"

namespace rigor {

class WorkerPool;

/// Everything of a run, in the order in which it has to be taken down (last member first).
struct Assembly {
  std::unique_ptr<Simulation> simulation;  ///< the bench's world; null where the rig has none
  std::unique_ptr<DeviceWorld> devices;    ///< virtual time: the devices' own world
  plant::Plants plants;                    ///< those that channels and sinks name
  std::unique_ptr<WorkerPool> workers;
  std::unique_ptr<WorkerPool> fault_workers;  ///< change pictures and scans of channels with faults
  RunParts parts;
};

/// Makes and configures every channel, sink and the application. Opens no device. Setup context.
[[nodiscard]] Result<std::unique_ptr<Assembly>> assemble(RigConfig rig, const Registry& registry);

}  // namespace rigor
