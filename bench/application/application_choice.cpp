#include "bench/application/application_choice.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "bench/application/plugin_application.h"
#include "bench/application/process_application.h"
#include "sensor-hal/config/did_you_mean.h"

namespace rigor {

Result<std::unique_ptr<Application>> make_application(const RigConfig& rig, const Registry& registry) {
  if (rig.application.empty()) return std::unique_ptr<Application>{};
  if (rig.application_params.has("library")) return make_plugin_application(rig);
  if (rig.application_params.has("command")) return make_process_application(rig);
  const NamedApplication* known = registry.find_application(rig.application);
  if (known) return known->make();
  const std::vector<std::string> names = registry.application_names();
  return tl::unexpected<Error>(
      rig.application_params
          .error("name", fmt::format("expected one of {}, got \"{}\"{}", fmt::join(names, ", "),
                                     rig.application, did_you_mean(rig.application, names)))
          .error());
}

}  // namespace rigor
