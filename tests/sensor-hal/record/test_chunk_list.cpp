#include "sensor-hal/record/chunk_list.h"

#include <gtest/gtest.h>

#include <limits>
#include <random>

namespace rigor::record {
namespace {

void expect_same(const ChunkPlace& a, const ChunkPlace& b) {
  EXPECT_EQ(a.start_ns, b.start_ns);
  EXPECT_EQ(a.end_ns, b.end_ns);
  EXPECT_EQ(a.offset, b.offset);
  EXPECT_EQ(a.length, b.length);
  EXPECT_EQ(a.index_offsets, b.index_offsets);
  EXPECT_EQ(a.index_length, b.index_length);
  EXPECT_EQ(a.compressed, b.compressed);
  EXPECT_EQ(a.uncompressed, b.uncompressed);
}

void expect_round_trip(const std::vector<ChunkPlace>& chunks) {
  ChunkList list;
  for (const ChunkPlace& c : chunks) list.add(c);
  EXPECT_EQ(list.size(), chunks.size());
  ChunkList::Cursor cursor(list);
  for (const ChunkPlace& c : chunks) {
    const ChunkPlace* got = cursor.next();
    ASSERT_NE(got, nullptr);
    expect_same(*got, c);
  }
  EXPECT_EQ(cursor.next(), nullptr);
}

TEST(ChunkList, GivesBackWhatWasAdded) {
  expect_round_trip({});
  expect_round_trip({ChunkPlace{}});
  std::mt19937_64 random(1);
  std::vector<ChunkPlace> chunks(100);
  for (ChunkPlace& c : chunks) {
    // Numbers of any length, in no order at all.
    for (std::uint64_t* n :
         {&c.start_ns, &c.end_ns, &c.offset, &c.length, &c.index_length, &c.compressed, &c.uncompressed})
      *n = random() >> (random() % 64);
    c.index_offsets.resize(random() % 5);
    for (auto& [channel, offset] : c.index_offsets)
      channel = static_cast<std::uint16_t>(random()), offset = random();
  }
  expect_round_trip(chunks);
  ChunkPlace most;
  most.start_ns = most.end_ns = most.offset = most.length = most.index_length = most.compressed =
      most.uncompressed = std::numeric_limits<std::uint64_t>::max();
  most.index_offsets = {{65535, std::numeric_limits<std::uint64_t>::max()}, {0, 0}};
  expect_round_trip({most, ChunkPlace{}, most});
}

TEST(ChunkList, IsSmallForTheChunksOfABench) {
  // Half a second of 15 topics at up to 100 Hz.
  std::mt19937_64 random(2);
  ChunkList list;
  ChunkPlace c;
  std::uint64_t at = 1000;
  constexpr std::size_t kChunks = 7200;
  for (std::size_t i = 0; i < kChunks; ++i) {
    c.start_ns = 1'800'000'000'000'000'000 + i * 500'000'000 + random() % 5'000'000;
    c.end_ns = c.start_ns + 495'000'000 + random() % 5'000'000;
    c.offset = at;
    c.compressed = c.uncompressed = 60'000 + random() % 1000;
    c.length = c.compressed + 49;
    c.index_offsets.clear();
    c.index_length = 0;
    for (std::uint16_t topic = 0; topic < 15; ++topic) {
      c.index_offsets.emplace_back(topic, at + c.length + c.index_length);
      c.index_length += 15 + 16 * (1 + random() % 50);
    }
    at += c.length + c.index_length;
    list.add(c);
  }
  EXPECT_LT(list.packed_bytes(), 75 * kChunks);
}

}  // namespace
}  // namespace rigor::record
