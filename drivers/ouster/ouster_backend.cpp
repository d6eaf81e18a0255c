#include "drivers/ouster/ouster_backend.h"

#include <fstream>
#include <memory>

#include "drivers/ouster/ouster_emulator.h"
#include "drivers/ouster/ouster_source.h"
#include "drivers/ouster/ouster_virtual_source.h"

namespace rigor {
namespace {

std::vector<DoctorFinding> ouster_doctor() {
  std::int64_t most = 0;
  std::ifstream("/proc/sys/net/core/rmem_max") >> most;
  const std::int64_t wanted = ouster::SourceSettings{}.socket_buffer_bytes;
  const std::string now = std::to_string(most / 1024);
  if (most >= wanted)
    return {{DoctorFinding::Level::good,
             "socket buffers up to " + now + " KiB: a quarter of a second of an Ouster with 128 beams", ""}};
  return {{DoctorFinding::Level::note,
           "socket buffers are limited to " + now + " KiB: " + std::to_string(most / 24832) +
               " packets of an Ouster with 128 beams, so a thread that is held up for longer loses some",
           "sudo sysctl -w net.core.rmem_max=" + std::to_string(wanted)}};
}

}  // namespace

Backend ouster_backend() {
  Backend b;
  b.name = "ouster";
  b.summary = "Ouster OS0, OS1 and OS2: UDP packets and their recordings, HTTP, and an emulated device";
  b.make_source = [] { return std::make_unique<ouster::OusterSource>(); };
  b.make_emulator = [] { return std::make_unique<ouster::OusterEmulator>(); };
  b.make_virtual_source = [](DeviceParts parts, ConfigNode params) -> Result<std::unique_ptr<Source>> {
    return std::make_unique<ouster::VirtualSource>(std::move(parts), std::move(params));
  };
  b.reads_recording = [](const ConfigNode& params) { return params.has("file"); };
  b.gives_typed_samples = true;
  b.doctor = ouster_doctor;
  return b;
}

}  // namespace rigor
