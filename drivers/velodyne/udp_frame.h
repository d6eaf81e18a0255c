// The UDP datagram in a captured frame, and frames around a datagram: what stands between a pcap file and the
// packets of a device.
//
// Ethernet (with VLAN tags), Linux cooked (SLL), raw IP and BSD loopback; IPv4 whole (a fragment is none of
// ours) and IPv6 without extension headers. Link types: tcpdump.org/linktypes.html.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace rigor::velodyne {

struct UdpDatagram {
  std::uint32_t source_ipv4 = 0, destination_ipv4 = 0;  ///< host order; 0: IPv6
  std::uint16_t source_port = 0, destination_port = 0;
  std::span<const std::uint8_t> payload;
};

inline constexpr int kLinkNull = 0, kLinkEthernet = 1, kLinkRaw = 101, kLinkSll = 113;

/// Whether frames of this link type are understood.
[[nodiscard]] bool knows_link_type(int link_type) noexcept;
/// Empty: no whole UDP datagram. Any thread, no allocation.
[[nodiscard]] std::optional<UdpDatagram> udp_of_frame(int link_type,
                                                      std::span<const std::uint8_t> frame) noexcept;
/// An Ethernet frame with IPv4 and UDP headers and their checksums, as broadcast by a device.
[[nodiscard]] std::vector<std::uint8_t> ethernet_frame(const UdpDatagram& datagram);

}  // namespace rigor::velodyne
