#include "drivers/ouster/ouster_backend.h"

#include "drivers/lidar/packet_backend.h"
#include "drivers/ouster/ouster_emulator.h"
#include "drivers/ouster/ouster_source.h"
#include "drivers/ouster/ouster_virtual_source.h"

namespace rigor {
namespace {

std::vector<DoctorFinding> ouster_doctor() {
  return {packet_lidar::find_socket_buffer(ouster::SourceSettings{}.socket_buffer_bytes, 24832,
                                           "a quarter of a second of an Ouster with 128 beams",
                                           "an Ouster with 128 beams")};
}

}  // namespace

Backend ouster_backend() {
  auto b = packet_lidar::make_backend<ouster::OusterSource, ouster::OusterEmulator, ouster::VirtualSource>(
      "ouster", "Ouster OS0, OS1 and OS2: UDP packets and their recordings, HTTP, and an emulated device");
  b.gives_typed_samples = true;
  b.doctor = ouster_doctor;
  return b;
}

}  // namespace rigor
