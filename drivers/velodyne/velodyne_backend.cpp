#include "drivers/velodyne/velodyne_backend.h"

#include <poll.h>

#include <map>
#include <memory>

#include "drivers/lidar/packet_backend.h"
#include "drivers/velodyne/velodyne_emulator.h"
#include "drivers/velodyne/velodyne_source.h"
#include "drivers/velodyne/velodyne_virtual_source.h"

namespace rigor {
namespace {

using namespace velodyne;

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
  return {packet_lidar::find_socket_buffer(SourceSettings{}.socket_buffer_bytes, 2300,
                                           "a second of Velodyne packets", "a Velodyne")};
}

}  // namespace

Backend velodyne_backend() {
  auto b = packet_lidar::make_backend<VelodyneSource, VelodyneEmulator, VirtualSource>(
      "velodyne", "Velodyne VLP-16 and HDL-32E: UDP packets and their recordings, and an emulated device");
  b.find_devices = listen_for_devices;
  b.doctor = doctor;
  return b;
}

}  // namespace rigor
