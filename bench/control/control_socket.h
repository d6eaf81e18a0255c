// How a running bench is talked to: a Unix socket, and lines of JSON over it.
//
//   → {"command": "fault", "channel": "left", "fault": {"kind": "drop", "probability": 0.2}}
//   ← {"ok": true, "result": {"index": 0}}
//   → {"command": "flt"}
//   ← {"ok": false, "error": {"code": "bad_input", "message": "command: expected one of …, got flt; did …"}}
//
// A request may have an `id`, a text of its own: one that comes again is not done again, but gets the answer
// that it got. Whoever had no answer in time can so ask once more.
//
// One answer for each line, in order. What commands there are is up to whoever fills the table; a table can
// be asked by others as well (a page in a browser).
//
// The socket is NAME.PID.sock in $XDG_RUNTIME_DIR/rigor, or in /tmp/rigor-UID where that variable is not set:
// a folder of mode 0700, a socket of mode 0600. It goes with the run.
#pragma once

#include <atomic>
#include <deque>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor {

/// Commands by name. `answer`: any thread, one at a time; not the loop's.
class ControlCommands {
 public:
  using Handler = std::function<Result<nlohmann::json>(const nlohmann::json& request)>;
  ControlCommands();
  ~ControlCommands();

  void add(const std::string& name, Handler handler);
  /// The answer to one request. Any thread, one at a time, as `answer`.
  [[nodiscard]] Result<nlohmann::json> ask(const nlohmann::json& request);
  /// One line of JSON in, one out, without its end.
  [[nodiscard]] std::string answer(std::string_view line);

 private:
  static constexpr std::size_t kAnswersKept = 64;
  [[nodiscard]] Result<nlohmann::json> result_of(const nlohmann::json& request);
  std::mutex mutex_;
  std::map<std::string, Handler> handlers_;
  std::deque<std::pair<std::string, std::string>> answered_;  // id, answer: the last ones
};

/// The socket of this process, with a thread of its own.
class ControlSocket {
 public:
  static constexpr std::size_t kMaxClients = 16, kMaxLine = 64 << 10;
  /// `commands` outlive it. unavailable, io.
  [[nodiscard]] static Result<std::unique_ptr<ControlSocket>> open(const std::string& run_name,
                                                                   ControlCommands& commands);
  ~ControlSocket();
  [[nodiscard]] const std::filesystem::path& path() const noexcept { return path_; }

 private:
  struct Client {
    int fd = -1;
    std::string pending;
  };
  ControlSocket(std::filesystem::path path, int listener, int stop, ControlCommands& commands);
  void serve();
  [[nodiscard]] bool serve_client(Client& client);

  std::filesystem::path path_;
  int listener_, stop_;
  ControlCommands& commands_;
  std::thread thread_;
};

struct RunningBench {
  std::string name;
  int pid = 0;
  std::filesystem::path socket;
};
/// Of this user, on this machine. Sockets that nobody answers on any more are removed.
[[nodiscard]] std::vector<RunningBench> running_benches();
/// How long a run is waited for. Asking again is safe: see `id` above.
struct RetryPolicy {
  Duration each = seconds(10);
  int times = 3;
};
/// `name_or_pid`: not_found where no run, or more than one, has that name. The answer's `result`, or its
/// error. timeout: nobody knows whether it was done; an earlier attempt that was in vain is told on stderr.
[[nodiscard]] Result<nlohmann::json> ask_bench(const std::string& name_or_pid, const nlohmann::json& request,
                                               RetryPolicy retry = {});

}  // namespace rigor
