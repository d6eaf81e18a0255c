// The UDP datagram in a captured frame, and frames around a datagram: what stands between a pcap file and the
// packets of a device.
//
// Ethernet (with VLAN tags), Linux cooked (SLL), raw IP and BSD loopback; IPv4 and IPv6, whole or in
// fragments (RFC 791, RFC 8200). Link types: tcpdump.org/linktypes.html.
//
//   UdpReassembler frames(link_type);
//   if (const auto datagram = frames.take(frame, stamp)) …      // whole, or its last fragment has come
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "rt-core/time.h"

namespace rigor::network {

/// "192.168.1.201"; `ipv4` in host order.
[[nodiscard]] std::string text_of_ipv4(std::uint32_t ipv4);

struct UdpDatagram {
  std::uint32_t source_ipv4 = 0, destination_ipv4 = 0;  ///< host order; 0: IPv6
  std::uint16_t source_port = 0, destination_port = 0;
  std::span<const std::uint8_t> payload;
};

inline constexpr int kLinkNull = 0, kLinkEthernet = 1, kLinkRaw = 101, kLinkSll = 113;

/// Whether frames of this link type are understood.
[[nodiscard]] bool knows_link_type(int link_type) noexcept;
/// Empty: no whole UDP datagram; a fragment is none. Any thread, no allocation.
[[nodiscard]] std::optional<UdpDatagram> udp_of_frame(int link_type,
                                                      std::span<const std::uint8_t> frame) noexcept;
/// Ethernet frames with IPv4 and UDP headers and their checksums, as broadcast by a device: one, or the
/// fragments of a datagram that is longer than a frame of `kMtu`. `identification`: of the datagram.
/// Precondition: at most 65507 bytes.
[[nodiscard]] std::vector<std::vector<std::uint8_t>> ethernet_frames(const UdpDatagram& datagram,
                                                                     std::uint16_t identification);
inline constexpr std::size_t kMtu = 1500;

/// Datagrams from frames in the order of their capture, put together again where they came in fragments, in
/// whatever order. A datagram of which nothing came for 2 s, or that is one of more than kOpen at a time, is
/// given up; so is one whose fragments overlap or do not fit (RFC 5722). One thread.
class UdpReassembler {
 public:
  static constexpr std::size_t kOpen = 16;
  struct Counters {
    std::uint64_t fragments = 0;  ///< frames that held one
    std::uint64_t datagrams = 0;  ///< put together
    std::uint64_t given_up = 0;   ///< datagrams, so far; those that are still open do not count
  };

  explicit UdpReassembler(int link_type) : link_type_(link_type) {}
  /// `t`: the frame's stamp. Empty: no UDP datagram, or one that is not whole yet. Valid until the next call
  /// and while the frame is.
  [[nodiscard]] std::optional<UdpDatagram> take(std::span<const std::uint8_t> frame, RealtimeTime t);
  [[nodiscard]] const Counters& counters() const noexcept { return counters_; }

 private:
  struct Key {
    std::array<std::uint8_t, 16> source{}, destination{};
    std::uint32_t identification = 0;
    bool operator==(const Key&) const = default;
  };
  struct Part {
    std::uint32_t begin, end;
  };
  struct Open {
    Key key;
    RealtimeTime heard;
    std::vector<std::uint8_t> bytes;
    std::vector<Part> parts;   ///< in order, apart from each other
    std::uint32_t length = 0;  ///< 0: the last fragment has not come
  };

  int link_type_;
  std::vector<Open> open_;
  std::vector<std::uint8_t> whole_;
  Counters counters_;
};

}  // namespace rigor::network
