// An application that looks at nothing and gives commands by the clock: for trying devices and rigs.
//
//   application:
//     name: script
//     sinks:
//       drive:                                    # a sink of the rig
//         rate_hz: 20                             # each command is given again so often; default 20
//         repeat_s: 8                             # begin anew after so long; never where it is not given
//         steps:
//           - { at_s: 0, values: [0.5, 0] }       # in the order of the sink's values, from at_s on
//           - { at_s: 4, values: [0, 0.4] }
#pragma once

#include <memory>

#include "sensor-hal/channel/application.h"

namespace rigor {
[[nodiscard]] std::unique_ptr<Application> make_script();
}
