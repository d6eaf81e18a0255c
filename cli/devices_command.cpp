#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "builtin/registry.h"
#include "cli/commands.h"

namespace rigor {

int devices_command(const DeviceOptions& options) {
  const auto registry = make_registry(options.plugins);
  if (!registry) return report_error(registry.error(), options.json);
  nlohmann::json list = nlohmann::json::array();
  for (const auto& [name, backend] : registry->all()) {
    if (!backend.find_devices) continue;
    const auto found = backend.find_devices();
    if (!options.json) fmt::print("{} ({}): {}\n", name, backend.summary, found.empty() ? "none found" : "");
    for (const FoundDevice& d : found) {
      list.push_back(
          {{"backend", d.backend}, {"id", d.id}, {"description", d.description}, {"address", d.address}});
      if (!options.json) fmt::print("  {:<28} {:<16} {}\n", d.id, d.address, d.description);
    }
  }
  if (options.json) fmt::print("{}\n", json_text(nlohmann::json{{"devices", list}}));
  return 0;
}

}  // namespace rigor
