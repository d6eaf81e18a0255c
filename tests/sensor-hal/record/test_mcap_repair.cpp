#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <fstream>

#include "sensor-hal/record/mcap_repair.h"
#include "tests/sensor-hal/record/recording_fixture.h"

namespace rigor::record {
namespace {

using namespace test;

TEST(Repair, MakesACompleteFileOutOfOneCutAtAnyByte) {
  for (const Compression compression : {Compression::none, Compression::zstd}) {
    const Recording recording = make_recording(small_chunks(compression), 16);
    for (std::size_t cut = kMagic.size(); cut <= recording.bytes.size(); ++cut) {
      const Bytes bytes = Bytes(recording.bytes).first(cut);
      MemorySink memory;
      const RepairReport report = must(repair(memory_source(bytes), std::make_unique<SharedSink>(memory)));
      EXPECT_EQ(report.was_good, cut == recording.bytes.size());
      EXPECT_EQ(report.output_bytes, memory.bytes().size());
      auto reader = open_bytes(memory.bytes());
      ASSERT_TRUE(reader->health().indexed) << "cut at " << cut;
      ASSERT_TRUE(open_bytes(memory.bytes(), {.scan = true})->health().good());
      auto before = open_bytes(bytes, {.scan = true});
      const auto kept = read_all(*reader);
      ASSERT_EQ(kept, read_all(*before)) << "cut at " << cut;
      EXPECT_EQ(report.messages, kept.size());
      if (cut == recording.bytes.size()) {
        EXPECT_EQ(must(reader->metadata()).size(), 1u);
        EXPECT_EQ(reader->attachment_count(), 1u);
      }
    }
  }
}

TEST(Repair, KeepsTheOriginalAndLeavesNoTemporaryFile) {
  const std::string folder = testing::TempDir();
  const std::string path = folder + "rigor_repair_in.mcap";
  const std::string out = folder + "rigor_repair_out.mcap";
  const Recording recording = make_recording(small_chunks());
  const std::size_t cut = recording.bytes.size() / 2;
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(recording.bytes.data()), static_cast<std::streamsize>(cut));
  const RepairReport report = must(repair(path, out));
  EXPECT_FALSE(report.was_good);
  EXPECT_TRUE(report.health.truncated);
  EXPECT_EQ(must(open_file_source(path))->size(), cut);
  EXPECT_TRUE(must(McapReader::open(out))->health().indexed);
  EXPECT_NE(::access((out + ".repair").c_str(), F_OK), 0);
  must(repair(path, path));  // asked to replace it
  EXPECT_TRUE(must(McapReader::open(path))->health().indexed);
  EXPECT_EQ(repair(folder + "nothing.mcap", out).error().code, ErrorCode::not_found);
  EXPECT_EQ(repair(path, "/nonexistent/x.mcap").error().code, ErrorCode::not_writable);
  std::remove(path.c_str());
  std::remove(out.c_str());
}

TEST(Repair, AKilledWriterLosesLessThanTheLastSecondOfBenchTime) {
  const std::string path = testing::TempDir() + "rigor_killed.mcap";
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    auto writer = must(McapWriter::open(must(open_file_sink(path))));
    const auto channel = must(writer->add_channel({.topic = "/a"}));
    for (std::uint32_t i = 0; i < 5000; ++i)  // 5 s at 1 kHz
      must(writer->write({channel, i, i * 1'000'000ull, i * 1'000'000ull}, Bytes(noise(20, i))));
    ::raise(SIGKILL);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  ASSERT_TRUE(WIFSIGNALED(status));
  auto reader = must(McapReader::open(path));
  EXPECT_TRUE(reader->health().truncated);
  const auto kept = read_all(*reader);
  ASSERT_FALSE(kept.empty());
  EXPECT_GE(kept.back().log_time_ns, 4'000'000'000u);
  EXPECT_EQ(kept.size(), kept.back().sequence + 1u);
  std::remove(path.c_str());
}

}  // namespace
}  // namespace rigor::record
