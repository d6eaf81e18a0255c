#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdio>
#include <fstream>

#include "sensor-hal/record/crc32.h"
#include "tests/sensor-hal/record/recording_fixture.h"

namespace rigor::record {
namespace {

using namespace test;

class EveryCompression : public testing::TestWithParam<Compression> {};
INSTANTIATE_TEST_SUITE_P(Record, EveryCompression,
                         testing::Values(Compression::none, Compression::lz4, Compression::zstd),
                         [](const auto& p) {
                           return p.param == Compression::none ? "none" : std::string(to_string(p.param));
                         });

TEST_P(EveryCompression, RoundTripsEveryMessageByIndexAndByScan) {
  const Recording recording = make_recording(small_chunks(GetParam()));
  for (const bool scan : {false, true}) {
    auto reader = open_bytes(recording.bytes, {.scan = scan});
    EXPECT_EQ(reader->health().indexed, !scan);
    EXPECT_TRUE(reader->health().good()) << testing::PrintToString(reader->health().notes);
    EXPECT_EQ(reader->profile(), "ros2");
    EXPECT_EQ(reader->library(), "rigor");
    EXPECT_EQ(reader->message_count(), recording.messages.size());
    EXPECT_GT(reader->segments().size(), 3u);
    EXPECT_EQ(read_all(*reader), recording.messages);
    EXPECT_EQ(reader->channels().at(0).metadata.count("offered_qos_profiles"), 1u);
    const auto metadata = must(reader->metadata());
    ASSERT_EQ(metadata.size(), 1u);
    EXPECT_EQ(metadata[0].values.at("seed"), "7");
    ASSERT_EQ(reader->attachment_count(), 1u);
    EXPECT_EQ(must(reader->attachment(0)).data, noise(40, 1));
  }
}

TEST_P(EveryCompression, SameMessagesGiveTheSameBytes) {
  EXPECT_EQ(make_recording(small_chunks(GetParam())).bytes, make_recording(small_chunks(GetParam())).bytes);
}

// The bytes of the uncompressed file belong to Rigor alone and may never change unseen. Files of this writer
// are read with @mcap/core in tests/npm; this digest was taken from our own output.
TEST(McapWriter, GoldenFileIsStable) {
  const Recording recording = make_recording(small_chunks());
  EXPECT_EQ(recording.bytes.size(), 5207u);
  EXPECT_EQ(crc32(recording.bytes), 789231225u);
}

TEST(McapWriter, ClosesChunksOnBenchTimeWithoutAMessageToo) {
  MemorySink memory;
  auto writer =
      must(McapWriter::open(std::make_unique<SharedSink>(memory), {.chunk_span = milliseconds(500)}));
  const auto channel = must(writer->add_channel({.topic = "/a"}));
  const auto data = noise(10, 1);
  must(writer->write({channel, 0, 1'000'000'000, 0}, Bytes(data)));
  must(writer->write({channel, 1, 1'499'999'999, 0}, Bytes(data)));
  must(writer->advance(1'499'999'999));
  EXPECT_EQ(writer->statistics().chunks, 0u);
  must(writer->advance(1'500'000'000));
  EXPECT_EQ(writer->statistics().chunks, 1u);
  auto reader = open_bytes(memory.bytes());
  EXPECT_EQ(reader->message_count(), 2u);
  must(writer->write({channel, 2, 1'500'000'001, 0}, Bytes(data)));
  must(writer->write({channel, 3, 2'500'000'001, 0}, Bytes(data)));
  EXPECT_EQ(writer->statistics().chunks, 2u);
}

TEST(McapWriter, PiecesAreJoinedInOrderOnBothPaths) {
  for (const std::size_t direct : {std::size_t{1}, std::size_t{1} << 20}) {
    MemorySink memory;
    auto writer = must(McapWriter::open(std::make_unique<SharedSink>(memory), {.direct_bytes = direct}));
    const auto channel = must(writer->add_channel({.topic = "/a"}));
    const auto whole = noise(1000, 2);
    const std::array<Bytes, 4> pieces{Bytes(whole).first(10), Bytes{}, Bytes(whole).subspan(10, 600),
                                      Bytes(whole).subspan(610)};
    must(writer->write({channel, 0, 1, 1}, pieces));
    must(writer->close());
    auto reader = open_bytes(memory.bytes());
    const auto kept = read_all(*reader);
    ASSERT_EQ(kept.size(), 1u);
    EXPECT_EQ(kept[0].data, whole);
    EXPECT_TRUE(open_bytes(memory.bytes(), {.scan = true})->health().good());
  }
}

TEST(McapWriter, RefusesWhatItWasNotTold) {
  auto writer = must(McapWriter::open(std::make_unique<MemorySink>()));
  EXPECT_EQ(writer->add_channel({.schema = 1, .topic = "/a"}).error().code, ErrorCode::internal);
  EXPECT_EQ(writer->write({0, 0, 0, 0}, Bytes{}).error().code, ErrorCode::internal);
  must(writer->close());
  EXPECT_EQ(writer->write({0, 0, 0, 0}, Bytes{}).error().code, ErrorCode::wrong_state);
  EXPECT_EQ(writer->add_metadata({}).error().code, ErrorCode::wrong_state);
  EXPECT_TRUE(writer->close());
}

TEST(McapWriter, EmptyRecordingIsComplete) {
  MemorySink memory;
  auto writer = must(McapWriter::open(std::make_unique<SharedSink>(memory)));
  must(writer->close());
  for (const bool scan : {false, true}) {
    auto reader = open_bytes(memory.bytes(), {.scan = scan});
    EXPECT_TRUE(reader->health().good()) << testing::PrintToString(reader->health().notes);
    EXPECT_TRUE(read_all(*reader).empty());
  }
}

/// Takes `room` bytes and then has no space left, as a disk: what fits of a call is kept.
class FullDisk final : public ByteSink {
 public:
  FullDisk(MemorySink& to, std::size_t room) : to_(&to), room_(room) {}
  Status append(Pieces pieces) override {
    for (const Bytes& piece : pieces) {
      const std::size_t fits = std::min(piece.size(), room_ - to_->bytes().size());
      const Bytes part = piece.first(fits);
      (void)to_->append({&part, 1});
      if (fits < piece.size()) return fail(ErrorCode::disk_full, "disk", "no space left");
    }
    return {};
  }
  Status truncate(std::uint64_t size) override { return to_->truncate(size); }
  Status sync() override { return {}; }
  std::string name() const override { return "disk"; }

 private:
  MemorySink* to_;
  std::size_t room_;
};

TEST(McapWriter, DiskFullAtAnyByteIsReportedAtOnceAndLeavesAReadableFile) {
  const Recording whole = make_recording(small_chunks(), 16);
  std::size_t complete = 0;
  for (std::size_t room = 0; room <= whole.bytes.size(); ++room) {
    MemorySink memory;
    auto writer = McapWriter::open(std::make_unique<FullDisk>(memory, room), small_chunks());
    if (!writer) {
      EXPECT_EQ(writer.error().code, ErrorCode::disk_full);
      EXPECT_TRUE(memory.bytes().empty());
      continue;
    }
    try {
      write_messages(**writer, 16);
      must((*writer)->add_metadata({"rig", {{"seed", "7"}, {"name", "bench"}}}));
      must((*writer)->add_attachment({"rig.yaml", "text/yaml", 5, 6, noise(40, 1)}));
    } catch (const std::runtime_error& e) {
      EXPECT_THAT(e.what(), testing::HasSubstr("no space left"));
      EXPECT_FALSE((*writer)->flush());
    }
    const Status closed = (*writer)->close();
    if (room == whole.bytes.size()) {
      EXPECT_TRUE(closed);
      EXPECT_EQ(memory.bytes(), whole.bytes);
      continue;
    }
    ASSERT_FALSE(closed) << "with room for " << room;
    EXPECT_EQ(closed.error().code, ErrorCode::disk_full);
    EXPECT_LE(memory.bytes().size(), room);
    auto reader = open_bytes(memory.bytes(), {.salvage_tail = false});
    EXPECT_EQ(reader->health().lost_bytes, 0u) << "the file must end with a whole record, room for " << room;
    EXPECT_EQ(reader->message_count(), (*writer)->statistics().messages);
    const auto kept = read_all(*reader);
    ASSERT_LE(kept.size(), whole.messages.size());
    EXPECT_TRUE(std::equal(kept.begin(), kept.end(), whole.messages.begin()));
    if (reader->health().indexed) ++complete;
  }
  EXPECT_GT(complete, 0u) << "the room of the lost chunk was never enough for a summary";
}

/// A chunk for each message, so that the summary goes to the sink in several pieces.
Status write_chunks(std::unique_ptr<ByteSink> sink, std::size_t count) {
  auto writer = must(McapWriter::open(std::move(sink), {.chunk_bytes = 1}));
  const auto channel = must(writer->add_channel({.topic = "/a"}));
  const auto data = noise(4, 1);
  for (std::size_t i = 0; i < count; ++i)
    must(writer->write({channel, static_cast<std::uint32_t>(i), i * 1000, 0}, Bytes(data)));
  return writer->close();
}

TEST(McapWriter, SummaryOfManyChunksIsWholeOrLeftAway) {
  constexpr std::size_t kChunks = 8000;  // of 85 bytes in the summary
  MemorySink memory;
  must(write_chunks(std::make_unique<SharedSink>(memory), kChunks));
  {
    auto reader = open_bytes(memory.bytes());
    EXPECT_TRUE(reader->health().indexed);
    EXPECT_TRUE(reader->health().good()) << testing::PrintToString(reader->health().notes);
    EXPECT_EQ(reader->segments().size(), kChunks);
    EXPECT_EQ(reader->message_count(), kChunks);
  }
  // The disk fills up in the last piece: those before it are taken back.
  MemorySink cut;
  const Status closed = write_chunks(std::make_unique<FullDisk>(cut, memory.bytes().size() - 1), kChunks);
  ASSERT_FALSE(closed);
  EXPECT_EQ(closed.error().code, ErrorCode::disk_full);
  auto reader = open_bytes(cut.bytes(), {.salvage_tail = false});
  EXPECT_FALSE(reader->health().indexed);
  EXPECT_EQ(reader->health().lost_bytes, 0u) << "the file must end with a whole record";
  EXPECT_EQ(reader->message_count(), kChunks);
  EXPECT_LT(cut.bytes().size(), memory.bytes().size() - 80 * kChunks);
}

TEST(McapWriter, DiskFullOfTheKernelIsReported) {
  auto sink = open_file_sink("/dev/full");
  if (!sink) GTEST_SKIP() << "no /dev/full here: " << sink.error().text();
  const auto writer = McapWriter::open(std::move(*sink));
  ASSERT_FALSE(writer);
  EXPECT_EQ(writer.error().code, ErrorCode::disk_full);
}

TEST(FileSink, WritesTheSameBytesAsMemory) {
  const std::string path = testing::TempDir() + "rigor_file_sink.mcap";
  {
    auto sink = must(open_file_sink(path, {.sync_period = milliseconds(1)}));
    auto writer = must(McapWriter::open(std::move(sink), small_chunks()));
    write_messages(*writer, 24);
    must(writer->add_metadata({"rig", {{"seed", "7"}, {"name", "bench"}}}));
    must(writer->add_attachment({"rig.yaml", "text/yaml", 5, 6, noise(40, 1)}));
    must(writer->close());
    must(writer->sync());
  }
  std::ifstream in(path, std::ios::binary);
  const std::string text((std::istreambuf_iterator<char>(in)), {});
  const Bytes bytes = std::as_bytes(std::span(text));
  const auto expected = make_recording(small_chunks()).bytes;
  EXPECT_TRUE(std::equal(bytes.begin(), bytes.end(), expected.begin(), expected.end()));
  EXPECT_FALSE(open_file_sink(path, {.overwrite = false}));
  std::remove(path.c_str());
}

TEST(FileSink, WritesPiecesLongerThanOneCallTakesInOrder) {
  const std::string path = testing::TempDir() + "rigor_file_sink_pieces.bin";
  std::vector<std::vector<std::byte>> kept;
  std::vector<Bytes> pieces;
  std::vector<std::byte> expected;
  for (const std::size_t size : {1u, 300000u, 0u, 131071u, 131072u, 131073u, 7u}) {
    kept.push_back(noise(size, static_cast<std::uint32_t>(kept.size())));
    expected.insert(expected.end(), kept.back().begin(), kept.back().end());
  }
  for (const auto& piece : kept) pieces.emplace_back(piece);
  {
    auto sink = must(open_file_sink(path));
    must(sink->append(pieces));
  }
  std::ifstream in(path, std::ios::binary);
  const std::string text((std::istreambuf_iterator<char>(in)), {});
  const Bytes bytes = std::as_bytes(std::span(text));
  EXPECT_TRUE(std::equal(bytes.begin(), bytes.end(), expected.begin(), expected.end()));
  std::remove(path.c_str());
}

TEST(FileSink, SaysWhatCannotBeCreated) {
  const auto sink = open_file_sink("/nonexistent/there.mcap");
  ASSERT_FALSE(sink);
  EXPECT_EQ(sink.error().code, ErrorCode::not_writable);
  EXPECT_THAT(sink.error().text(), testing::HasSubstr("/nonexistent/there.mcap"));
}

}  // namespace
}  // namespace rigor::record
