// vcan interfaces of a test's own, and the tools of can-utils beside it.
#pragma once

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <iterator>
#include <string>
#include <thread>
#include <vector>

#include "drivers/can/can_interfaces.h"
#include "drivers/can/can_socket.h"
#include "tests/drivers/can/can_test_tools.h"

namespace rigor::can::test {

/// Empty, or why tests of a real bus cannot run here.
inline std::string no_vcan() {
  if (const auto missing = can_missing(); !missing.empty()) return "this kernel has no CAN (" + missing + ")";
  const auto made = create_vcan("rigorprobe");
  if (!made) return "this kernel has no vcan for us (" + made.error().text() + ")";
  (void)remove_interface("rigorprobe");
  return {};
}
inline bool in_guest() { return std::getenv("RIGOR_GUEST") != nullptr; }

/// True as soon as `condition` holds; the limit is far beyond what it takes, and only a broken program meets
/// it.
inline bool wait_for(const std::function<bool()>& condition, int limit_s = 60) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(limit_s);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return true;
}

inline std::string read_file(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return std::string(std::istreambuf_iterator<char>(in), {});
}

/// A program beside the test, its standard output in a file.
class Peer {
 public:
  Peer(const std::vector<std::string>& words, const std::string& out = "/dev/null",
       const std::string& in = "/dev/null") {
    std::vector<char*> argv;
    for (const auto& w : words) argv.push_back(const_cast<char*>(w.c_str()));
    argv.push_back(nullptr);
    pid_ = ::fork();
    if (pid_ == 0) {
      ::dup2(::open(in.c_str(), O_RDONLY), 0);
      ::dup2(::open(out.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644), 1);
      ::execvp(argv[0], argv.data());
      ::_exit(127);
    }
  }
  ~Peer() { stop(SIGKILL); }
  /// Exit status; -signal where a signal ended it.
  int wait() {
    int status = 0;
    if (pid_ <= 0 || ::waitpid(std::exchange(pid_, -1), &status, 0) < 0) return -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }
  int stop(int signal = SIGINT) {
    if (pid_ <= 0) return -1;
    ::kill(pid_, signal);
    return wait();
  }

 private:
  pid_t pid_ = -1;
};
inline int run_tool(const std::vector<std::string>& words, const std::string& out = "/dev/null",
                    const std::string& in = "/dev/null") {
  return Peer(words, out, in).wait();
}
inline bool has_tool(const std::string& name) { return run_tool({"sh", "-c", "command -v " + name}) == 0; }

inline CanFrame frame(std::uint32_t id, std::initializer_list<std::uint8_t> data, bool extended = false) {
  CanFrame f;
  f.id = id;
  f.extended = extended;
  f.length = static_cast<std::uint8_t>(data.size());
  std::copy(data.begin(), data.end(), f.data.begin());
  return f;
}

/// A vcan interface for each test.
class VcanTest : public testing::Test {
 protected:
  void SetUp() override {
    if (const auto why = no_vcan(); !why.empty()) {
      if (in_guest()) FAIL() << why;
      GTEST_SKIP() << why;
    }
    static int number = 0;
    bus = "rgr" + std::to_string(::getpid() % 10000) + "x" + std::to_string(number++ % 10);
    (void)remove_interface(bus);
    const auto made = create_vcan(bus);
    ASSERT_TRUE(made) << made.error().text();
    RawOptions all;
    all.fd = all.errors = true;
    ASSERT_TRUE(ear.open(bus, all));
  }
  void TearDown() override {
    ear.close();
    if (!bus.empty()) (void)remove_interface(bus);
  }
  RawSocket sender(bool fd = true) {
    RawOptions o;
    o.receive = false;
    o.fd = fd;
    RawSocket s;
    const auto opened = s.open(bus, o);
    EXPECT_TRUE(opened) << (opened ? "" : opened.error().text());
    return s;
  }
  std::vector<ReceivedFrame> heard() {
    std::vector<ReceivedFrame> all, part(RawSocket::kBatch);
    for (int n; (n = ear.receive(part)) > 0;) all.insert(all.end(), part.begin(), part.begin() + n);
    return all;
  }
  /// A source that runs.
  template <class S>
  void start(S& s, const ChannelConfig& c) {
    auto status = s.configure(c);
    ASSERT_TRUE(status) << status.error().text();
    status = s.arm({});
    ASSERT_TRUE(status) << status.error().text();
    ASSERT_TRUE(s.start(bench_now()));
  }
  std::string bus;
  RawSocket ear;
  Folder folder;
};

}  // namespace rigor::can::test
