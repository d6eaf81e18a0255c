#include "builtin/registry.h"

#include "apps/forest-localization/forest_localization.h"
#include "apps/forest-localization/stem_map.h"
#include "apps/script/script.h"
#include "apps/stereo-depth/stereo_depth.h"
#include "apps/turntable-sweep/turntable_sweep.h"
#include "bench/analysis/localization_analysis.h"
#include "bridges/ros2/ros2_bridge.h"
#include "drivers/aravis/aravis_backend.h"
#include "drivers/can/can_backend.h"
#include "drivers/gnss/gnss_backend.h"
#include "drivers/livox/livox_backend.h"
#include "drivers/modbus/modbus_backend.h"
#include "drivers/ouster/ouster_backend.h"
#include "drivers/serial/serial_ports.h"
#include "drivers/sick/sick_backend.h"
#include "drivers/usb/usb_backend.h"
#include "drivers/v4l2/v4l2_backend.h"
#include "drivers/velodyne/velodyne_backend.h"
#include "sensor-hal/channel/log_sink.h"
#include "sensor-hal/plugin/plugin.h"
#include "sensor-hal/record/replay_source.h"

namespace rigor {
namespace {

/// The table of stems that forest-localization reads.
Result<std::vector<DrawnStem>> read_stems(const std::filesystem::path& file) {
  const auto map = forest::StemMap::load(file);
  if (!map) return tl::unexpected<Error>(map.error());
  std::vector<DrawnStem> stems;
  for (const forest::Stem& s : map->stems()) stems.push_back({s.x_m, s.y_m, s.radius_m});
  return stems;
}

}  // namespace

Registry make_registry() {
  Registry registry;
  registry.add(aravis_backend());
  registry.add(can_backend());
  registry.add(gnss_backend());
  registry.add(livox_backend());
  registry.add(modbus_backend());
  registry.add(ouster_backend());
  registry.add(serial_backend());
  registry.add(sick_backend());
  registry.add(usb_backend());
  registry.add(v4l2_backend());
  registry.add(velodyne_backend());
  registry.add(log_backend());
  registry.add(replay_backend());
  registry.add(ros2_backend());
  registry.add(NamedApplication{"forest-localization", make_forest_localization});
  registry.add(NamedApplication{"script", make_script});
  registry.add(stereo_depth_application());
  registry.add(NamedApplication{"turntable-sweep", make_turntable_sweep});
  registry.add(localization_analysis(read_stems));
  registry.add(ros2_bridge());
  return registry;
}

Result<Registry> make_registry(const std::vector<std::filesystem::path>& plugins) {
  Registry registry = make_registry();
  std::vector<NamedFile> named;
  for (const auto& file : plugins) named.push_back({file, "--plugin"});
  if (auto s = load_plugins(named, registry); !s) return tl::unexpected<Error>(s.error());
  return registry;
}

}  // namespace rigor
