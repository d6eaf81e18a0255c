#include "drivers/network/udp_frame.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <numeric>

namespace rigor::network {
namespace {

// RFC 768, RFC 1071: the sum over the pseudo header and the datagram, its checksum in it, is FFFF.
TEST(UdpFrame, HasTheChecksumsThatReceiversDemand) {
  for (const std::vector<std::uint8_t>& payload :
       {std::vector<std::uint8_t>{1, 2, 3, 4, 5}, std::vector<std::uint8_t>(300, 0xF7)}) {
    const auto frame = ethernet_frames({0xC0A801C9, 0xFFFFFFFF, 2368, 2369, payload}, 0x1234).front();
    const auto sum = [&](std::size_t at, std::size_t size, std::uint32_t start) {
      std::uint32_t s = start;
      for (std::size_t i = 0; i < size; ++i)
        s += static_cast<std::uint32_t>(frame[at + i]) << (i % 2 == 0 ? 8 : 0);
      while (s > 0xFFFF) s = (s & 0xFFFF) + (s >> 16);
      return s;
    };
    EXPECT_EQ(sum(14, 20, 0), 0xFFFFU) << "of the IP header";
    const auto size = static_cast<std::uint32_t>(8 + payload.size());
    EXPECT_EQ(sum(34, size, sum(26, 8, 0) + 17 + size), 0xFFFFU) << "of the datagram";
  }
}

TEST(UdpFrame, IsFoundInWhatWasCaptured) {
  const std::vector<std::uint8_t> payload{1, 2, 3, 4, 5};
  const UdpDatagram sent{0xC0A801C9, 0xFFFFFFFF, 2368, 2369, payload};
  const auto frame = ethernet_frames(sent, 1).front();
  const auto check = [&](int link, std::vector<std::uint8_t> f) {
    const auto got = udp_of_frame(link, f);
    ASSERT_TRUE(got) << "link type " << link;
    EXPECT_EQ(got->source_ipv4, sent.source_ipv4);
    EXPECT_EQ(got->destination_port, 2369);
    EXPECT_TRUE(std::equal(payload.begin(), payload.end(), got->payload.begin(), got->payload.end()));
    // Cut short anywhere, it is none.
    for (std::size_t n = 0; n < f.size(); ++n)
      EXPECT_FALSE(udp_of_frame(link, std::span(f).first(n)))
          << "link type " << link << ", " << n << " bytes";
  };
  check(kLinkEthernet, frame);
  auto tagged = frame;
  tagged.insert(tagged.begin() + 12, {0x81, 0x00, 0x00, 0x05});
  check(kLinkEthernet, tagged);
  check(kLinkRaw, {frame.begin() + 14, frame.end()});
  std::vector<std::uint8_t> cooked(16, 0);
  cooked[14] = 0x08;
  cooked.insert(cooked.end(), frame.begin() + 14, frame.end());
  check(kLinkSll, cooked);
  auto fragment = frame;
  fragment[20] |= 0x20;
  EXPECT_FALSE(udp_of_frame(kLinkEthernet, fragment));
}

std::vector<std::uint8_t> long_payload(std::size_t bytes) {
  std::vector<std::uint8_t> p(bytes);
  for (std::size_t i = 0; i < bytes; ++i) p[i] = static_cast<std::uint8_t>(i * 13 + i / 256);
  return p;
}
RealtimeTime at_ms(std::int64_t ms) { return RealtimeTime(1'700'000'000'000'000'000 + ms * 1'000'000); }

TEST(UdpReassembler, TakesFragmentsInAnyOrderBesideThoseOfOthers) {
  const auto a = long_payload(8000), b = long_payload(5001);
  auto frames_a = ethernet_frames({1, 2, 3, 4, a}, 7), frames_b = ethernet_frames({1, 2, 3, 5, b}, 8);
  ASSERT_EQ(frames_a.size(), 6u);
  ASSERT_EQ(frames_b.size(), 4u);
  for (const auto& f : frames_a) EXPECT_LE(f.size(), 14 + kMtu);
  std::reverse(frames_a.begin(), frames_a.end());
  UdpReassembler whole(kLinkEthernet);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_FALSE(whole.take(frames_a[i], at_ms(0)));
  for (std::size_t i = 0; i < 3; ++i) EXPECT_FALSE(whole.take(frames_b[i], at_ms(1)));
  for (std::size_t i = 3; i < 5; ++i) EXPECT_FALSE(whole.take(frames_a[i], at_ms(1)));
  const auto got_b = whole.take(frames_b[3], at_ms(2));
  ASSERT_TRUE(got_b);
  EXPECT_EQ(got_b->destination_port, 5);
  EXPECT_TRUE(std::equal(b.begin(), b.end(), got_b->payload.begin(), got_b->payload.end()));
  const auto got_a = whole.take(frames_a[5], at_ms(3));
  ASSERT_TRUE(got_a);
  EXPECT_EQ(got_a->destination_port, 4);
  EXPECT_TRUE(std::equal(a.begin(), a.end(), got_a->payload.begin(), got_a->payload.end()));
  EXPECT_EQ(whole.counters().fragments, 10u);
  EXPECT_EQ(whole.counters().datagrams, 2u);
  EXPECT_EQ(whole.counters().given_up, 0u);
}

TEST(UdpReassembler, GivesUpWhatLacksAFragmentOrOverlaps) {
  const auto payload = long_payload(8000);
  const auto frames = ethernet_frames({1, 2, 3, 4, payload}, 7);
  UdpReassembler lost(kLinkEthernet);
  for (std::size_t i = 0; i < frames.size(); ++i)
    if (i != 2) {
      EXPECT_FALSE(lost.take(frames[i], at_ms(0)));
    }
  // The same identification again, after it ran round: the old ones do not mix with the new.
  std::optional<UdpDatagram> got;
  for (const auto& f : frames) got = lost.take(f, at_ms(2500));
  ASSERT_TRUE(got);
  EXPECT_EQ(lost.counters().given_up, 1u);
  EXPECT_EQ(lost.counters().datagrams, 1u);

  UdpReassembler twice(kLinkEthernet);
  EXPECT_FALSE(twice.take(frames[1], at_ms(0)));
  auto overlapping = frames[1];
  overlapping[14 + 7] += 1;  // eight bytes further
  EXPECT_FALSE(twice.take(overlapping, at_ms(0)));
  EXPECT_EQ(twice.counters().given_up, 1u);

  UdpReassembler many(kLinkEthernet);
  for (std::uint16_t id = 0; id < 100; ++id)
    EXPECT_FALSE(many.take(ethernet_frames({1, 2, 3, 4, payload}, id)[0], at_ms(id)));
  EXPECT_EQ(many.counters().given_up, 100u - UdpReassembler::kOpen);
}

TEST(UdpReassembler, PutsFragmentsOfIpv6Together) {
  const auto payload = long_payload(2000);
  // The datagram from its IPv4 fragments, in two fragments of IPv6 (RFC 8200, section 4.5).
  std::vector<std::uint8_t> udp;
  for (const auto& f : ethernet_frames({1, 2, 3, 4, payload}, 1))
    udp.insert(udp.end(), f.begin() + 34, f.end());
  UdpReassembler whole(kLinkRaw);
  std::optional<UdpDatagram> got;
  for (const std::size_t begin : {std::size_t{0}, std::size_t{1024}}) {
    const std::size_t n = begin == 0 ? 1024 : udp.size() - 1024;
    std::vector<std::uint8_t> f(48);
    f[0] = 0x60;
    f[4] = static_cast<std::uint8_t>((n + 8) >> 8), f[5] = static_cast<std::uint8_t>(n + 8), f[6] = 44;
    f[40] = 17;
    f[42] = static_cast<std::uint8_t>(begin >> 8), f[43] = static_cast<std::uint8_t>(begin | (begin == 0));
    f[47] = 9;
    f.insert(f.end(), udp.begin() + static_cast<std::ptrdiff_t>(begin),
             udp.begin() + static_cast<std::ptrdiff_t>(begin + n));
    got = whole.take(f, at_ms(0));
    EXPECT_EQ(got.has_value(), begin != 0);
  }
  ASSERT_TRUE(got);
  EXPECT_TRUE(std::equal(payload.begin(), payload.end(), got->payload.begin(), got->payload.end()));
}

}  // namespace
}  // namespace rigor::network
