// What backends of packet LiDARs have in common.
#pragma once

#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "sensor-hal/channel/registry.h"

namespace rigor::packet_lidar {

template <class LiveSource, class Emulator, class VirtualSource>
[[nodiscard]] Backend make_backend(std::string name, std::string summary) {
  Backend b;
  b.name = std::move(name);
  b.summary = std::move(summary);
  b.make_source = [] { return std::make_unique<LiveSource>(); };
  b.make_emulator = [] { return std::make_unique<Emulator>(); };
  b.make_virtual_source = [](DeviceParts parts, ConfigNode params) -> Result<std::unique_ptr<Source>> {
    return std::make_unique<VirtualSource>(std::move(parts), std::move(params));
  };
  b.reads_recording = [](const ConfigNode& params) { return params.has("file"); };
  // What an emulator sends may be recorded.
  b.files = [](const ConfigNode& params) {
    std::vector<std::filesystem::path> files;
    if (params.has("pcap")) files.emplace_back(params.text("pcap"));
    return files;
  };
  return b;
}

/// For `rigor doctor`: whether the kernel grants a socket the buffer that a channel asks for. `holds`: what
/// fits into it; `device`: whose packets have `packet_bytes`.
[[nodiscard]] inline DoctorFinding find_socket_buffer(std::int64_t wanted_bytes, std::int64_t packet_bytes,
                                                      const std::string& holds, const std::string& device) {
  std::int64_t most = 0;
  std::ifstream("/proc/sys/net/core/rmem_max") >> most;
  const std::string now = std::to_string(most / 1024);
  if (most >= wanted_bytes)
    return {DoctorFinding::Level::good, "socket buffers up to " + now + " KiB: " + holds, ""};
  return {DoctorFinding::Level::note,
          "socket buffers are limited to " + now + " KiB: " + std::to_string(most / packet_bytes) +
              " packets of " + device + ", so a thread that is held up for longer loses some",
          "sudo sysctl -w net.core.rmem_max=" + std::to_string(wanted_bytes)};
}

}  // namespace rigor::packet_lidar
