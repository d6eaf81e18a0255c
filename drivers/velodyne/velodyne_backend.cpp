#include "drivers/velodyne/velodyne_backend.h"

#include <poll.h>

#include <fstream>
#include <map>
#include <memory>

#include "drivers/velodyne/velodyne_emulator.h"
#include "drivers/velodyne/velodyne_source.h"
#include "drivers/velodyne/velodyne_virtual_source.h"

namespace rigor {
namespace {

using namespace velodyne;

constexpr std::int64_t kWantedSocketBuffer = 2 << 20;

/// Who sends to this machine, heard for a while: these devices announce themselves in no other way.
std::vector<FoundDevice> listen_for_devices() {
  std::vector<FoundDevice> found;
  network::UdpReceiver socket;
  if (!socket.open("0.0.0.0", kDataPort, 1 << 20)) return found;
  struct Heard {
    ModelEvidence evidence;
    std::uint8_t product = 0;
    std::uint64_t packets = 0;
  };
  std::map<std::uint32_t, Heard> senders;
  const MonotonicTime until = monotonic_now() + milliseconds(400);
  while (monotonic_now() < until && senders.size() < 64) {
    pollfd p{socket.fd(), POLLIN, 0};
    (void)::poll(&p, 1, 50);
    for (const auto& d : socket.receive(read_epoch())) {
      PacketFault fault{};
      const auto packet = DataPacket::parse(d.bytes, fault);
      if (!packet) continue;
      Heard& h = senders[d.source_ipv4];
      h.evidence.add(*packet);
      h.product = packet->product();
      ++h.packets;
    }
  }
  for (const auto& [ip, h] : senders) {
    const auto model = h.evidence.model() ? h.evidence.model() : model_of(h.product);
    const std::string address = network::text_of_ipv4(ip);
    found.push_back(
        {"velodyne", address, model ? std::string(facts_of(*model).name) : "of no known model", address});
  }
  return found;
}

std::vector<DoctorFinding> doctor() {
  std::int64_t most = 0;
  std::ifstream("/proc/sys/net/core/rmem_max") >> most;
  const std::string now = std::to_string(most / 1024);
  if (most >= kWantedSocketBuffer)
    return {{DoctorFinding::Level::good, "socket buffers up to " + now + " KiB: a second of Velodyne packets",
             ""}};
  return {{DoctorFinding::Level::note,
           "socket buffers are limited to " + now + " KiB: " + std::to_string(most / 2300) +
               " Velodyne packets, so a thread that is held up for longer loses some",
           "sudo sysctl -w net.core.rmem_max=" + std::to_string(kWantedSocketBuffer)}};
}

}  // namespace

Backend velodyne_backend() {
  Backend b;
  b.name = "velodyne";
  b.summary = "Velodyne VLP-16 and HDL-32E: UDP packets and their recordings, and an emulated device";
  b.make_source = [] { return std::make_unique<VelodyneSource>(); };
  b.make_emulator = [] { return std::make_unique<VelodyneEmulator>(); };
  b.make_virtual_source = [](DeviceParts parts, ConfigNode params) -> Result<std::unique_ptr<Source>> {
    return std::make_unique<VirtualSource>(std::move(parts), std::move(params));
  };
  b.reads_recording = [](const ConfigNode& params) { return params.has("file"); };
  b.find_devices = listen_for_devices;
  b.doctor = doctor;
  return b;
}

}  // namespace rigor
