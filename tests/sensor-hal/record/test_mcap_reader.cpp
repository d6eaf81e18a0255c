#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "sensor-hal/record/mcap_parse.h"
#include "tests/sensor-hal/record/recording_fixture.h"

namespace rigor::record {
namespace {

using namespace test;
using testing::HasSubstr;

TEST(McapReader, GivesMessagesByLogTimeThenFileOrderAcrossChunks) {
  MemorySink memory;
  auto writer = must(McapWriter::open(std::make_unique<SharedSink>(memory), small_chunks()));
  const auto channel = must(writer->add_channel({.topic = "/a"}));
  std::vector<std::pair<std::uint64_t, std::uint32_t>> expected;
  std::minstd_rand random(9);
  for (std::uint32_t i = 0; i < 400; ++i) {  // times jump back and forth over many chunks, with repeats
    const std::uint64_t t = 1000 + i / 8 + random() % 40;
    must(writer->write({channel, i, t, t}, Bytes(noise(30, i))));
    expected.emplace_back(t, i);
  }
  must(writer->close());
  std::stable_sort(expected.begin(), expected.end(), [](auto& a, auto& b) { return a.first < b.first; });
  for (const bool scan : {false, true}) {
    auto reader = open_bytes(memory.bytes(), {.scan = scan});
    EXPECT_GT(reader->segments().size(), 20u);
    std::vector<std::pair<std::uint64_t, std::uint32_t>> got;
    for (const Kept& m : read_all(*reader)) got.emplace_back(m.log_time_ns, m.sequence);
    EXPECT_EQ(got, expected);
    std::uint32_t i = 0;
    for (const Kept& m : read_all(*reader, {.order = MessageOrder::file})) EXPECT_EQ(m.sequence, i++);
  }
}

TEST(McapReader, FiltersByTopicAndTime) {
  const Recording recording = make_recording(small_chunks());
  auto reader = open_bytes(recording.bytes);
  std::vector<Kept> expected;
  for (const Kept& m : recording.messages)
    if (m.topic == "/b" && m.log_time_ns >= 1'050'000'000 && m.log_time_ns <= 1'190'000'000)
      expected.push_back(m);
  ASSERT_EQ(expected.size(), 4u);
  EXPECT_EQ(read_all(*reader, {.topics = {"/b"}, .start_ns = 1'050'000'000, .end_ns = 1'190'000'000}),
            expected);
  EXPECT_TRUE(read_all(*reader, {.topics = {"/nothing"}}).empty());
}

/// Ends of the chunks (with their indexes) of an intact file.
std::vector<std::size_t> chunk_ends(Bytes file) {
  std::vector<std::size_t> ends;
  FieldReader in(file);
  in.take(kMagic.size());
  while (const auto record = next_record(in)) {
    if (record->op == Opcode::chunk) ends.push_back(in.position());
    if (record->op == Opcode::data_end) break;
  }
  return ends;
}

class CutShort : public testing::TestWithParam<Compression> {};
INSTANTIATE_TEST_SUITE_P(Record, CutShort,
                         testing::Values(Compression::none, Compression::lz4, Compression::zstd),
                         [](const auto& p) {
                           return p.param == Compression::none ? "none" : std::string(to_string(p.param));
                         });

TEST_P(CutShort, AtAnyByteGivesExactlyTheWholeChunksBefore) {
  const Recording recording = make_recording(small_chunks(GetParam()), 16);
  const auto ends = chunk_ends(recording.bytes);
  auto whole = open_bytes(recording.bytes, {.scan = true});
  ASSERT_EQ(whole->segments().size(), ends.size());
  std::uint64_t unverified = 0;
  for (std::size_t cut = 0; cut < recording.bytes.size(); ++cut) {
    const Bytes bytes = Bytes(recording.bytes).first(cut);
    if (cut < kMagic.size()) {
      const auto reader = McapReader::open(memory_source(bytes));
      ASSERT_FALSE(reader);
      EXPECT_EQ(reader.error().code, ErrorCode::bad_input);
      continue;
    }
    std::size_t expected = 0;
    for (std::size_t i = 0; i < ends.size(); ++i)
      if (ends[i] <= cut) expected += whole->segments()[i].messages;
    auto reader = open_bytes(bytes, {.salvage_tail = false});
    EXPECT_TRUE(reader->health().truncated);
    EXPECT_LE(reader->health().whole_bytes, cut);
    EXPECT_EQ(reader->health().whole_bytes + reader->health().lost_bytes, cut);
    const auto kept = read_all(*reader);
    ASSERT_EQ(kept.size(), expected) << "cut at byte " << cut;
    EXPECT_EQ(reader->message_count(), expected);
    EXPECT_TRUE(std::equal(kept.begin(), kept.end(), recording.messages.begin()));

    auto salvaging = open_bytes(bytes);
    const auto more = read_all(*salvaging);
    EXPECT_EQ(more.size(), expected + salvaging->health().unverified_messages);
    ASSERT_TRUE(std::equal(more.begin(), more.end(), recording.messages.begin()));
    unverified += salvaging->health().unverified_messages;
  }
  EXPECT_EQ(unverified > 0, GetParam() == Compression::none);
}

TEST_P(CutShort, EveryFlippedByteIsFound) {
  const Recording recording = make_recording(small_chunks(GetParam()), 8);
  std::vector<std::byte> bytes = recording.bytes;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    bytes[i] ^= std::byte{0x10};
    auto reader = McapReader::open(memory_source(bytes), {.scan = true});
    // The footer's pointer to the summary offsets and the summary itself are not used by a scan.
    const bool by_scan = !reader || !(*reader)->health().good();
    auto indexed = McapReader::open(memory_source(bytes));
    const bool by_index = !indexed || !(*indexed)->health().good();
    EXPECT_TRUE(by_scan || by_index) << "byte " << i;
    bytes[i] ^= std::byte{0x10};
  }
}

TEST(McapReader, DamagedChunkStopsWithItsPlaceOrIsPassedOver) {
  const Recording recording = make_recording(small_chunks());
  auto bytes = recording.bytes;
  const auto ends = chunk_ends(bytes);
  bytes[ends[1] - 5] ^= std::byte{1};  // within the data of the second chunk's last message
  {
    auto reader = open_bytes(bytes);
    ASSERT_TRUE(reader->health().indexed);
    MessageCursor cursor = reader->messages();
    MessageView m;
    Result<bool> more = true;
    while (more && *more) more = cursor.next(m);
    ASSERT_FALSE(more);
    EXPECT_THAT(more.error().text(), HasSubstr("checksum of this chunk"));
    EXPECT_THAT(more.error().text(), HasSubstr("byte "));
  }
  auto reader = open_bytes(bytes, {.scan = true, .skip_damaged = true});
  EXPECT_EQ(reader->health().damaged_chunks, 1u);
  const auto kept = read_all(*reader);
  EXPECT_LT(kept.size(), recording.messages.size());
  EXPECT_GT(kept.size(), recording.messages.size() / 2);
}

TEST(McapReader, TellsFilesThatAreNoRecordings) {
  const auto bytes = noise(500, 1);
  const auto reader = McapReader::open(memory_source(bytes, "x.mcap"));
  ASSERT_FALSE(reader);
  EXPECT_EQ(reader.error().code, ErrorCode::bad_input);
  EXPECT_THAT(reader.error().text(), HasSubstr("x.mcap: expected an MCAP recording"));
  EXPECT_EQ(McapReader::open("/nonexistent.mcap").error().code, ErrorCode::not_found);
  EXPECT_EQ(McapReader::open("/").error().code, ErrorCode::bad_input);
}

/// Every u16/u32/u64 of a small file replaced by hostile numbers: never a crash, a hang or a large
/// allocation; the sanitizer lanes run this too.
TEST_P(CutShort, SurvivesHostileLengths) {
  Recording recording = make_recording(small_chunks(GetParam()), 8);
  const std::uint64_t hostile[] = {
      0, 1, 0x7fffffff, 0xffffffff, 0x7fffffffffffffff, 0xffffffffffffffff, 0xfffffffffffffff7};
  for (std::size_t at = kMagic.size(); at + 8 <= recording.bytes.size(); ++at)
    for (const std::uint64_t value : hostile)
      for (const std::size_t width : {4u, 8u}) {
        auto bytes = recording.bytes;
        std::memcpy(bytes.data() + at, &value, width);
        for (const bool scan : {false, true}) {
          auto reader = McapReader::open(memory_source(bytes),
                                         {.scan = scan, .skip_damaged = true, .max_loaded_bytes = 1u << 20});
          if (!reader) continue;
          MessageCursor cursor = (*reader)->messages();
          MessageView m;
          std::size_t n = 0;
          for (Result<bool> more = true; more && *more; more = cursor.next(m)) ASSERT_LT(++n, 100u);
          (void)(*reader)->metadata();
          for (std::size_t i = 0; i < (*reader)->attachment_count(); ++i) (void)(*reader)->attachment(i);
        }
      }
}

TEST(McapReader, RefusesMoreOverlapThanItMayHold) {
  MemorySink memory;
  auto writer = must(McapWriter::open(std::make_unique<SharedSink>(memory), small_chunks()));
  const auto channel = must(writer->add_channel({.topic = "/a"}));
  for (std::uint32_t i = 0; i < 100; ++i)
    must(writer->write({channel, i, i % 2 == 0 ? 0ull : 1000ull, 0}, Bytes(noise(300, i))));
  must(writer->close());
  auto reader = open_bytes(memory.bytes(), {.max_loaded_bytes = 20'000});
  MessageCursor cursor = reader->messages();
  MessageView m;
  EXPECT_TRUE(cursor.next(m).has_value());  // zeros come chunk by chunk …
  MemorySink overlapping;
  writer = must(McapWriter::open(std::make_unique<SharedSink>(overlapping),
                                 {.chunk_bytes = 512, .direct_bytes = 4096}));
  const auto again = must(writer->add_channel({.topic = "/a"}));
  for (std::uint32_t i = 0; i < 100; ++i)
    must(writer->write({again, i, i % 2 == 0 ? 0ull : 1000ull, 0}, Bytes(noise(300, i))));
  must(writer->close());
  reader = open_bytes(overlapping.bytes(), {.max_loaded_bytes = 20'000});
  MessageCursor other = reader->messages();
  Result<bool> more = true;
  while (more && *more) more = other.next(m);
  ASSERT_FALSE(more);  // … but here every chunk stays open to the end
  EXPECT_THAT(more.error().text(), HasSubstr("overlap in time"));
  EXPECT_EQ(read_all(*reader, {.order = MessageOrder::file}).size(), 100u);
}

// Other writers leave out chunks: bare records, as the format allows.
TEST(McapReader, ReadsRecordsOutsideOfChunks) {
  ByteBuffer file;
  file.append(kMagic.data(), kMagic.size());
  const auto record = [&](Opcode op, auto&& body) {
    ByteBuffer b;
    body(b);
    file.put(op);
    file.put(std::uint64_t{b.size()});
    file.append(b.bytes());
  };
  record(Opcode::header, [](ByteBuffer& b) { b.put(std::string_view("")), b.put(std::string_view("bare")); });
  record(Opcode::channel, [](ByteBuffer& b) {
    b.put(std::uint16_t{3}), b.put(std::uint16_t{0}), b.put(std::string_view("/x")),
        b.put(std::string_view("json"));
    b.put(StringMap{});
  });
  for (std::uint64_t t : {30ull, 10ull, 20ull})
    record(Opcode::message, [&](ByteBuffer& b) {
      b.put(std::uint16_t{3}), b.put(static_cast<std::uint32_t>(t)), b.put(t), b.put(t),
          b.put(std::string_view("{}"));
    });
  const std::size_t data_end = file.size();
  record(Opcode::data_end, [](ByteBuffer& b) { b.put(std::uint32_t{0}); });
  record(Opcode::footer,
         [](ByteBuffer& b) { b.put(std::uint64_t{0}), b.put(std::uint64_t{0}), b.put(std::uint32_t{0}); });
  file.append(kMagic.data(), kMagic.size());
  auto reader = open_bytes(file.bytes());
  EXPECT_TRUE(reader->health().good()) << testing::PrintToString(reader->health().notes);
  std::vector<std::uint64_t> times;
  for (const Kept& m : read_all(*reader)) times.push_back(m.log_time_ns);
  EXPECT_EQ(times, (std::vector<std::uint64_t>{10, 20, 30}));
  auto cut = open_bytes(file.bytes().first(data_end - 5));
  EXPECT_EQ(read_all(*cut).size(), 2u);
  EXPECT_TRUE(cut->health().truncated);
}

}  // namespace
}  // namespace rigor::record
