// Frame lengths on the bus against counts made by hand and by the formula of the worst case.
#include "drivers/can/can_bits.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <vector>

namespace rigor::can {
namespace {

CanFrame frame(std::uint32_t id, std::initializer_list<std::uint8_t> data, bool extended = false) {
  CanFrame f;
  f.id = id;
  f.extended = extended;
  f.length = static_cast<std::uint8_t>(data.size());
  std::copy(data.begin(), data.end(), f.data.begin());
  return f;
}

TEST(CanBits, LengthsOfFdFramesAreThoseOfTheStandard) {
  EXPECT_EQ(fd_length(8), 8);
  EXPECT_EQ(fd_length(9), 12);
  EXPECT_EQ(fd_length(33), 48);
  EXPECT_EQ(fd_length(64), 64);
  EXPECT_TRUE(is_fd_length(20));
  EXPECT_FALSE(is_fd_length(21));
}

TEST(CanBits, AFrameHasItsFieldsAndItsStuffBits) {
  // Nothing to stuff but what the identifier brings: 0x555 alternates. Without data: 1 + 11 + 3 + 4 bits, of
  // which SOF 0, 101 0101 0101, then RTR, IDE, r0, DLC: seven zeros, hence one stuff bit after five of them,
  // then the CRC. The rest is 10 + 3 bits.
  const unsigned bits = classic_bits(frame(0x555, {}));
  EXPECT_GE(bits, 1u + 11 + 3 + 4 + 15 + 10 + 3 + 1);
  EXPECT_LE(bits, 1u + 11 + 3 + 4 + 15 + 10 + 3 + 1 + 4);
}

TEST(CanBits, NoFrameIsLongerThanTheWorstCase) {
  // Davis, Burns, Bril, Lukkien 2007: at most (34 + 8n - 1) / 4 stuff bits of 11-bit frames, 54 of 29-bit.
  std::mt19937 random(1);
  unsigned longest = 0;
  for (int i = 0; i < 20000; ++i) {
    CanFrame f;
    f.extended = i % 2 != 0;
    f.id = static_cast<std::uint32_t>(random()) & (f.extended ? kExtendedMask : kStandardMask);
    f.length = static_cast<std::uint8_t>(random() % 9);
    for (auto& b : f.data)
      b = random() % 3 == 0 ? 0x00 : random() % 2 ? 0xff : static_cast<std::uint8_t>(random());
    const unsigned g = f.extended ? 54 : 34, plain = g + 8u * f.length + 13;
    const unsigned bits = classic_bits(f);
    ASSERT_GE(bits, plain);
    ASSERT_LE(bits, plain + (g + 8u * f.length - 1) / 4);
    longest = std::max(longest, bits - plain);
  }
  EXPECT_GT(longest, 15u) << "nothing was stuffed";
}

TEST(CanBits, ZerosAreStuffedEveryFourthBit) {
  const CanFrame f = frame(0, {0, 0, 0, 0, 0, 0, 0, 0});
  // SOF to the DLC: 15 zeros, 1000, then 64 zeros. Stuff bits: after 5 zeros, then a one, so after each five.
  EXPECT_GE(classic_bits(f), 34u + 64 + 13 + (15 + 64) / 5);
}

TEST(CanBits, SwitchingTheRateShortensTheDataPartAlone) {
  CanFrame f;
  f.fd = true;
  f.length = 64;
  const BitRates rates{500'000, 2'000'000};
  const auto slow = frame_duration(f, rates);
  f.bit_rate_switch = true;
  const auto fast = frame_duration(f, rates);
  EXPECT_LT(fast, slow / 3);
  EXPECT_GT(fast, slow / 4);
  // 8 bytes at 500 kbit/s: between 111 and 135 bits of 2 µs.
  const auto classic = frame_duration(frame(0x123, {1, 2, 3, 4, 5, 6, 7, 8}), rates);
  EXPECT_GE(classic, microseconds(222));
  EXPECT_LE(classic, microseconds(270));
}

TEST(CanBits, ArbitrationIsWonAsOnTheBus) {
  // ISO 11898-1: the dominant bit wins. Standard before extended of the same 11 bits, data before remote.
  const auto a = frame(0x100, {}), b = frame(0x101, {});
  auto remote = a;
  remote.remote = true;
  const auto extended = frame(0x100u << 18, {}, true), higher = frame((0x100u << 18) + 1, {}, true);
  std::vector<std::uint64_t> order{arbitration(a), arbitration(remote), arbitration(extended),
                                   arbitration(higher), arbitration(b)};
  EXPECT_TRUE(std::is_sorted(order.begin(), order.end()));
  EXPECT_EQ(std::adjacent_find(order.begin(), order.end()), order.end());
}

TEST(CanBits, FiltersAreOfOneFormat) {
  const Filter f{0x100, 0x700, false};
  EXPECT_TRUE(passes(f, frame(0x1ff, {})));
  EXPECT_FALSE(passes(f, frame(0x200, {})));
  EXPECT_FALSE(passes(f, frame(0x100, {}, true)));
}

}  // namespace
}  // namespace rigor::can
