// Random access to the messages of a recording.
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "sensor-hal/record/message_access.h"
#include "tests/sensor-hal/record/recording_fixture.h"

namespace rigor::record::test {
namespace {

class MessageAccessTest : public ::testing::TestWithParam<Compression> {
 protected:
  void SetUp() override {
    dir_ = std::filesystem::temp_directory_path() / ("rigor-access-" + std::to_string(::getpid()) + "-" +
                                                     std::to_string(reinterpret_cast<std::uintptr_t>(this)));
    std::filesystem::create_directories(dir_);
  }
  void TearDown() override { std::filesystem::remove_all(dir_); }

  std::string write(const std::vector<std::byte>& bytes) {
    const std::filesystem::path file = dir_ / "run.mcap";
    std::ofstream(file, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    return file.string();
  }
  static std::uint16_t channel(MessageAccess& access, const std::string& topic) {
    for (const auto& [id, c] : access.reader().channels())
      if (c.topic == topic) return id;
    return 999;
  }
  /// All messages of a topic, the last one first.
  static std::vector<Kept> backwards(MessageAccess& access, const std::string& topic) {
    std::vector<Kept> kept;
    const auto places = must(access.places(channel(access, topic)));
    for (std::size_t i = places.size(); i-- > 0;) {
      const HeldMessage m = must(access.at(places[i]));
      kept.push_back({topic, m.sequence, m.log_time_ns, m.publish_time_ns, {m.data.begin(), m.data.end()}});
    }
    return kept;
  }
  static std::vector<Kept> reversed(const Recording& recording, const std::string& topic) {
    std::vector<Kept> kept;
    for (auto m = recording.messages.rbegin(); m != recording.messages.rend(); ++m)
      if (m->topic == topic) kept.push_back(*m);
    return kept;
  }

  std::filesystem::path dir_;
};

TEST_P(MessageAccessTest, GivesEveryMessageInAnyOrderAsItWasWritten) {
  const Recording recording = make_recording(small_chunks(GetParam()));
  for (const std::uint64_t cache_bytes : {std::uint64_t{0}, std::uint64_t{1} << 20}) {
    const auto access = must(MessageAccess::open(write(recording.bytes), {.cache_bytes = cache_bytes}));
    for (const char* topic : {"/a", "/b"}) EXPECT_EQ(backwards(*access, topic), reversed(recording, topic));
    EXPECT_TRUE(must(access->places(999)).empty());
  }
}

TEST_P(MessageAccessTest, ReadsAFileThatWasNeverClosed) {
  const Recording recording = make_recording(small_chunks(GetParam()), 24, false);
  const auto access = must(MessageAccess::open(write(recording.bytes)));
  const auto found = backwards(*access, "/a");
  const auto written = reversed(recording, "/a");
  ASSERT_GT(found.size(), 3u);
  EXPECT_TRUE(std::equal(found.rbegin(), found.rend(), written.rbegin()))
      << "what is there is what was written first";
}

TEST_P(MessageAccessTest, KeepsTheBytesOfAMessageAsLongAsItIsHeld) {
  const Recording recording = make_recording(small_chunks(GetParam()));
  auto access = must(MessageAccess::open(write(recording.bytes), {.cache_bytes = 0}));
  const auto places = must(access->places(channel(*access, "/b")));
  const HeldMessage first = must(access->at(places[0]));
  for (const MessagePlace& place : places) (void)must(access->at(place));
  access.reset();
  const Kept expected = reversed(recording, "/b").back();
  EXPECT_EQ((std::vector<std::byte>(first.data.begin(), first.data.end())), expected.data);
}

TEST_P(MessageAccessTest, RefusesAChunkWhoseBytesWereChanged) {
  Recording recording = make_recording(small_chunks(GetParam()));
  const auto reader = open_bytes(recording.bytes);
  const Segment segment = reader->segments()[1];
  recording.bytes[segment.offset + segment.length - 3] ^= std::byte{0x10};
  const auto access = must(MessageAccess::open(write(recording.bytes)));
  bool refused = false;
  for (const char* topic : {"/a", "/b"}) {
    const auto places = access->places(channel(*access, topic));
    if (!places) {
      refused = true;
      continue;
    }
    for (const MessagePlace& place : *places)
      if (const auto m = access->at(place); !m) {
        refused = true;
        EXPECT_EQ(m.error().code, ErrorCode::protocol);
        EXPECT_EQ(place.segment, 1u);
      }
  }
  EXPECT_TRUE(refused);
}

TEST_P(MessageAccessTest, RefusesPlacesThatPointAtNoMessage) {
  const Recording recording = make_recording(small_chunks(GetParam()));
  const auto access = must(MessageAccess::open(write(recording.bytes)));
  MessagePlace place = must(access->places(channel(*access, "/a")))[2];
  place.offset += 1;
  EXPECT_FALSE(access->at(place));
  place.offset = 1u << 30;
  EXPECT_FALSE(access->at(place));
  place.segment = 1u << 20;
  EXPECT_FALSE(access->at(place));
}

INSTANTIATE_TEST_SUITE_P(Compressions, MessageAccessTest,
                         ::testing::Values(Compression::none, Compression::lz4, Compression::zstd));

TEST(MessageAccess, SaysWhatCannotBeOpened) {
  EXPECT_EQ(MessageAccess::open("/no/such/file.mcap").error().code, ErrorCode::not_found);
  EXPECT_EQ(MessageAccess::open("/tmp").error().code, ErrorCode::bad_input);
}

}  // namespace
}  // namespace rigor::record::test
