// Runs of the demo rig, with their outputs in a folder of the test's own.
#pragma once

#include <gtest/gtest.h>
#include <openssl/sha.h>

#include <array>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/cli/command.h"

namespace rigor::test {

inline std::string sha256(const std::filesystem::path& file) {
  const std::string bytes = read_file(file);
  std::array<unsigned char, SHA256_DIGEST_LENGTH> digest{};
  SHA256(reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(), digest.data());
  return {digest.begin(), digest.end()};
}
inline nlohmann::json channel(const nlohmann::json& result, const std::string& name) {
  for (const nlohmann::json& c : result["channels"])
    if (c["name"] == name) return c;
  return {};
}

class Runs : public ::testing::Test {
 protected:
  [[nodiscard]] std::string file(const std::string& name) const { return (dir / name).string(); }
  /// The demo with its outputs in the test's own folder.
  std::vector<std::string> demo_words(const std::vector<std::string>& more) const {
    std::vector<std::string> words{"run",      config("demo.yaml"), "--record", file("run.mcap"),
                                   "--report", file("report")};
    words.insert(words.end(), more.begin(), more.end());
    return rigor_words(std::move(words));
  }
  /// It says a few times a second how it goes.
  std::vector<std::string> demo_with_progress(std::vector<std::string> more) const {
    more.insert(more.end(), {"--progress", "json"});
    return demo_words(std::move(more));
  }
  /// The same; it says nothing until it prints its result as JSON.
  std::vector<std::string> demo(std::vector<std::string> more) const {
    more.emplace_back("--json");
    return demo_words(std::move(more));
  }
  /// In virtual time, with cameras that are faster than a small machine could keep.
  std::vector<std::string> fast_demo(std::vector<std::string> more) const {
    for (const char* word : {"channels.left.rate_hz=25", "channels.left.latency_ms=100",
                             "channels.right.rate_hz=25", "channels.right.latency_ms=60"})
      more.insert(more.begin(), {"--set", word});
    more.insert(more.begin(), {"--clock", "virtual"});
    return demo(std::move(more));
  }
  /// Records the demo, then runs a rig that replays two of its channels on `clock`.
  void take_channels_from_a_recording(const std::string& clock) const {
    ASSERT_EQ(Command(fast_demo({"--duration", "1"})).wait().status, 0);
    write_file(
        dir / "rig.yaml",
        "channels:\n"
        "  right: { kind: image, backend: replay, file: run.mcap, rate_hz: 25, latency_ms: 60 }\n"
        "  table: { kind: registers, backend: replay, file: run.mcap, channel: turntable, rate_hz: 100, "
        "latency_ms: 10 }\n");
    const Said said = rigor({"run", "rig.yaml", "--clock", clock, "--duration", "0.9", "--json"}, dir.path());
    ASSERT_EQ(said.status, 0) << said.err;
    const auto result = nlohmann::json::parse(said.out);
    const auto samples = [&](const char* name) {
      const auto c = channel(result, name);
      return c["fresh"].get<int>() + c["superseded"].get<int>();
    };
    EXPECT_NEAR(samples("right"), 21, 3);
    EXPECT_NEAR(samples("table"), 88, 6);
  }
  TempDir dir;
};

}  // namespace rigor::test
