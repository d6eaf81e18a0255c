#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "bench/console/terminal.h"
#include "bench/files/installed_configs.h"
#include "cli/commands.h"

namespace rigor {

int rigs_command(const PlainOptions& options) {
  const auto rigs = installed_rigs();
  if (rigs.empty())
    return report_error(
        {ErrorCode::not_found, "rigs",
         "expected rigs in share/rigor/configs beside the program's folder, found none; install with "
         "`cmake --install build/release --prefix DIR`"},
        options.json);
  nlohmann::json list = nlohmann::json::array();
  std::size_t width = 0;
  for (const InstalledRig& rig : rigs) {
    list.push_back({{"name", rig.name}, {"about", rig.about}, {"file", rig.file.string()}});
    width = std::max(width, rig.name.size());
  }
  if (options.json) {
    fmt::print("{}\n", json_text({{"rigs", list}}));
    return 0;
  }
  for (const InstalledRig& rig : rigs) fmt::print("{:<{}}  {}\n", rig.name, width, rig.about);
  fmt::print("\nin {}\n", installed_configs().string());
  return 0;
}

}  // namespace rigor
