// A program in a process of its own: what it printed and how it ended.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/stop.h"

namespace rigor::sweep {

struct Child {
  std::filesystem::path program;
  std::vector<std::string> words;   ///< the first is the program's name
  std::filesystem::path directory;  ///< where it works
  double timeout_s = 0;             ///< it is killed after; 0: never
};

struct ChildEnd {
  enum class How : std::uint8_t {
    exited,
    killed,     ///< by a signal that somebody sent, or that a crash is
    timed_out,  ///< its time was over
    stopped     ///< `stop` said so
  };
  How how = How::exited;
  int status = 0;   ///< exit status, or the signal
  std::string out;  ///< the first kMostOutput bytes
  std::string err;  ///< the last kMostErrors bytes
  double wall_s = 0;

  static constexpr std::size_t kMostOutput = std::size_t{16} << 20, kMostErrors = std::size_t{64} << 10;
};

/// Runs it to its end, in a process group of its own (Ctrl-C is for the caller). It gets no input. It dies
/// with the thread that calls. Any thread. io: no process or pipe can be made.
[[nodiscard]] Result<ChildEnd> run_child(const Child& child, StopToken stop);

}  // namespace rigor::sweep
