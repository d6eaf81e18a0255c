#include "bench/devices/emulator_process.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <mutex>
#include <thread>
#include <utility>

#include "bench/console/terminal.h"
#include "bench/files/installed_configs.h"
#include "bench/world/world_plugins.h"

namespace rigor {
namespace {

void end_child(pid_t pid) {
  kill(pid, SIGTERM);
  for (int i = 0; i < 300; ++i) {
    if (waitpid(pid, nullptr, WNOHANG) != 0) return;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  kill(pid, SIGKILL);
  waitpid(pid, nullptr, 0);
}

}  // namespace

Result<EmulatorProcess> EmulatorProcess::start(const std::filesystem::path& rig,
                                               const std::vector<std::string>& overrides, Duration timeout,
                                               StopToken stop) {
  const std::string program = installed_program().string();
  if (program.empty())
    return fail(
        ErrorCode::not_found, "emulators",
        "expected the program `rigor`, which runs the rig's emulators, in the prefix of this library, found "
        "none; install it, or run with the devices there already");
  int fds[2];
  if (pipe2(fds, O_CLOEXEC) != 0)
    return fail(ErrorCode::io, "emulators", std::string("pipe: ") + std::strerror(errno));
  const std::string ready_fd = std::to_string(fds[1]);
  std::vector<std::string> words{"rigor",  "emulate",    rig.string(), "--ready-fd",
                                 ready_fd, "--progress", "none"};
  for (const std::string& o : overrides) {
    words.emplace_back("--set");
    words.push_back(o);
  }
  for (const NamedFile& plugin : command_plugins()) {
    words.emplace_back("--plugin");
    words.push_back(plugin.file.string());
  }
  std::vector<char*> argv;
  for (std::string& w : words) argv.push_back(w.data());
  argv.push_back(nullptr);

  const pid_t parent = getpid();
  const pid_t pid = fork();
  if (pid < 0) return fail(ErrorCode::io, "emulators", std::string("fork: ") + std::strerror(errno));
  if (pid == 0) {
    // Between fork and exec: async-signal-safe calls only.
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) _exit(1);
    setpgid(0, 0);  // Ctrl-C is for the run; it must be able to make the devices safe before they go
    fcntl(fds[1], F_SETFD, 0);
    execv(program.c_str(), argv.data());
    _exit(127);
  }
  close(fds[1]);
  pollfd wait{fds[0], POLLIN, 0};
  char byte = 0;
  int ready = 0;
  // A world that is large, or a machine that is slow, may take minutes; Ctrl-C ends it.
  const auto began = std::chrono::steady_clock::now();
  while (ready == 0 && !stop.stop_requested()) {
    ready = poll(&wait, 1, 200);
    if (ready < 0 && errno == EINTR) ready = 0;
    const auto waited = std::chrono::steady_clock::now() - began;
    if (waited > std::chrono::nanoseconds(timeout.ns())) break;
  }
  const ssize_t got = ready > 0 ? read(fds[0], &byte, 1) : -1;
  close(fds[0]);
  if (got == 1) return EmulatorProcess(pid);
  int status = 0;
  if (ready == 0) {
    end_child(pid);
    if (stop.stop_requested())
      return fail(ErrorCode::unavailable, "emulators", "interrupted while they were coming up");
    return fail(ErrorCode::timeout, "emulators",
                "the rig's emulators did not come up in " + std::to_string(timeout.ns() / 1'000'000'000) +
                    " s; `rigor emulate` alone shows what they wait for");
  }
  waitpid(pid, &status, 0);
  const bool bad_input = WIFEXITED(status) && WEXITSTATUS(status) == 2;
  return fail(bad_input ? ErrorCode::bad_input : ErrorCode::unavailable, "emulators",
              "the rig's emulators did not start, their message stands above; with devices that are there "
              "already, use --no-emulators");
}

/// Waits for the end of the process, without taking its status from who ends it.
struct EmulatorProcess::Watch {
  explicit Watch(pid_t process) : pid(process), thread([this] { wait(); }) {}

  void wait() {
    siginfo_t info{};
    while (waitid(P_PID, static_cast<id_t>(pid), &info, WEXITED | WNOWAIT) != 0)
      if (errno != EINTR) return;  // it was reaped: the run has ended it
    const BenchTime t = bench_now();
    if (ending.load()) return;
    const std::string how = info.si_code == CLD_EXITED ? "exit status " + std::to_string(info.si_status)
                                                       : "signal " + std::to_string(info.si_status) + ", " +
                                                             strsignal(info.si_status);
    // On a terminal a line that is rewritten in place may stand there.
    std::fprintf(stderr, "%srigor: the rig's emulators (process %d) died: %s; the run goes on without them\n",
                 isatty(STDERR_FILENO) == 1 ? "\n" : "", static_cast<int>(pid), how.c_str());
    const std::lock_guard lock(mutex);
    death = Death{t, how};
  }

  pid_t pid;
  std::atomic<bool> ending{false};  ///< the run ends it
  mutable std::mutex mutex;
  std::optional<Death> death;
  std::thread thread;
};

EmulatorProcess::EmulatorProcess(pid_t pid) : pid_(pid), watch_(std::make_unique<Watch>(pid)) {}
EmulatorProcess::EmulatorProcess(EmulatorProcess&& o) noexcept
    : pid_(std::exchange(o.pid_, -1)), watch_(std::move(o.watch_)) {}
EmulatorProcess& EmulatorProcess::operator=(EmulatorProcess&& o) noexcept {
  std::swap(pid_, o.pid_);
  std::swap(watch_, o.watch_);
  return *this;
}
EmulatorProcess::~EmulatorProcess() {
  if (pid_ <= 0) return;
  watch_->ending = true;
  end_child(pid_);
  watch_->thread.join();
}

std::optional<EmulatorProcess::Death> EmulatorProcess::death() const {
  const std::lock_guard lock(watch_->mutex);
  return watch_->death;
}

}  // namespace rigor
