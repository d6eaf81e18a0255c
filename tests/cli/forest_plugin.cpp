// The reference application as somebody else's plugin.
#include <sensor-hal/plugin/plugin.h>

#include "apps/forest-localization/forest_localization.h"

namespace {
rigor::Status define(rigor::Registry& registry) {
  registry.add(rigor::NamedApplication{"forest-of-a-plugin", rigor::make_forest_localization});
  return {};
}
}  // namespace
RIGOR_PLUGIN("forest", "1.0", "forest-localization from a shared object.", define)
