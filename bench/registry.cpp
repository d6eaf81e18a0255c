#include "bench/registry.h"

#include "apps/forest-localization/forest_localization.h"
#include "apps/script/script.h"
#include "apps/stereo-depth/stereo_depth.h"
#include "apps/turntable-sweep/turntable_sweep.h"
#include "bench/analysis/localization_analysis.h"
#include "drivers/aravis/aravis_backend.h"
#include "drivers/can/can_backend.h"
#include "drivers/modbus/modbus_backend.h"
#include "drivers/sick/sick_backend.h"
#include "drivers/usb/usb_backend.h"
#include "drivers/v4l2/v4l2_backend.h"
#include "drivers/velodyne/velodyne_backend.h"
#include "sensor-hal/plugin/plugin.h"

namespace rigor {

Registry make_registry() {
  Registry registry;
  registry.add(aravis_backend());
  registry.add(can_backend());
  registry.add(modbus_backend());
  registry.add(sick_backend());
  registry.add(usb_backend());
  registry.add(v4l2_backend());
  registry.add(velodyne_backend());
  registry.add(NamedApplication{"forest-localization", make_forest_localization});
  registry.add(NamedApplication{"script", make_script});
  registry.add(stereo_depth_application());
  registry.add(NamedApplication{"turntable-sweep", make_turntable_sweep});
  registry.add(localization_analysis());
  return registry;
}

Status load_plugins(const std::vector<NamedFile>& files, Registry& registry) {
  for (const NamedFile& plugin : files)
    if (const auto loaded = load_plugin(plugin.file, registry); !loaded)
      return fail(loaded.error().code, plugin.named_by, loaded.error().text());
  return {};
}

}  // namespace rigor
