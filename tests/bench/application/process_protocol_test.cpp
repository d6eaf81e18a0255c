// The bytes of turns and answers, as docs/application-protocol.md has them.
#include "bench/application/process_protocol.h"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstring>

#include "bench/application/plugin_application.h"
#include "clients/cpp/rigor_client.h"

namespace rigor::application {
namespace {

// The client stands alone and has its own copy of what both sides share: they have to agree.
static_assert(rigor_client::kProtocol == kProtocolVersion);
static_assert(sizeof(rigor_client::PluginEntry) == sizeof(PluginEntry));
static_assert(offsetof(rigor_client::PluginEntry, protocol) == offsetof(PluginEntry, protocol));
static_assert(offsetof(rigor_client::PluginEntry, create) == offsetof(PluginEntry, create));
static_assert(offsetof(rigor_client::PluginEntry, start) == offsetof(PluginEntry, start));
static_assert(offsetof(rigor_client::PluginEntry, turn) == offsetof(PluginEntry, turn));
static_assert(offsetof(rigor_client::PluginEntry, finish) == offsetof(PluginEntry, finish));
static_assert(offsetof(rigor_client::PluginEntry, destroy) == offsetof(PluginEntry, destroy));
static_assert(std::is_same_v<decltype(rigor_client::PluginEntry::turn), decltype(PluginEntry::turn)>);
static_assert(std::is_same_v<decltype(rigor_client::PluginEntry::start), decltype(PluginEntry::start)>);
static_assert(std::is_same_v<decltype(rigor_client::PluginEntry::finish), decltype(PluginEntry::finish)>);
static_assert(sizeof(rigor_client::Point) == sizeof(LidarPoint));
static_assert(static_cast<int>(rigor_client::Kind::odometry) == static_cast<int>(SampleKind::odometry));
static_assert(static_cast<int>(rigor_client::Status::disconnected) ==
              static_cast<int>(PortStatus::disconnected));

template <class T>
T at(std::span<const std::byte> bytes, std::size_t offset) {
  T v{};
  EXPECT_LE(offset + sizeof v, bytes.size());
  if (offset + sizeof v <= bytes.size()) std::memcpy(&v, bytes.data() + offset, sizeof v);
  return v;
}

Sample sample_of(decltype(Sample::info) info) {
  Sample s;
  s.stamp.sequence = 7;
  s.stamp.t_capture = BenchTime(100);
  s.stamp.t_release = BenchTime(200);
  s.stamp.t_arrival = BenchTime(150);
  s.stamp.sigma_capture = Duration(3);
  s.stamp.lost_before = 2;
  s.stamp.validity = kSaturated;
  s.info = std::move(info);
  return s;
}

TEST(TurnMessage, HasItsNumbersWhereTheDocumentSays) {
  TurnMessage turn(3, 4096);
  turn.set_status(0, PortStatus::never);
  turn.set_status(1, PortStatus::fresh);
  turn.set_status(2, PortStatus::disconnected);
  RegisterBlock block;
  block.count = 2;
  block.value = {1.5, -2.5};
  ASSERT_TRUE(turn.add(1, sample_of(block), 4096));
  const auto bytes = turn.finish(42, BenchTime(1'000'000));
  EXPECT_EQ(at<std::uint32_t>(bytes, 0), bytes.size() - 8);
  EXPECT_EQ(at<std::uint32_t>(bytes, 4), 4U);
  EXPECT_EQ(at<std::uint64_t>(bytes, 8), 42U);
  EXPECT_EQ(at<std::int64_t>(bytes, 16), 1'000'000);
  EXPECT_EQ(at<std::uint32_t>(bytes, 24), 3U);
  EXPECT_EQ(at<std::uint32_t>(bytes, 28), 1U);
  EXPECT_EQ(at<std::uint32_t>(bytes, 32), 0U);
  EXPECT_EQ(at<std::uint32_t>(bytes, 36), 1U);
  EXPECT_EQ(at<std::uint32_t>(bytes, 40), 4U);
  constexpr std::size_t k = 48;  // three statuses and a gap
  EXPECT_EQ(at<std::uint32_t>(bytes, k), 1U);
  EXPECT_EQ(at<std::uint32_t>(bytes, k + 4), 5U);
  EXPECT_EQ(at<std::uint64_t>(bytes, k + 8), 7U);
  EXPECT_EQ(at<std::int64_t>(bytes, k + 16), 100);
  EXPECT_EQ(at<std::int64_t>(bytes, k + 24), 200);
  EXPECT_EQ(at<std::int64_t>(bytes, k + 32), 150);
  EXPECT_EQ(at<std::int64_t>(bytes, k + 40), 3);
  EXPECT_EQ(at<std::uint32_t>(bytes, k + 48), 2U);
  EXPECT_EQ(at<std::uint32_t>(bytes, k + 52), kSaturated);
  EXPECT_EQ(at<std::uint64_t>(bytes, k + 56), 4096U);
  EXPECT_EQ(at<std::uint64_t>(bytes, k + 64), 0U);
  EXPECT_EQ(at<std::uint32_t>(bytes, k + 72), 24U);
  EXPECT_EQ(at<std::uint32_t>(bytes, k + 80), 2U);
  EXPECT_EQ(at<double>(bytes, k + 88), 1.5);
  EXPECT_EQ(at<double>(bytes, k + 96), -2.5);
  EXPECT_EQ(bytes.size(), k + 104);
}

TEST(TurnMessage, RecordsOfEveryKindHaveTheirLengthAndLieAtMultiplesOfEight) {
  const std::pair<decltype(Sample::info), std::uint32_t> kinds[] = {
      {ImageInfo{}, 64}, {RangeImageInfo{}, 8}, {PointCloudInfo{}, 8}, {CanFrame{}, 72}, {RegisterBlock{}, 8},
      {Pose{}, 56},      {EventInfo{}, 456},    {ImuSample{}, 56},     {NavFix{}, 104},  {Odometry{}, 232}};
  for (const auto& [info, size] : kinds) {
    TurnMessage turn(1, 4096);
    ASSERT_TRUE(turn.add(0, sample_of(info), 0));
    const auto bytes = turn.finish(0, BenchTime(0));
    EXPECT_EQ(at<std::uint32_t>(bytes, 40 + 72), size) << info.index();
    EXPECT_EQ(bytes.size() % 8, 0U) << info.index();
  }
}

TEST(TurnMessage, WhatFindsNoRoomLeavesTheOthersAsTheyWere) {
  TurnMessage turn(1, 300);
  ASSERT_TRUE(turn.add(0, sample_of(Pose{}), 0));
  ASSERT_TRUE(turn.add(0, sample_of(Pose{}), 0));
  EXPECT_FALSE(turn.add(0, sample_of(Pose{}), 0));
  const auto bytes = turn.finish(1, BenchTime(0));
  EXPECT_EQ(at<std::uint32_t>(bytes, 28), 2U);
  EXPECT_EQ(bytes.size(), 40U + 2 * 136);
  EXPECT_EQ(turn.clear(), 2U);
  EXPECT_EQ(turn.finish(2, BenchTime(0)).size(), 40U);
}

std::vector<std::byte> answer(std::initializer_list<std::uint64_t> words) {
  std::vector<std::byte> out(words.size() * 8);
  std::memcpy(out.data(), words.begin(), out.size());
  return out;
}

TEST(AnswerReader, ReadsCommandsAndNothingThatIsNotOne) {
  const std::size_t outputs[] = {2, 1};
  const auto one = std::bit_cast<std::uint64_t>(1.0), two = std::bit_cast<std::uint64_t>(2.0);
  const auto good = answer({42, 2, 0 | std::uint64_t{2} << 32, one, two, 1 | std::uint64_t{1} << 32, two});
  AnswerReader reader;
  AnsweredCommand c;
  ASSERT_TRUE(reader.open(good));
  EXPECT_EQ(reader.cycle(), 42U);
  ASSERT_EQ(reader.next(outputs, c), AnswerReader::Next::command);
  EXPECT_EQ(c.output, 0U);
  EXPECT_EQ(c.value[1], 2.0);
  ASSERT_EQ(reader.next(outputs, c), AnswerReader::Next::command);
  EXPECT_EQ(c.output, 1U);
  EXPECT_EQ(reader.next(outputs, c), AnswerReader::Next::end);

  // Cut anywhere, it is malformed, and nothing beyond the cut is read.
  for (std::size_t n = 0; n < good.size(); ++n) {
    const std::vector<std::byte> cut(good.begin(), good.begin() + static_cast<std::ptrdiff_t>(n));
    if (!reader.open(cut)) {
      EXPECT_LT(n, 16U);
      continue;
    }
    AnswerReader::Next next;
    while ((next = reader.next(outputs, c)) == AnswerReader::Next::command) {
    }
    EXPECT_EQ(next, AnswerReader::Next::malformed) << n;
  }
  const auto malformed = [&](const std::vector<std::byte>& bytes) {
    ASSERT_TRUE(reader.open(bytes));
    EXPECT_EQ(reader.next(outputs, c), AnswerReader::Next::malformed);
  };
  malformed(answer({42, 1, 2 | std::uint64_t{1} << 32, one}));           // an output that does not exist
  malformed(answer({42, 1, 0 | std::uint64_t{1} << 32, one}));           // fewer values than it takes
  malformed(answer({42, 1, 1 | std::uint64_t{0xffffffff} << 32, one}));  // more than there are
  malformed(answer({42, 0, one}));                                       // bytes behind the end
}

}  // namespace
}  // namespace rigor::application
