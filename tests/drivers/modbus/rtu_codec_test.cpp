// Frames of a serial line: checksums, silences, lumps and noise.
#include "drivers/modbus/rtu_codec.h"

#include <gtest/gtest.h>

#include <vector>

#include "drivers/modbus/pdu.h"

namespace rigor::modbus {
namespace {

using Bytes = std::vector<std::uint8_t>;
constexpr Duration kGap = microseconds(1750), kTimeout = milliseconds(50);
constexpr MonotonicTime kT{1'000'000'000};

Bytes sealed(Bytes frame) {
  frame.resize(frame.size() + 2);
  (void)seal_frame(frame, frame.size() - 2);
  return frame;
}
const Bytes kRead = sealed({1, 3, 0, 0, 0, 2});
const Bytes kWrite = sealed({1, 16, 0, 0, 0, 2, 4, 0, 1, 0, 2});

TEST(Crc16, KnownFrames) {
  // Frames that the guides of the trade print: 11 03 00 6B 00 03 76 87 and 01 04 02 FF FF B8 80.
  EXPECT_EQ(crc16(Bytes{0x11, 0x03, 0x00, 0x6B, 0x00, 0x03}), 0x8776);
  EXPECT_EQ(sealed({0x01, 0x04, 0x02, 0xFF, 0xFF}), (Bytes{0x01, 0x04, 0x02, 0xFF, 0xFF, 0xB8, 0x80}));
}

TEST(LineTimes, AreThoseOfTheSpecification) {
  EXPECT_EQ(LineTimes::of(9600, 11).gap.ns(), 11 * 1'000'000'000LL / 9600 * 7 / 2);
  EXPECT_EQ(LineTimes::of(115200, 11).gap, microseconds(1750));
}

TEST(RtuFramer, AFrameEndsWithTheSilenceBehindIt) {
  RtuFramer f(kGap, kTimeout);
  std::span<const std::uint8_t> frame;
  ASSERT_TRUE(f.add(kRead, kT));
  EXPECT_EQ(f.next(kT + microseconds(1000), frame), RtuFramer::Found::nothing);
  EXPECT_EQ(f.due(), kT + kGap);
  ASSERT_EQ(f.next(kT + kGap, frame), RtuFramer::Found::frame);
  EXPECT_EQ(Bytes(frame.begin(), frame.end()), (Bytes{1, 3, 0, 0, 0, 2}));
  EXPECT_EQ(f.next(kT + kGap, frame), RtuFramer::Found::nothing);
  EXPECT_EQ(f.due(), MonotonicTime::never());
}

TEST(RtuFramer, ATornFrameIsWaitedFor) {
  RtuFramer f(kGap, kTimeout);
  std::span<const std::uint8_t> frame;
  ASSERT_TRUE(f.add(std::span(kWrite).first(5), kT));
  EXPECT_EQ(f.next(kT + milliseconds(10), frame), RtuFramer::Found::nothing);
  ASSERT_TRUE(f.add(std::span(kWrite).subspan(5), kT + milliseconds(20)));
  EXPECT_EQ(f.next(kT + milliseconds(22), frame), RtuFramer::Found::frame);
  EXPECT_EQ(frame.size(), kWrite.size() - 2);
  ASSERT_TRUE(f.add(std::span(kWrite).first(5), kT + milliseconds(30)));
  EXPECT_EQ(f.next(kT + milliseconds(81), frame), RtuFramer::Found::garbage);
  EXPECT_EQ(f.next(kT + milliseconds(82), frame), RtuFramer::Found::nothing);
}

TEST(RtuFramer, TwoRequestsInOneLumpArePartedByTheirLengths) {
  RtuFramer f(kGap, kTimeout);
  std::span<const std::uint8_t> frame;
  Bytes both = kWrite;
  both.insert(both.end(), kRead.begin(), kRead.end());
  ASSERT_TRUE(f.add(both, kT));
  ASSERT_EQ(f.next(kT + kGap, frame), RtuFramer::Found::frame);
  EXPECT_EQ(frame[1], 16);
  ASSERT_EQ(f.next(kT + kGap, frame), RtuFramer::Found::frame);
  EXPECT_EQ(frame[1], 3);
}

TEST(RtuFramer, AnswersOfOtherUnitsAreFramesByTheSilenceAlone) {
  RtuFramer f(kGap, kTimeout);
  std::span<const std::uint8_t> frame;
  ASSERT_TRUE(f.add(sealed({7, 3, 4, 0, 1, 0, 2}), kT));
  ASSERT_EQ(f.next(kT + kGap, frame), RtuFramer::Found::frame);
  EXPECT_EQ(frame[0], 7);
  EXPECT_EQ(frame.size(), 7u);
}

TEST(RtuFramer, NoiseIsDroppedAndTheNextFrameIsRead) {
  RtuFramer f(kGap, kTimeout);
  std::span<const std::uint8_t> frame;
  Bytes broken = kRead;
  broken[3] = static_cast<std::uint8_t>(broken[3] ^ 0x40);
  ASSERT_TRUE(f.add(broken, kT));
  EXPECT_EQ(f.next(kT + kTimeout, frame), RtuFramer::Found::garbage);
  ASSERT_TRUE(f.add(kRead, kT + milliseconds(60)));
  EXPECT_EQ(f.next(kT + milliseconds(62), frame), RtuFramer::Found::frame);
  // A line that never falls silent and never makes sense is bounded.
  bool held = true;
  for (int i = 0; i < 100 && held; ++i) held = f.add(Bytes(100, 0x55), kT + milliseconds(70));
  EXPECT_FALSE(held);
  ASSERT_TRUE(f.add(kRead, kT + milliseconds(200)));
  EXPECT_EQ(f.next(kT + milliseconds(202), frame), RtuFramer::Found::frame);
}

TEST(RtuFramer, WithoutAGapAFrameIsThereWithItsLastByte) {
  RtuFramer f(Duration(0), kTimeout);
  std::span<const std::uint8_t> frame;
  for (const auto b : std::span(kWrite).first(kWrite.size() - 1)) {
    ASSERT_TRUE(f.add({&b, 1}, kT));
    EXPECT_EQ(f.next(kT, frame), RtuFramer::Found::nothing);
  }
  ASSERT_TRUE(f.add({&kWrite.back(), 1}, kT));
  EXPECT_EQ(f.next(kT, frame), RtuFramer::Found::frame);
}

/// 16 registers in each table.
class Small final : public RegisterModel {
 public:
  bool read(RegisterTable, std::uint16_t address, std::span<std::uint16_t> out, BenchTime) override {
    if (address + out.size() > words.size()) return false;
    std::copy_n(words.begin() + address, out.size(), out.begin());
    return true;
  }
  bool write(RegisterTable, std::uint16_t address, std::span<const std::uint16_t> in, BenchTime) override {
    if (address + in.size() > words.size()) return false;
    std::copy(in.begin(), in.end(), words.begin() + address);
    return true;
  }
  std::array<std::uint16_t, 16> words{};
};

TEST(Pdu, TheExamplesOfTheSpecification) {
  Small model;
  Pdu answer;
  // Section 6.12: write two registers from 1 on with 000A and 0102.
  ASSERT_TRUE(serve_request(model, Bytes{16, 0, 1, 0, 2, 4, 0, 0x0A, 1, 2}, {}, answer));
  EXPECT_EQ(Bytes(answer.span().begin(), answer.span().end()), (Bytes{16, 0, 1, 0, 2}));
  EXPECT_EQ(model.words[2], 0x0102);
  ASSERT_TRUE(serve_request(model, Bytes{3, 0, 1, 0, 2}, {}, answer));
  EXPECT_EQ(Bytes(answer.span().begin(), answer.span().end()), (Bytes{3, 4, 0, 0x0A, 1, 2}));
  // Section 6.11: ten coils, CD 01.
  model.words = {};
  ASSERT_TRUE(serve_request(model, Bytes{15, 0, 3, 0, 10, 2, 0xCD, 1}, {}, answer));
  ASSERT_TRUE(serve_request(model, Bytes{1, 0, 3, 0, 10}, {}, answer));
  EXPECT_EQ(Bytes(answer.span().begin(), answer.span().end()), (Bytes{1, 2, 0xCD, 1}));
  ASSERT_TRUE(serve_request(model, Bytes{1, 0, 9, 0, 10}, {}, answer));
  EXPECT_EQ(Bytes(answer.span().begin(), answer.span().end()), (Bytes{0x81, 2}));
  EXPECT_EQ(answer.exception, Exception::illegal_address);
  EXPECT_FALSE(serve_request(model, Bytes{3, 0, 1, 0}, {}, answer));
  // Section 6.16: register 4 is 12, the masks are F2 and 25.
  model.words = {};
  ASSERT_TRUE(serve_request(model, Bytes{6, 0, 4, 0, 0x12}, {}, answer));
  ASSERT_TRUE(serve_request(model, Bytes{22, 0, 4, 0, 0xF2, 0, 0x25}, {}, answer));
  EXPECT_EQ(model.words[4], 0x17);
}

}  // namespace
}  // namespace rigor::modbus
