// `rigor inspect` of a recording of a Livox Mid-360.
#pragma once

#include "cli/commands.h"

namespace rigor {

int inspect_livox_command(const InspectOptions& options);

}  // namespace rigor
