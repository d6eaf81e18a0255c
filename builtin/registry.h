// What comes with Rigor, by name: drivers, the backends `log` and `replay`, applications and analyses. The
// only place that knows all of them; the bench itself knows none.
//
//   rigor::Registry registry = rigor::make_registry();
//   registry.add(rigor::NamedApplication{"detector", [] { return std::make_unique<Detector>(); }});
#pragma once

#include <filesystem>
#include <vector>

#include "sensor-hal/channel/registry.h"

namespace rigor {

/// A registry of one's own: what is added or replaced there stays there. Setup context.
[[nodiscard]] Registry make_registry();
/// The same with what these plugins add (sensor-hal/plugin/plugin.h), in this order; an error names the file
/// as one of `--plugin`. Setup context.
[[nodiscard]] Result<Registry> make_registry(const std::vector<std::filesystem::path>& plugins);

}  // namespace rigor
