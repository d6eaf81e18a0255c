// A DBC file, a model with its signals, and configurations of channels around them.
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <mutex>
#include <string>
#include <vector>

#include "drivers/can/can_virtual.h"
#include "drivers/can/candump_log.h"
#include "sensor-hal/channel/providers.h"

namespace rigor::can::test {

/// All frames of a log; a line that is none fails the test.
inline std::vector<LogEntry> entries_of(const std::filesystem::path& file) {
  std::vector<LogEntry> all;
  auto log = LogReader::open(file);
  EXPECT_TRUE(log) << log.error().text();
  while (log) {
    const auto entry = log->next();
    EXPECT_TRUE(entry) << entry.error().text();
    if (!entry || !*entry) break;
    all.push_back(**entry);
  }
  return all;
}

/// Signals of a node whose counter tells how often it was read; remembers what it was told.
class CountingModel final : public SignalModel {
 public:
  struct Write {
    std::string name;
    double value;
    BenchTime t;
  };
  const std::vector<Signal>& signals() const override { return signals_; }
  double read(std::size_t i, BenchTime t) override {
    const std::lock_guard lock(mutex_);
    if (i == 0) return static_cast<double>(t.ns() / 1'000'000 % 100'000);
    if (i == 1) return state_;
    return i == 2 ? enable_ : target_;
  }
  bool write(std::size_t i, double value, BenchTime t) override {
    const std::lock_guard lock(mutex_);
    if (i < 2 || value > 1000) return false;
    (i == 2 ? enable_ : target_) = value;
    writes_.push_back({signals_[i].name, value, t});
    return true;
  }
  void set_state(double x) {
    const std::lock_guard lock(mutex_);
    state_ = x;
  }
  std::vector<Write> writes() const {
    const std::lock_guard lock(mutex_);
    return writes_;
  }

 private:
  std::vector<Signal> signals_{
      {"clock_ms", "ms", false}, {"state", "", false}, {"enable", "", true}, {"target", "deg/s", true}};
  double state_ = 3, enable_ = 0, target_ = 0;
  std::vector<Write> writes_;
  mutable std::mutex mutex_;
};

inline constexpr const char* kDbc = R"(VERSION ""
BU_: Device Bench
BO_ 256 Clock: 8 Device
 SG_ clock_ms : 0|32@1+ (1,0) [0|0] "ms" Bench
 SG_ spare : 32|8@1+ (1,0) [0|0] "" Bench
BO_ 257 State: 1 Device
 SG_ state : 0|8@1+ (1,0) [0|0] "" Bench
BO_ 512 Command: 8 Bench
 SG_ enable : 0|8@1+ (1,0) [0|1] "" Device
 SG_ target : 15|16@0- (0.1,0) [-500|500] "deg/s" Device
 SG_ fixed : 24|8@1+ (1,0) [0|0] "" Device
BO_ 513 Cyclic: 8 Bench
 SG_ level : 0|16@1+ (1,0) [0|0] "" Device
BO_ 258 Turns: 8 Device
 SG_ which M : 0|8@1+ (1,0) [0|0] "" Bench
 SG_ one m1 : 8|8@1+ (1,0) [0|0] "" Bench
 SG_ two m2 : 8|8@1+ (1,0) [0|0] "" Bench
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 256 10;
BA_ "GenMsgCycleTime" BO_ 513 20;
)";

/// A folder of its own, with the DBC file in it, that goes with the object.
class Folder {
 public:
  Folder() {
    std::string name = (std::filesystem::temp_directory_path() / "rigor_can_XXXXXX").string();
    path_ = ::mkdtemp(name.data());
    std::ofstream(path_ / "bus.dbc") << kDbc;
  }
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  [[nodiscard]] std::string file(const std::string& name) const { return (path_ / name).string(); }
  [[nodiscard]] std::string dbc() const { return file("bus.dbc"); }

 private:
  std::filesystem::path path_;
};

inline ConfigNode node_of(const std::string& text) {
  auto n = ConfigDocument::parse(text, "test.yaml");
  EXPECT_TRUE(n) << (n ? "" : n.error().text());
  return n ? *n : ConfigNode{};
}
inline ChannelConfig config_of(SampleKind kind, const std::string& params, Duration period = {},
                               Duration latency = {}) {
  ChannelConfig c;
  c.name = "channel";
  c.kind = kind;
  c.period = period;
  c.latency = latency;
  c.params = node_of(params);
  return c;
}

}  // namespace rigor::can::test
