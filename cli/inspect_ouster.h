// `rigor inspect` of a recording of an Ouster.
#pragma once

#include "cli/commands.h"

namespace rigor {

/// `metadata`: the sensor's, as JSON.
int inspect_ouster_command(const InspectOptions& options, const std::filesystem::path& metadata);

}  // namespace rigor
