#include "drivers/livox/livox_backend.h"

#include <algorithm>

#include "drivers/lidar/packet_backend.h"
#include "drivers/livox/livox_emulator.h"
#include "drivers/livox/livox_source.h"
#include "drivers/livox/livox_virtual_source.h"

namespace rigor {
namespace {

std::vector<FoundDevice> find_livox() {
  std::vector<FoundDevice> found;
  // Broadcasts do not reach this machine's loopback, where emulators are.
  for (const char* to : {"255.255.255.255", "127.0.0.1"})
    for (const livox::FoundLidar& f : livox::search_lidars(to, livox::kSearchPort, milliseconds(200))) {
      const auto same = [&](const FoundDevice& d) { return d.id == f.serial; };
      if (std::any_of(found.begin(), found.end(), same)) continue;
      found.push_back(
          {"livox", f.serial,
           f.type == livox::kMid360Type ? std::string("Mid-360") : "of device type " + std::to_string(f.type),
           f.address});
    }
  return found;
}

std::vector<DoctorFinding> livox_doctor() {
  return {packet_lidar::find_socket_buffer(livox::SourceSettings{}.socket_buffer_bytes, 2304,
                                           "a third of a second of a Livox Mid-360's points",
                                           "a Livox Mid-360")};
}

}  // namespace

Backend livox_backend() {
  auto b = packet_lidar::make_backend<livox::LivoxSource, livox::LivoxEmulator, livox::VirtualSource>(
      "livox", "Livox Mid-360: UDP packets and their recordings, commands, and an emulated device");
  b.gives_typed_samples = true;
  b.find_devices = find_livox;
  b.doctor = livox_doctor;
  return b;
}

}  // namespace rigor
