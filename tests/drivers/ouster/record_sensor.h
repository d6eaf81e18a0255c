// A recording of an emulated sensor, in fragments as on the wire, and its metadata.
#pragma once

#include <fstream>
#include <functional>
#include <memory>
#include <string>

#include "drivers/network/pcap_file.h"
#include "drivers/ouster/sensor_control.h"
#include "tests/drivers/ouster/made_sensor.h"

namespace rigor::ouster::test {

struct Recorded {
  std::uint64_t frames = 1;
  LidarMode mode{512, 10};
  std::uint64_t start_ns = 0;  ///< the sensor's time when it begins
  std::function<bool(std::uint64_t frame, std::uint32_t slot)> lost = {};  ///< packets that are missing
};

/// False where a file cannot be written.
inline bool record_sensor(const std::string& pcap, const std::string& metadata, const Recorded& what) {
  auto device = SensorDevice::create(std::make_shared<FormulaLidar>(what.mode));
  if (!device) return false;
  auto control = SensorControl::create(*device, {}, "{}", MonotonicTime(0));
  auto writer = network::PcapWriter::create(pcap);
  if (!control || !writer) return false;
  std::ofstream json(metadata);
  json << control->http("GET", "/api/v1/sensor/metadata", "", "", MonotonicTime(1)).body;
  const Metadata& m = control->active().metadata;
  LidarPacketWriter packet(layout_of(m));
  auto scan = device->make_scan();
  if (!device->measure(0, BenchTime(0), {}, scan)) return false;
  for (std::uint64_t f = 0; f < what.frames; ++f)
    for (std::uint32_t slot = 0; slot < m.slots(); ++slot) {
      if (what.lost && what.lost(f, slot)) continue;
      device->compose(f, slot, &scan, m, what.start_ns, packet);
      writer->write(RealtimeTime(1'700'000'000'000'000'000 + device->filled(f, slot, m).ns()),
                    {0x7F000001, 0x7F000001, kLidarPort, kLidarPort, packet.bytes()});
    }
  return static_cast<bool>(json.flush());
}

}  // namespace rigor::ouster::test
