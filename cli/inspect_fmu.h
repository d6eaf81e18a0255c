// `rigor inspect` of an FMU: variables, units, capabilities.
#pragma once

#include "cli/commands.h"

namespace rigor {

/// Whether a file is taken for an FMU: by its name.
[[nodiscard]] bool is_fmu(const std::filesystem::path& file);
int inspect_fmu_command(const InspectOptions& options);

}  // namespace rigor
