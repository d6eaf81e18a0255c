#include "drivers/livox/livox_backend.h"

#include <algorithm>
#include <fstream>
#include <memory>

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
  std::int64_t most = 0;
  std::ifstream("/proc/sys/net/core/rmem_max") >> most;
  const std::int64_t wanted = livox::SourceSettings{}.socket_buffer_bytes;
  const std::string now = std::to_string(most / 1024);
  if (most >= wanted)
    return {{DoctorFinding::Level::good,
             "socket buffers up to " + now + " KiB: a third of a second of a Livox Mid-360's points", ""}};
  return {{DoctorFinding::Level::note,
           "socket buffers are limited to " + now + " KiB: " + std::to_string(most / 2304) +
               " packets of a Livox Mid-360, so a thread that is held up for longer loses some",
           "sudo sysctl -w net.core.rmem_max=" + std::to_string(wanted)}};
}

}  // namespace

Backend livox_backend() {
  Backend b;
  b.name = "livox";
  b.summary = "Livox Mid-360: UDP packets and their recordings, commands, and an emulated device";
  b.make_source = [] { return std::make_unique<livox::LivoxSource>(); };
  b.make_emulator = [] { return std::make_unique<livox::LivoxEmulator>(); };
  b.make_virtual_source = [](DeviceParts parts, ConfigNode params) -> Result<std::unique_ptr<Source>> {
    return std::make_unique<livox::VirtualSource>(std::move(parts), std::move(params));
  };
  b.reads_recording = [](const ConfigNode& params) { return params.has("file"); };
  b.gives_typed_samples = true;
  b.files = [](const ConfigNode& params) {
    std::vector<std::filesystem::path> files;
    if (params.has("pcap")) files.emplace_back(params.text("pcap"));
    return files;
  };
  b.find_devices = find_livox;
  b.doctor = livox_doctor;
  return b;
}

}  // namespace rigor
