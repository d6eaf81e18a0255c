// A run with something to expect of each kind: a robot, its true pose, an inertial sensor with an outage, an
// estimate.
#pragma once

#include <string>
#include <vector>

#include "tests/cli/runs_fixture.h"

namespace rigor::test {

class Expect : public Runs {
 protected:
  /// A robot that drives straight on from 0.5 s, its true pose, an inertial sensor that loses every sample
  /// between 0.6 and 0.7 s, and an estimate that says that the robot stands still.
  [[nodiscard]] std::string rig(const std::string& expect) const {
    return "name: expecting\nduration_s: 1\nclock: virtual\nloop: { rate_hz: 1000 }\n"
           "simulation:\n  world: " +
           config("worlds/testbed.yaml") +
           "\n  platforms:\n    robot: { kind: skid-steer, model: " + config("platforms/seekurjr.yaml") +
           ", T_world_start: { position_m: [-1.2, -2.6], yaw_deg: 0 } }\n"
           "channels:\n"
           "  truth: { kind: pose, backend: simulated, platform: robot, rate_hz: 100, latency_ms: 5 }\n"
           "  imu: { kind: imu, backend: simulated, rate_hz: 100, latency_ms: 4, sensor: " +
           config("sensors/imu-mems.yaml") +
           ", T_world_sensor: { position_m: [2, 0, 0.5], quaternion_wxyz: [1, 0, 0, 0] },\n"
           "         faults: [ { kind: drop, from_s: 0.6, until_s: 0.7 } ] }\n"
           "sinks:\n"
           "  drive: { backend: simulated, platform: robot, latency_ms: 10, signals: [v, w], safe: { v: 0, "
           "w: 0 } }\n"
           "  estimate: { backend: log, signals: [x, y, yaw] }\n"
           "application:\n  name: script\n  sinks:\n"
           "    drive: { rate_hz: 20, steps: [ { at_s: 0, values: [0, 0] }, { at_s: 0.5, values: [1, 0] } ] "
           "}\n"
           "    estimate: { rate_hz: 50, steps: [ { at_s: 0, values: [-1.2, -2.6, 0] } ] }\n"
           "expect:\n" +
           expect;
  }
  Said run(const std::string& expect, std::vector<std::string> more = {}) const {
    write_file(dir / "rig.yaml", rig(expect));
    more.insert(more.begin(), {"run", "rig.yaml", "--json"});
    return rigor(std::move(more), dir.path());
  }
};

}  // namespace rigor::test
