#include "drivers/network/udp_frame.h"

#include <algorithm>

#include "rt-core/byte_order.h"

namespace rigor::network {
namespace {

using Frame = std::span<const std::uint8_t>;

constexpr std::uint32_t kIpv4 = 0x0800, kIpv6 = 0x86DD, kUdp = 17, kFragmentHeader = 44;
constexpr std::uint32_t kMaxDatagram = 65535;
constexpr Duration kFragmentLifetime = seconds(2);

std::optional<UdpDatagram> udp_of(Frame udp, UdpDatagram d) {
  if (udp.size() < 8) return {};
  const std::size_t length = load_be<std::uint16_t>(udp, 4);
  if (length < 8 || length > udp.size()) return {};
  d.source_port = load_be<std::uint16_t>(udp, 0);
  d.destination_port = load_be<std::uint16_t>(udp, 2);
  d.payload = udp.subspan(8, length - 8);
  return d;
}

/// What an IP packet carries, and which part of its datagram that is.
struct IpPacket {
  std::uint32_t source_ipv4 = 0, destination_ipv4 = 0;
  Frame source, destination;  ///< addresses as they stand there
  std::uint32_t identification = 0, offset = 0;
  bool more = false;
  Frame payload;
  [[nodiscard]] bool whole() const { return offset == 0 && !more; }
};

/// Empty: not UDP over IP, or cut short.
std::optional<IpPacket> ip_of(Frame ip) {
  if (ip.empty()) return {};
  IpPacket p;
  if (ip[0] >> 4 == 4) {
    if (ip.size() < 20) return {};
    const std::size_t header = std::size_t{ip[0] & 0x0FU} * 4, total = load_be<std::uint16_t>(ip, 2);
    if (header < 20 || total < header || ip.size() < header || ip[9] != kUdp) return {};
    p.source = ip.subspan(12, 4), p.destination = ip.subspan(16, 4);
    p.source_ipv4 = load_be<std::uint32_t>(ip, 12), p.destination_ipv4 = load_be<std::uint32_t>(ip, 16);
    p.identification = load_be<std::uint16_t>(ip, 4);
    p.offset = (load_be<std::uint16_t>(ip, 6) & 0x1FFF) * 8;
    p.more = (ip[6] & 0x20) != 0;
    // VeloView writes one length into all its headers; that of the datagram itself is checked.
    p.payload = ip.subspan(header, std::min(total, ip.size()) - header);
    // A fragment says by this length alone where it ends.
    if (!p.whole() && total > ip.size()) return {};
    return p;
  }
  if (ip[0] >> 4 == 6) {
    if (ip.size() < 40) return {};
    const std::size_t length = load_be<std::uint16_t>(ip, 4);
    if (length > ip.size() - 40) return {};
    p.source = ip.subspan(8, 16), p.destination = ip.subspan(24, 16);
    p.payload = ip.subspan(40, length);
    if (ip[6] == kUdp) return p;
    if (ip[6] != kFragmentHeader || length < 8 || p.payload[0] != kUdp) return {};
    const std::uint32_t place = load_be<std::uint16_t>(p.payload, 2);
    p.offset = place & 0xFFF8, p.more = (place & 1) != 0;
    p.identification = load_be<std::uint32_t>(p.payload, 4);
    p.payload = p.payload.subspan(8);
    return p;
  }
  return {};
}

/// The IP packet in a frame.
std::optional<IpPacket> ip_of_frame(int link_type, Frame frame) {
  switch (link_type) {
    case kLinkNull:
      return frame.size() < 4 ? std::nullopt : ip_of(frame.subspan(4));
    case kLinkRaw:
      return ip_of(frame);
    case kLinkSll: {
      if (frame.size() < 16) return {};
      const std::uint32_t type = load_be<std::uint16_t>(frame, 14);
      return type == kIpv4 || type == kIpv6 ? ip_of(frame.subspan(16)) : std::nullopt;
    }
    case kLinkEthernet: {
      std::size_t at = 12;
      for (int tags = 0; tags < 3; ++tags, at += 4) {
        if (frame.size() < at + 2) return {};
        const std::uint32_t type = load_be<std::uint16_t>(frame, at);
        if (type == kIpv4 || type == kIpv6) return ip_of(frame.subspan(at + 2));
        if (type != 0x8100 && type != 0x88A8) return {};
      }
      return {};
    }
    default:
      return {};
  }
}

std::optional<UdpDatagram> udp_of(Frame udp, const IpPacket& ip) {
  return udp_of(udp, UdpDatagram{ip.source_ipv4, ip.destination_ipv4, 0, 0, {}});
}

/// RFC 1071.
std::uint16_t folded(std::uint64_t sum) {
  while (sum > 0xFFFF) sum = (sum & 0xFFFF) + (sum >> 16);
  return static_cast<std::uint16_t>(~sum);
}
std::uint64_t sum_of(Frame f) {
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i + 1 < f.size(); i += 2) sum += load_be<std::uint16_t>(f, i);
  if (f.size() % 2 != 0) sum += static_cast<std::uint64_t>(f.back()) << 8;
  return sum;
}

}  // namespace

std::string text_of_ipv4(std::uint32_t a) {
  return std::to_string(a >> 24) + "." + std::to_string(a >> 16 & 255) + "." + std::to_string(a >> 8 & 255) +
         "." + std::to_string(a & 255);
}

bool knows_link_type(int t) noexcept {
  return t == kLinkNull || t == kLinkEthernet || t == kLinkRaw || t == kLinkSll;
}

std::optional<UdpDatagram> udp_of_frame(int link_type, Frame frame) noexcept {
  const auto ip = ip_of_frame(link_type, frame);
  return ip && ip->whole() ? udp_of(ip->payload, *ip) : std::nullopt;
}

std::optional<UdpDatagram> UdpReassembler::take(Frame frame, RealtimeTime t) {
  const auto ip = ip_of_frame(link_type_, frame);
  if (!ip) return {};
  if (ip->whole()) return udp_of(ip->payload, *ip);
  ++counters_.fragments;
  counters_.given_up += std::erase_if(open_, [&](const Open& o) {
    return t - o.heard > kFragmentLifetime || o.heard - t > kFragmentLifetime;
  });

  Key key;
  std::copy(ip->source.begin(), ip->source.end(), key.source.begin());
  std::copy(ip->destination.begin(), ip->destination.end(), key.destination.begin());
  key.identification = ip->identification;
  auto open = std::find_if(open_.begin(), open_.end(), [&](const Open& o) { return o.key == key; });
  if (open == open_.end()) {
    if (open_.size() == kOpen) {
      ++counters_.given_up;
      open_.erase(std::min_element(open_.begin(), open_.end(),
                                   [](const Open& a, const Open& b) { return a.heard < b.heard; }));
    }
    open = open_.insert(open_.end(), Open{key, t, {}, {}, 0});
  }
  Open& o = *open;
  o.heard = t;

  const auto begin = ip->offset;
  const auto end = begin + static_cast<std::uint32_t>(ip->payload.size());
  const auto next = std::lower_bound(o.parts.begin(), o.parts.end(), begin,
                                     [](const Part& part, std::uint32_t at) { return part.begin < at; });
  const bool overlaps = (next != o.parts.end() && next->begin < end) ||
                        (next != o.parts.begin() && std::prev(next)->end > begin);
  const bool misfits = end > kMaxDatagram || begin == end || (ip->more && (end - begin) % 8 != 0) ||
                       (!ip->more && o.length != 0) || (o.length != 0 && end > o.length) ||
                       (!ip->more && !o.parts.empty() && o.parts.back().end > end);
  if (overlaps || misfits) {
    ++counters_.given_up;
    open_.erase(open);
    return {};
  }
  if (!ip->more) o.length = end;
  if (o.bytes.size() < end) o.bytes.resize(end);
  std::copy(ip->payload.begin(), ip->payload.end(), o.bytes.begin() + begin);
  o.parts.insert(next, Part{begin, end});

  // They are apart from each other and none is beyond the end: whole where their lengths add up.
  std::uint32_t have = 0;
  for (const Part& part : o.parts) have += part.end - part.begin;
  if (o.length == 0 || have != o.length) return {};
  whole_ = std::move(o.bytes);
  open_.erase(open);
  ++counters_.datagrams;
  return udp_of(whole_, *ip);
}

std::vector<std::vector<std::uint8_t>> ethernet_frames(const UdpDatagram& d, std::uint16_t identification) {
  // The datagram with its header, and then the frames that carry it.
  std::vector<std::uint8_t> pseudo;
  append_be(pseudo, d.source_ipv4), append_be(pseudo, d.destination_ipv4);
  const auto udp_length = static_cast<std::uint32_t>(8 + d.payload.size());
  std::vector<std::uint8_t> udp;
  udp.reserve(udp_length);
  append_be(udp, d.source_port), append_be(udp, d.destination_port);
  append_be(udp, static_cast<std::uint16_t>(udp_length)), append_be<std::uint16_t>(udp, 0);
  udp.insert(udp.end(), d.payload.begin(), d.payload.end());
  std::uint16_t sum = folded(sum_of(pseudo) + kUdp + udp_length + sum_of(udp));
  if (sum == 0) sum = 0xFFFF;
  store_be(udp, 6, sum);

  constexpr std::size_t kRoom = (kMtu - 20) / 8 * 8;
  std::vector<std::vector<std::uint8_t>> frames;
  for (std::size_t at = 0; at < udp.size(); at += kRoom) {
    const std::size_t n = std::min(kRoom, udp.size() - at);
    const bool more = at + n < udp.size(), whole = at == 0 && !more;
    std::vector<std::uint8_t>& out = frames.emplace_back();
    out.reserve(34 + n);
    out.insert(out.end(), 6, 0xFF);  // to all
    // A locally administered address.
    for (const int b : {0x02, 0x00, 0x00, 0x00, 0x00, 0x01}) out.push_back(static_cast<std::uint8_t>(b));
    append_be<std::uint16_t>(out, kIpv4);
    const std::size_t ip = out.size();
    append_be<std::uint16_t>(out, 0x4500);
    append_be(out, static_cast<std::uint16_t>(20 + n));
    append_be(out, identification);
    append_be(out, static_cast<std::uint16_t>(whole ? 0x4000 : (more ? 0x2000 : 0) | at / 8));
    append_be<std::uint16_t>(out, 0x4000 | kUdp);
    append_be<std::uint16_t>(out, 0);
    append_be(out, d.source_ipv4), append_be(out, d.destination_ipv4);
    store_be(out, ip + 10, folded(sum_of(Frame(out).subspan(ip, 20))));
    out.insert(out.end(), udp.begin() + static_cast<std::ptrdiff_t>(at),
               udp.begin() + static_cast<std::ptrdiff_t>(at + n));
  }
  return frames;
}

}  // namespace rigor::network
