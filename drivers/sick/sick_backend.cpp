#include "drivers/sick/sick_backend.h"

#include "drivers/sick/sick_emulator.h"
#include "drivers/sick/sick_source.h"
#include "drivers/sick/sick_virtual_source.h"

namespace rigor {

Backend sick_backend() {
  Backend b;
  b.name = "sick";
  b.summary = "SICK LMS1xx, LMS5xx, TiM: scans by CoLa-B over TCP, as source and emulated device";
  b.make_source = [] { return std::make_unique<sick::SickSource>(); };
  b.make_emulator = [] { return std::make_unique<sick::SickEmulator>(); };
  b.make_virtual_source = [](DeviceParts parts, ConfigNode params) -> Result<std::unique_ptr<Source>> {
    return std::make_unique<sick::SickVirtualSource>(std::move(parts), std::move(params));
  };
  // A scanner has to be logged in to by its address; knocking at every address of a network is not what a
  // bench may do unasked.
  b.find_devices = [] { return std::vector<FoundDevice>{}; };
  b.doctor = [] {
    return std::vector<DoctorFinding>{
        {DoctorFinding::Level::good, "SICK scanners need TCP alone: no driver, no right, no port below 1024",
         ""}};
  };
  return b;
}

}  // namespace rigor
