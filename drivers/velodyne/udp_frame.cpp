#include "drivers/velodyne/udp_frame.h"

#include <algorithm>

namespace rigor::velodyne {
namespace {

using Frame = std::span<const std::uint8_t>;

constexpr std::uint32_t kIpv4 = 0x0800, kIpv6 = 0x86DD, kUdp = 17;

std::uint32_t be16(Frame f, std::size_t at) { return static_cast<std::uint32_t>(f[at] << 8 | f[at + 1]); }
std::uint32_t be32(Frame f, std::size_t at) { return be16(f, at) << 16 | be16(f, at + 2); }

std::optional<UdpDatagram> udp_of(Frame udp, UdpDatagram d) {
  if (udp.size() < 8) return {};
  const std::size_t length = be16(udp, 4);
  if (length < 8 || length > udp.size()) return {};
  d.source_port = static_cast<std::uint16_t>(be16(udp, 0));
  d.destination_port = static_cast<std::uint16_t>(be16(udp, 2));
  d.payload = udp.subspan(8, length - 8);
  return d;
}

std::optional<UdpDatagram> ip_of(Frame ip) {
  if (ip.empty()) return {};
  UdpDatagram d;
  if (ip[0] >> 4 == 4) {
    if (ip.size() < 20) return {};
    const std::size_t header = std::size_t{ip[0] & 0x0FU} * 4, total = be16(ip, 2);
    if (header < 20 || total < header || ip.size() < header || ip[9] != kUdp) return {};
    if ((be16(ip, 6) & 0x3FFF) != 0) return {};  // a fragment
    d.source_ipv4 = be32(ip, 12), d.destination_ipv4 = be32(ip, 16);
    // VeloView writes one length into all its headers; that of the datagram itself is checked.
    return udp_of(ip.subspan(header, std::min(total, ip.size()) - header), d);
  }
  if (ip[0] >> 4 == 6) {
    if (ip.size() < 40 || ip[6] != kUdp) return {};
    const std::size_t length = be16(ip, 4);
    if (length > ip.size() - 40) return {};
    return udp_of(ip.subspan(40, length), d);
  }
  return {};
}

void put16(std::vector<std::uint8_t>& out, std::uint32_t v) {
  out.push_back(static_cast<std::uint8_t>(v >> 8));
  out.push_back(static_cast<std::uint8_t>(v));
}
void put32(std::vector<std::uint8_t>& out, std::uint32_t v) { put16(out, v >> 16), put16(out, v & 0xFFFF); }

/// RFC 1071.
std::uint32_t folded(std::uint64_t sum) {
  while (sum > 0xFFFF) sum = (sum & 0xFFFF) + (sum >> 16);
  return static_cast<std::uint32_t>(~sum & 0xFFFF);
}
std::uint64_t sum_of(Frame f) {
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i + 1 < f.size(); i += 2) sum += be16(f, i);
  if (f.size() % 2 != 0) sum += static_cast<std::uint64_t>(f.back()) << 8;
  return sum;
}

}  // namespace

bool knows_link_type(int t) noexcept {
  return t == kLinkNull || t == kLinkEthernet || t == kLinkRaw || t == kLinkSll;
}

std::optional<UdpDatagram> udp_of_frame(int link_type, Frame frame) noexcept {
  switch (link_type) {
    case kLinkNull:
      return frame.size() < 4 ? std::nullopt : ip_of(frame.subspan(4));
    case kLinkRaw:
      return ip_of(frame);
    case kLinkSll: {
      if (frame.size() < 16) return {};
      const std::uint32_t type = be16(frame, 14);
      return type == kIpv4 || type == kIpv6 ? ip_of(frame.subspan(16)) : std::nullopt;
    }
    case kLinkEthernet: {
      std::size_t at = 12;
      for (int tags = 0; tags < 3; ++tags, at += 4) {
        if (frame.size() < at + 2) return {};
        const std::uint32_t type = be16(frame, at);
        if (type == kIpv4 || type == kIpv6) return ip_of(frame.subspan(at + 2));
        if (type != 0x8100 && type != 0x88A8) return {};
      }
      return {};
    }
    default:
      return {};
  }
}

std::vector<std::uint8_t> ethernet_frame(const UdpDatagram& d) {
  std::vector<std::uint8_t> out;
  out.reserve(42 + d.payload.size());
  out.insert(out.end(), 6, 0xFF);  // to all
  // 60:76:88 is Velodyne's.
  for (const int b : {0x60, 0x76, 0x88, 0x00, 0x00, 0x00}) out.push_back(static_cast<std::uint8_t>(b));
  put16(out, kIpv4);
  const std::size_t ip = out.size();
  const auto udp_length = static_cast<std::uint32_t>(8 + d.payload.size());
  put16(out, 0x4500);
  put16(out, 20 + udp_length);
  put32(out, 0x00004000);  // not to be fragmented
  put16(out, 0x4000 | kUdp);
  put16(out, 0);
  put32(out, d.source_ipv4);
  put32(out, d.destination_ipv4);
  const std::uint32_t header_sum = folded(sum_of(Frame(out).subspan(ip, 20)));
  out[ip + 10] = static_cast<std::uint8_t>(header_sum >> 8);
  out[ip + 11] = static_cast<std::uint8_t>(header_sum);
  const std::size_t udp = out.size();
  put16(out, d.source_port);
  put16(out, d.destination_port);
  put16(out, udp_length);
  put16(out, 0);
  out.insert(out.end(), d.payload.begin(), d.payload.end());
  std::uint32_t sum =
      folded(sum_of(Frame(out).subspan(ip + 12, 8)) + kUdp + udp_length + sum_of(Frame(out).subspan(udp)));
  if (sum == 0) sum = 0xFFFF;
  out[udp + 6] = static_cast<std::uint8_t>(sum >> 8);
  out[udp + 7] = static_cast<std::uint8_t>(sum);
  return out;
}

}  // namespace rigor::velodyne
