#include "bench/run/backends.h"

#include "drivers/aravis/aravis_backend.h"
#include "drivers/can/can_backend.h"
#include "drivers/modbus/modbus_backend.h"
#include "drivers/sick/sick_backend.h"
#include "drivers/usb/usb_backend.h"
#include "drivers/v4l2/v4l2_backend.h"
#include "drivers/velodyne/velodyne_backend.h"

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
  return registry;
}

}  // namespace rigor
