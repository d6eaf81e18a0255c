// Sweeps of a rig whose runs take a moment, in a folder of the test's own.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "tests/cli/command.h"

namespace rigor::test {

class Sweep : public ::testing::Test {
 protected:
  /// Which samples are lost depends on the seed, so that runs differ; their number decides whether one
  /// passes.
  Sweep() {
    write_file(dir / "rig.yaml", R"(
name: quick
seed: 1
duration_s: 0.5
clock: virtual
loop: { rate_hz: 100 }
simulation: { world: )" + config("worlds/turntable.yaml") +
                                     R"( }
channels:
  wave:
    kind: registers
    backend: simulated
    rate_hz: 50
    latency_ms: 10
    signals: { x: { sine: { amplitude: 2, period_s: 0.7 } } }
    faults: [{ kind: drop, probability: 0.2 }]
expect:
  - { of: wave.x, value: { max: 3 } }
)");
  }
  static constexpr std::size_t kRuns = 12;
  /// kRuns runs, all of which pass; with other seeds than 3 more or fewer.
  static std::vector<std::string> more_runs(const std::vector<std::string>& more,
                                            const std::string& seeds = "3") {
    std::vector<std::string> words{"--vary",  "channels.wave.signals.x.sine.amplitude=1,2",
                                   "--vary",  "channels.wave.faults.0.probability=0.1,0.4",
                                   "--seeds", seeds};
    words.insert(words.end(), more.begin(), more.end());
    return words;
  }
  static std::vector<std::string> sweep_words(const std::vector<std::string>& more) {
    std::vector<std::string> words{"sweep", "rig.yaml", "-o", "out"};
    words.insert(words.end(), more.begin(), more.end());
    return words;
  }
  Said sweep(const std::vector<std::string>& more) const { return rigor(sweep_words(more), dir.path()); }
  /// The sweep that is in the folder.
  Said go_on(const std::vector<std::string>& more) const {
    std::vector<std::string> words{"sweep", "-o", "out"};
    words.insert(words.end(), more.begin(), more.end());
    return rigor(words, dir.path());
  }
  /// The table's rows by the names of its columns, read as RFC 4180 says.
  [[nodiscard]] std::vector<std::map<std::string, std::string>> table() const {
    const std::string text = read_file(out / "table.csv");
    std::vector<std::vector<std::string>> lines(1, std::vector<std::string>(1));
    bool quoted = false;
    for (std::size_t i = 0; i < text.size(); ++i) {
      const char c = text[i];
      if (quoted && c == '"' && i + 1 < text.size() && text[i + 1] == '"') {
        lines.back().back() += text[++i];
      } else if (c == '"') {
        quoted = !quoted;
      } else if (!quoted && c == ',') {
        lines.back().emplace_back();
      } else if (!quoted && c == '\r') {
        continue;
      } else if (!quoted && c == '\n') {
        lines.emplace_back(1);
      } else {
        lines.back().back() += c;
      }
    }
    lines.pop_back();  // behind the last line's end
    std::vector<std::map<std::string, std::string>> rows;
    for (std::size_t k = 1; k < lines.size(); ++k) {
      EXPECT_EQ(lines[k].size(), lines[0].size()) << "row " << k;
      rows.emplace_back();
      for (std::size_t i = 0; i < std::min(lines[k].size(), lines[0].size()); ++i)
        rows.back()[lines[0][i]] = lines[k][i];
    }
    return rows;
  }
  TempDir dir;
  std::filesystem::path out = dir / "out";
};

}  // namespace rigor::test
