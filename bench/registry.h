// What comes with Rigor, by name: backends, applications and analyses; and what plugins add to it.
#pragma once

#include "sensor-hal/channel/registry.h"
#include "sensor-hal/config/named_file.h"

namespace rigor {

[[nodiscard]] Registry make_registry();

/// Loads each of them (sensor-hal/plugin/plugin.h), in this order. Errors of load_plugin, with the place that
/// names the file. Setup thread.
[[nodiscard]] Status load_plugins(const std::vector<NamedFile>& files, Registry& registry);
/// What comes with Rigor and what these bring, which the option `--plugin` of a command names.
[[nodiscard]] Result<Registry> make_registry(const std::vector<std::filesystem::path>& plugins);

}  // namespace rigor
