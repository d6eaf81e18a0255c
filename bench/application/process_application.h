// The software under test as a process of its own, in any language:
//
//   application:
//     command: [python3, detector.py]   in the rig's folder; speaks docs/application-protocol.md
//     rate_hz: 50              turns; without it what the program asks for, or every cycle of the loop
//     params: { … }            given to the program as they are
//     on_exit: fail | restart  when it ends, hangs or breaks the protocol during the run; default fail
//     start_timeout_s: 30      until it is ready
//     answer_timeout_s: 10     a process that owes an answer for so long hangs, and is killed
//     deadline_ms: 20          wall clock: for an answer; default: until the next turn
//     on_late: hold | safe     wall clock: hold the last command (default), or let the sinks fall to their
//     safe values
//
// In virtual time bench and process go in lock step: the loop waits for the answer to each turn, so that
// neither commands nor recording depend on how quick the process is. In wall-clock time the loop never waits:
// an answer takes effect in the cycle in which it is there, a turn that is due while an answer is owed is
// left out.
#pragma once

#include <memory>

#include "sensor-hal/channel/application.h"
#include "sensor-hal/rig/rig.h"

namespace rigor {

/// `rig` has an application with `command`, and outlives what is made. From now on samples lie in memory that
/// other processes can map: to be called before channels are armed. Setup context.
[[nodiscard]] Result<std::unique_ptr<Application>> make_process_application(const RigConfig& rig);

}  // namespace rigor
