// Signals against closed forms and against what cantools (cantools/cantools on GitHub,
// tests/test_database.py) encodes and decodes of the same messages.
#include "drivers/can/signal_codec.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace rigor::can {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

Dbc parse(std::string_view text) {
  auto dbc = parse_dbc(text, "t.dbc");
  EXPECT_TRUE(dbc) << (dbc ? "" : dbc.error().text());
  return dbc ? *dbc : Dbc{};
}
std::vector<std::uint8_t> bytes(const CanFrame& f) { return {f.data.begin(), f.data.begin() + f.length}; }

TEST(SignalCodec, MatchesCantoolsForMotorolaSignals) {
  const auto dbc = parse(R"(BU_: PCM1 FOO
BO_ 496 ExampleMessage: 8 PCM1
 SG_ Temperature : 0|12@0- (0.01,250) [229.52|270.47] "degK"  PCM1,FOO
 SG_ AverageRadius : 6|6@0+ (0.1,0) [0|5] "m" Vector__XXX
 SG_ Enable : 7|1@0+ (1,0) [0|0] "-" Vector__XXX
)");
  const Message& m = dbc.messages[0];
  CanFrame f = blank_frame(m);
  std::size_t bad = 99;
  // cantools: {'Temperature': 250.55, 'AverageRadius': 3.2, 'Enable': 1} -> c0 06 e0 00 00 00 00 00
  ASSERT_EQ(encode(m, std::vector{250.55, 3.2, 1.0}, f, bad), EncodeStatus::good);
  EXPECT_EQ(bytes(f), (std::vector<std::uint8_t>{0xc0, 0x06, 0xe0, 0, 0, 0, 0, 0}));
  // and 250.1 -> c0 01 40 (README of cantools)
  ASSERT_EQ(encode(m, std::vector{250.1, 3.2, 1.0}, f, bad), EncodeStatus::good);
  EXPECT_EQ(bytes(f), (std::vector<std::uint8_t>{0xc0, 0x01, 0x40, 0, 0, 0, 0, 0}));
  std::vector<double> out(3);
  decode(m, f.data, out);
  EXPECT_NEAR(out[0], 250.1, 1e-12);
  EXPECT_NEAR(out[1], 3.2, 1e-12);
  EXPECT_EQ(out[2], 1);
}

TEST(SignalCodec, MatchesTheBytesOfIeee754) {
  const auto dbc = parse(R"(BU_: N
BO_ 1024 M1: 8 N
 SG_ S : 0|64@1- (1,0) [0|0] "" N
BO_ 1025 M2: 8 N
 SG_ A : 0|32@1- (1,0) [0|0] "" N
 SG_ B : 39|32@0- (1,0) [0|0] "" N
SIG_VALTYPE_ 1024 S : 2;
SIG_VALTYPE_ 1025 A : 1;
SIG_VALTYPE_ 1025 B : 1;
)");
  CanFrame f = blank_frame(dbc.messages[0]);
  std::size_t bad = 0;
  ASSERT_EQ(encode(dbc.messages[0], std::vector{1.0}, f, bad), EncodeStatus::good);
  EXPECT_EQ(bytes(f), (std::vector<std::uint8_t>{0, 0, 0, 0, 0, 0, 0xf0, 0x3f}));
  EXPECT_EQ(decode(dbc.messages[0], 0, f.data), 1.0);
  f = blank_frame(dbc.messages[1]);
  ASSERT_EQ(encode(dbc.messages[1], std::vector{-2.5, 1.0}, f, bad), EncodeStatus::good);
  EXPECT_EQ(bytes(f), (std::vector<std::uint8_t>{0, 0, 0x20, 0xc0, 0x3f, 0x80, 0, 0}));
  EXPECT_EQ(encode(dbc.messages[1], std::vector{1e39, 0.0}, f, bad), EncodeStatus::out_of_range);
}

TEST(SignalCodec, WhatASignalCannotHoldIsRefusedAndNothingChanges) {
  const auto dbc = parse(R"(BU_: N
BO_ 1 M: 8 N
 SG_ U : 0|8@1+ (0.5,-10) [0|0] "" N
 SG_ I : 8|8@1- (1,0) [0|0] "" N
 SG_ R : 16|8@1+ (1,0) [10|20] "" N
 SG_ W : 24|40@1+ (-2,0) [0|0] "" N
)");
  const Message& m = dbc.messages[0];
  const auto try_one = [&](std::size_t i, double x) {
    std::uint64_t raw = 0xdead;
    const auto s = raw_of(m.signals[i], x, raw);
    EXPECT_TRUE(s == EncodeStatus::good || raw == 0xdead);
    return s;
  };
  EXPECT_EQ(try_one(0, -10), EncodeStatus::good);
  EXPECT_EQ(try_one(0, 117.5), EncodeStatus::good);
  EXPECT_EQ(try_one(0, 117.74), EncodeStatus::good);  // rounds to 255
  EXPECT_EQ(try_one(0, 117.75), EncodeStatus::out_of_range);
  EXPECT_EQ(try_one(0, -10.3), EncodeStatus::out_of_range);
  EXPECT_EQ(try_one(1, -128), EncodeStatus::good);
  EXPECT_EQ(try_one(1, -129), EncodeStatus::out_of_range);
  EXPECT_EQ(try_one(1, 128), EncodeStatus::out_of_range);
  EXPECT_EQ(try_one(2, 21), EncodeStatus::out_of_range);
  EXPECT_EQ(try_one(2, 20), EncodeStatus::good);
  EXPECT_EQ(try_one(3, -2199023255550.0), EncodeStatus::good);
  EXPECT_EQ(try_one(3, 1), EncodeStatus::out_of_range);
  EXPECT_EQ(try_one(0, kNaN), EncodeStatus::not_a_number);
  EXPECT_EQ(try_one(0, HUGE_VAL), EncodeStatus::not_a_number);
  CanFrame f = blank_frame(m);
  f.data[0] = 0x55;
  const CanFrame before = f;
  std::size_t bad = 99;
  EXPECT_EQ(encode(m, std::vector{0.0, 500.0, 15.0, 0.0}, f, bad), EncodeStatus::out_of_range);
  EXPECT_EQ(bad, 1u);
  EXPECT_EQ(f.data, before.data);
}

TEST(SignalCodec, EveryPlaceOfEverySignalRoundsTrip) {
  // Bits written and read back anywhere, in both orders, and no bit beside them is touched.
  std::mt19937_64 random(7);
  for (int i = 0; i < 20000; ++i) {
    Signal s;
    s.order = random() % 2 ? BitOrder::intel : BitOrder::motorola;
    s.length_bits = static_cast<std::uint16_t>(1 + random() % 64);
    s.is_signed = random() % 2;
    s.start_bit = static_cast<std::uint16_t>(random() % 64);
    if (!within(s, 8)) continue;
    const std::uint64_t mask = s.length_bits == 64 ? ~0ull : (1ull << s.length_bits) - 1;
    const std::uint64_t raw = random() & mask;
    std::array<std::uint8_t, 8> zeros{}, ones;
    ones.fill(0xff);
    write_raw(s, zeros, raw);
    write_raw(s, ones, raw);
    ASSERT_EQ(read_raw(s, zeros), raw);
    ASSERT_EQ(read_raw(s, ones), raw);
    int differ = 0;
    for (int b = 0; b < 64; ++b) differ += ((zeros[b / 8] ^ ones[b / 8]) >> (b % 8)) & 1;
    ASSERT_EQ(differ, 64 - s.length_bits);
    // The two orders agree on whole bytes turned round: the closed form of Motorola's.
    if (s.order == BitOrder::motorola && s.length_bits % 8 == 0 && s.start_bit % 8 == 7) {
      std::uint64_t expected = 0;
      for (int b = 0; b < s.length_bits / 8; ++b)
        expected = expected << 8 | zeros[s.start_bit / 8u + static_cast<unsigned>(b)];
      ASSERT_EQ(raw, expected);
    }
    const double value = value_of(s, raw);
    std::uint64_t again = 0;
    if (s.length_bits <= 53) {
      ASSERT_EQ(raw_of(s, value, again), EncodeStatus::good);
      ASSERT_EQ(again, raw);
    }
  }
}

TEST(SignalCodec, MultiplexedSignalsAreThereWhenTheirValueIs) {
  const auto dbc = parse(R"(BU_: N
BO_ 1 M: 8 N
 SG_ MUX M : 0|8@1+ (1,0) [0|0] "" N
 SG_ In m0M : 8|8@1+ (1,0) [0|0] "" N
 SG_ Deep m2 : 16|8@1+ (1,0) [0|0] "" N
 SG_ Other m3 : 8|16@1+ (1,0) [0|0] "" N
SG_MUL_VAL_ 1 In MUX 0-0, 4-5;
SG_MUL_VAL_ 1 Deep In 2-2;
SG_MUL_VAL_ 1 Other MUX 3-3;
)");
  const Message& m = dbc.messages[0];
  std::array<std::uint8_t, 8> data{4, 2, 9};
  std::vector<double> out(4);
  decode(m, data, out);
  EXPECT_EQ(out[0], 4);
  EXPECT_EQ(out[1], 2);
  EXPECT_EQ(out[2], 9);
  EXPECT_TRUE(std::isnan(out[3]));
  data[0] = 3;
  decode(m, data, out);
  EXPECT_TRUE(std::isnan(out[1]));
  EXPECT_TRUE(std::isnan(out[2]));
  EXPECT_EQ(out[3], 2 + 256 * 9);
  // Encoding goes from the outermost multiplexor inwards, and leaves out what is not shown.
  CanFrame f = blank_frame(m);
  std::size_t bad = 0;
  ASSERT_EQ(encode(m, std::vector{5.0, 2.0, 200.0, 7.0}, f, bad), EncodeStatus::good);
  EXPECT_EQ(bytes(f), (std::vector<std::uint8_t>{5, 2, 200, 0, 0, 0, 0, 0}));
  // A shown signal that does not fit is refused, a hidden one is not even looked at.
  EXPECT_EQ(encode(m, std::vector{5.0, 2.0, 300.0, 7.0}, f, bad), EncodeStatus::out_of_range);
  EXPECT_EQ(bad, 2u);
  EXPECT_EQ(encode(m, std::vector{3.0, 2.0, 300.0, 7.0}, f, bad), EncodeStatus::good);
}

TEST(SignalCodec, AShortFrameShowsWhatItHas) {
  const auto dbc = parse(
      "BU_: N\nBO_ 1 M: 8 N\n SG_ A : 0|8@1+ (1,0) [0|0] \"\" N\n SG_ B : 12|8@1+ (1,0) [0|0] \"\" N\n");
  const std::array<std::uint8_t, 2> data{1, 2};
  EXPECT_EQ(decode(dbc.messages[0], 0, data), 1);
  EXPECT_TRUE(std::isnan(decode(dbc.messages[0], 1, data)));
}

}  // namespace
}  // namespace rigor::can
