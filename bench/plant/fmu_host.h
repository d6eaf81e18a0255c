// The process of an FMU: `rigor fmu-host`, which a run starts.
#pragma once

namespace rigor::plant {

/// Serves one FMU on the socket that RIGOR_SOCKET names, until the bench says `finish` or is gone. Exit
/// status.
[[nodiscard]] int host_fmu();

}  // namespace rigor::plant
