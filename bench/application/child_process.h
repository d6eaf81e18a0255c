// An application's process: a program that this one starts, talks to over a Unix socket, and ends.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "bench/application/process_protocol.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"
#include "rt-core/time.h"

namespace rigor::application {

/// A program in a process group of its own (Ctrl-C is for the run, which ends it in order), and the
/// connection that it opened. It dies with the thread that started it. Setup context; one thread at a time.
class ChildProcess {
 public:
  struct Command {
    std::vector<std::string> words;   ///< program and arguments; a program without `/` is looked up in PATH
    std::filesystem::path directory;  ///< where it runs
    std::string where;                ///< for errors: place of `command` in the rig
    std::string who = "the application";  ///< for errors
    bool reads_samples = true;            ///< it gets the memory in which samples lie
  };

  /// Starts the program with RIGOR_SOCKET in its environment, and waits until it has said hello. unavailable:
  /// it cannot be run, or ended before; timeout: it did not connect within `timeout`, or `stop` said so.
  [[nodiscard]] static Result<ChildProcess> start(const Command& command, Duration timeout, StopToken stop);
  ChildProcess(ChildProcess&& o) noexcept;
  ChildProcess& operator=(ChildProcess&& o) noexcept;
  /// SIGTERM, and SIGKILL after `kEndTimeout`.
  ~ChildProcess();

  /// Text of a message, in setup: with the time that it may take.
  [[nodiscard]] Status send(MessageType type, const nlohmann::json& text);
  /// The next message, which has to be `type`, as JSON. What the process says instead, that it ended, or that
  /// its time is over, is the error.
  [[nodiscard]] Result<nlohmann::json> receive(MessageType type, Duration timeout, StopToken stop);

  /// The connection; non-blocking. -1: closed.
  [[nodiscard]] int socket() const noexcept { return socket_; }
  [[nodiscard]] pid_t pid() const noexcept { return pid_; }
  /// The descriptor by which the process reads samples: inherited by it under this number.
  [[nodiscard]] int memory_fd() const noexcept { return memory_fd_; }
  /// How it ended ("exit status 1", "signal 9, Killed"); nothing while it lives.
  [[nodiscard]] std::optional<std::string> death();
  /// Waits so long for its end by itself.
  [[nodiscard]] std::optional<std::string> wait_for_death(Duration timeout);
  /// At once.
  void kill();

 private:
  ChildProcess() = default;
  void end() noexcept;
  [[nodiscard]] Error gone(ErrorCode code, std::string message);

  pid_t pid_ = -1;
  int socket_ = -1, memory_fd_ = -1;
  std::string where_, who_;
  std::optional<std::string> death_;
};

/// Of the JSON of a message `failed`: what went wrong.
[[nodiscard]] std::string sentence_of(const nlohmann::json& failed);

}  // namespace rigor::application
