#include "drivers/network/pcap_file.h"
#include "tests/drivers/velodyne/formula_lidar.h"
#include "tests/drivers/velodyne/made_packets.h"

namespace rigor::velodyne::test {

void record_rotor(const std::string& file, double rotation_hz, std::uint64_t packets) {
  auto writer = network::PcapWriter::create(file);
  if (!writer) return;
  const Rotor rotor{.rotation_hz = rotation_hz};
  for (std::uint64_t k = 0; k < packets; ++k) {
    const auto w = rotor.packet(k, [](std::uint32_t firing) {
      return DataPacket::Return{static_cast<std::uint16_t>(firing % 5 == 0 ? 0 : 1000 + firing), 9};
    });
    writer->write(RealtimeTime(1'700'000'000'000'000'000 + static_cast<std::int64_t>(k + 1) * 1'327'104),
                  {0x7F000001, 0x7F000001, kDataPort, kDataPort, w.bytes()});
  }
}

}  // namespace rigor::velodyne::test
