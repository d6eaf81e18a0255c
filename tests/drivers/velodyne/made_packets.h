// Packets of a rotor that turns evenly.
#pragma once

#include <cmath>
#include <cstdint>

#include "drivers/velodyne/velodyne_device.h"

namespace rigor::velodyne::test {

struct Rotor {
  Model model = Model::vlp16;
  double rotation_hz = 10, azimuth_deg = 0;  ///< at packet 0
  bool dual = false;
  std::uint8_t product = 0x22;
  std::uint32_t start_us = 0;

  /// `returns(i)`: of firing i of the packet, in the order of firing. Dual: twice the same.
  template <class F>
  [[nodiscard]] DataPacketWriter packet(std::uint64_t k, F&& returns) const {
    const DeviceFacts& f = facts_of(model);
    DataPacketWriter w;
    const std::size_t step = dual ? 2 : 1;
    const double packet_s = static_cast<double>(f.packet_ns(dual)) * 1e-9;
    for (std::size_t b = 0; b < kBlocks; ++b) {
      const double t = static_cast<double>(k) * packet_s + static_cast<double>(b / step) *
                                                               f.sequences_per_block *
                                                               static_cast<double>(f.sequence_ns) * 1e-9;
      const double turn = std::fmod(azimuth_deg + 360 * rotation_hz * t, 360);
      w.set_azimuth(b, static_cast<std::uint32_t>(std::lround(turn * 100)));
      for (std::size_t c = 0; c < kChannels; ++c)
        w.set(b, c, returns(static_cast<std::uint32_t>(b / step * kChannels + c)));
    }
    const auto us =
        static_cast<std::uint64_t>(start_us) + k * static_cast<std::uint64_t>(f.packet_ns(dual)) / 1000;
    w.finish(static_cast<std::uint32_t>(us % kHour_us), dual ? ReturnMode::dual : ReturnMode::strongest,
             product);
    return w;
  }
};

}  // namespace rigor::velodyne::test
