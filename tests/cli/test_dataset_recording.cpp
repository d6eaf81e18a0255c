// `rigor dataset -o FILE.mcap`: the same samples as the folder's, as messages that other programs read.
#include <gmock/gmock.h>
#include <signal.h>
#include <sys/file.h>
#include <unistd.h>

#include <cstring>
#include <map>
#include <nlohmann/json.hpp>

#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/ros2_messages.h"
#include "tests/cli/sensing_fixture.h"

namespace rigor::test {
namespace {

namespace fs = std::filesystem;
namespace msg = record::msg;
using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;

/// A message of the type M. It points into `bytes`.
template <class M>
M message_of(const std::string& bytes) {
  M m;
  const Status read = record::CdrReader::read(std::as_bytes(std::span(bytes)), m);
  EXPECT_TRUE(read) << read.error().text();
  return m;
}

class DatasetRecordingCommand : public SensingBench {
 protected:
  static std::vector<std::string> words(std::vector<std::string> more) {
    std::vector<std::string> all{"dataset", "rig.yaml", "--channels", "camera,flat"};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  Said make(std::vector<std::string> more) { return in_dir(words(std::move(more))); }

  struct Message {
    std::uint64_t t_ns;
    std::string type, bytes;
  };
  /// All messages by topic.
  std::map<std::string, std::vector<Message>> messages(const std::string& file) {
    auto reader = record::McapReader::open((dir / file).string());
    EXPECT_TRUE(reader) << reader.error().text();
    EXPECT_TRUE((*reader)->health().good());
    std::map<std::string, std::vector<Message>> all;
    auto cursor = (*reader)->messages();
    record::MessageView m;
    while (cursor.next(m).value())
      all[m.channel->topic].push_back(
          {m.log_time_ns, m.schema->name,
           std::string(reinterpret_cast<const char*>(m.data.data()), m.data.size())});
    return all;
  }
};

TEST_F(DatasetRecordingCommand, HoldsWhatTheFolderHolds) {
  ASSERT_EQ(make({"--sample", "2", "--seed", "4", "-o", "folder"}).status, 0);
  const Said said = make({"--sample", "2", "--seed", "4", "-o", "data.mcap"});
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_THAT(said.out, HasSubstr("data.mcap: 2 of 2 samples"));
  auto found = messages("data.mcap");
  ASSERT_EQ(found["/samples"].size(), 2u);
  for (std::size_t k = 0; k < 2; ++k) {
    EXPECT_EQ(found["/samples"][k].t_ns, k * 1'000'000'000);
    const json here = json::parse(found["/samples"][k].bytes);
    json there = json::parse(read_file(dir / ("folder/samples/00000" + std::to_string(k) + ".json")));
    for (auto& [name, channel] : there["channels"].items()) channel.erase("files");
    EXPECT_EQ(here, there);
  }
  const auto picture = message_of<msg::Image>(found["/camera/image"].at(1).bytes);
  EXPECT_EQ(picture.encoding, "mono8");
  const auto depth = message_of<msg::Image>(found["/camera/truth/depth"].at(1).bytes);
  EXPECT_EQ(depth.encoding, "32FC1");
  // The folder's array, behind its header.
  const std::string npy = read_file(dir / "folder/camera/depth/000001.npy");
  ASSERT_GT(npy.size(), depth.data.size());
  EXPECT_EQ(std::memcmp(npy.data() + npy.size() - depth.data.size(), depth.data.data(), depth.data.size()),
            0);
  const auto info = message_of<msg::CameraInfo>(found["/camera/camera_info"].at(0).bytes);
  EXPECT_EQ(info.width, picture.width);
  const auto labels = message_of<msg::PointCloud2>(found["/flat/truth"].at(0).bytes);
  const auto points = message_of<msg::PointCloud2>(found["/flat/points"].at(0).bytes);
  EXPECT_EQ(labels.width, points.width);
  EXPECT_EQ(found["/tf"].size(), 2u);
}

TEST_F(DatasetRecordingCommand, GoesOnAfterAKillAsIfNothingHadHappened) {
  // Most of them are made after the kill, however late it comes.
  constexpr const char* kSamples = "40";
  ASSERT_EQ(make({"--sample", kSamples, "-o", "whole.mcap"}).status, 0);
  for (int kill = 1; kill <= 2; ++kill) {
    Command running(rigor_words(words({"--sample", kSamples, "-o", "killed.mcap"})), dir.path());
    std::error_code ec;
    const auto begun = [&] { return fs::file_size(dir / ".killed.mcap.part", ec); };
    while (running.running() &&
           (begun() == static_cast<std::uintmax_t>(-1) || begun() < 30'000U * static_cast<unsigned>(kill)))
      usleep(500);
    running.signal(SIGKILL);
    (void)running.wait();
    EXPECT_FALSE(fs::exists(dir / "killed.mcap"));
  }
  const Said said = make({"--sample", kSamples, "-o", "killed.mcap", "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_GT(json::parse(said.out)["there"].get<int>(), 0);
  EXPECT_EQ(read_file(dir / "whole.mcap"), read_file(dir / "killed.mcap"));
  EXPECT_FALSE(fs::exists(dir / ".killed.mcap.part"));
  EXPECT_FALSE(fs::exists(dir / ".killed.mcap.part.old"));
}

TEST_F(DatasetRecordingCommand, LosesNoSampleOfTheFileWhenItIsKilledWhileItCopiesThem) {
  ASSERT_EQ(make({"--sample", "4", "--only", "0..1", "-o", "data.mcap"}).status, 0);
  // What a process leaves that is killed before its first sample is copied: the start of a recording.
  write_file(dir / ".data.mcap.part", read_file(dir / "data.mcap").substr(0, 60));
  const Said said = make({"--sample", "4", "--only", "2..3", "-o", "data.mcap", "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_EQ(json::parse(said.out)["samples"], 4);
  EXPECT_EQ(messages("data.mcap")["/samples"].size(), 4u);
  EXPECT_FALSE(fs::exists(dir / ".data.mcap.part.old"));
}

TEST_F(DatasetRecordingCommand, RefusesAFileThatIsNotItsOwn) {
  ASSERT_EQ(make({"--sample", "1", "-o", "data.mcap"}).status, 0);
  const std::string before = read_file(dir / "data.mcap");
  const Said other = make({"--sample", "1", "--seed", "9", "-o", "data.mcap"});
  EXPECT_EQ(other.status, 2);
  EXPECT_THAT(other.err, AllOf(HasSubstr("data.mcap"), HasSubstr("options.seed is 1 there, and 9 here")));
  const Said again = make({"--sample", "1", "-o", "data.mcap", "--json"});
  ASSERT_EQ(again.status, 0) << again.err;
  EXPECT_EQ(json::parse(again.out)["there"], 1);
  EXPECT_EQ(read_file(dir / "data.mcap"), before);
  write_file(dir / "text.mcap", "no recording");
  EXPECT_EQ(make({"--sample", "1", "-o", "text.mcap"}).status, 2);
  EXPECT_EQ(read_file(dir / "text.mcap"), "no recording");
  EXPECT_FALSE(fs::exists(dir / ".text.mcap.part"));
}

TEST_F(DatasetRecordingCommand, HasItsFileForItselfAlone) {
  const int held = ::open((dir / ".data.mcap.part").c_str(), O_RDWR | O_CREAT, 0666);
  ASSERT_EQ(::flock(held, LOCK_EX | LOCK_NB), 0);
  const Said said = make({"--sample", "1", "-o", "data.mcap"});
  EXPECT_TRUE(fs::exists(dir / ".data.mcap.part")) << "it is the other process's";
  ::close(held);
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, HasSubstr("another process is writing this dataset"));
}

}  // namespace
}  // namespace rigor::test
