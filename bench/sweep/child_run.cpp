#include "bench/sweep/child_run.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <utility>

#include "rt-core/file_descriptor.h"

namespace rigor::sweep {
namespace {

using Clock = std::chrono::steady_clock;

Error system_error(const char* call) {
  return {ErrorCode::io, "sweep", fmt::format("{}: {}", call, std::strerror(errno))};
}

struct Pipe {
  FileDescriptor read, write;
};
Result<Pipe> make_pipe() {
  std::array<int, 2> fds{};
  if (::pipe2(fds.data(), O_CLOEXEC) != 0) return tl::unexpected<Error>(system_error("pipe"));
  Pipe pipe{FileDescriptor(fds[0]), FileDescriptor(fds[1])};
  ::fcntl(fds[0], F_SETFL, O_NONBLOCK);
  return pipe;
}

/// Takes what is there; closes the descriptor at its end.
void drain(FileDescriptor& from, std::string& to, std::size_t most, bool last) {
  std::array<char, 65536> block{};
  while (from.get() >= 0) {
    const ssize_t n = ::read(from.get(), block.data(), block.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0 && errno == EAGAIN) return;
    if (n <= 0) return from.reset();
    const auto bytes = static_cast<std::size_t>(n);
    if (last) {
      to.append(block.data(), bytes);
      if (to.size() > 2 * most) to.erase(0, to.size() - most);
    } else {
      to.append(block.data(), std::min(bytes, most - std::min(most, to.size())));
    }
  }
}

/// Between fork and exec: calls that are safe there alone.
[[noreturn]] void become(const char* program, char* const* words, const char* directory, int in, int out,
                         int err, pid_t parent) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (::getppid() != parent) ::_exit(127);
  ::setpgid(0, 0);
  // Signals that this program ignores would stay ignored.
  ::signal(SIGPIPE, SIG_DFL);
  ::signal(SIGXFSZ, SIG_DFL);
  sigset_t none;
  ::sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
  if (::chdir(directory) != 0 || ::dup2(in, 0) < 0 || ::dup2(out, 1) < 0 || ::dup2(err, 2) < 0) ::_exit(127);
  ::execv(program, words);
  ::_exit(127);
}

}  // namespace

Result<ChildEnd> run_child(const Child& child, StopToken stop) {
  auto out = make_pipe(), err = make_pipe();
  if (!out) return tl::unexpected<Error>(out.error());
  if (!err) return tl::unexpected<Error>(err.error());
  const FileDescriptor in(::open("/dev/null", O_RDONLY | O_CLOEXEC));
  std::vector<std::string> words = child.words;
  std::vector<char*> argv;
  for (std::string& w : words) argv.push_back(w.data());
  argv.push_back(nullptr);
  const std::string program = child.program.string(), directory = child.directory.string();

  const auto begin = Clock::now();
  const pid_t parent = ::getpid(), pid = ::fork();
  if (pid < 0) return tl::unexpected<Error>(system_error("fork"));
  if (pid == 0)
    become(program.c_str(), argv.data(), directory.c_str(), in.get(), out->write.get(), err->write.get(),
           parent);
  out->write.reset();
  err->write.reset();
  const FileDescriptor process(static_cast<int>(::syscall(SYS_pidfd_open, pid, 0)));

  ChildEnd end;
  const auto take = [&] {
    drain(out->read, end.out, ChildEnd::kMostOutput, false);
    drain(err->read, end.err, ChildEnd::kMostErrors, true);
  };
  bool ended = false;
  while (!ended && end.how == ChildEnd::How::exited) {
    std::array<pollfd, 3> wait{
        {{process.get(), POLLIN, 0}, {out->read.get(), POLLIN, 0}, {err->read.get(), POLLIN, 0}}};
    (void)::poll(wait.data(), wait.size(), 100);
    take();
    siginfo_t info{};
    ended = ::waitid(P_PID, static_cast<id_t>(pid), &info, WEXITED | WNOWAIT | WNOHANG) == 0 &&
            info.si_pid == pid;
    end.wall_s = std::chrono::duration<double>(Clock::now() - begin).count();
    if (!ended && stop.stop_requested()) end.how = ChildEnd::How::stopped;
    if (!ended && child.timeout_s > 0 && end.wall_s > child.timeout_s) end.how = ChildEnd::How::timed_out;
  }
  // What it started itself goes with it. Its group keeps its number until it is waited for.
  (void)::kill(-pid, SIGKILL);
  if (!ended) (void)::kill(pid, SIGKILL);
  int status = 0;
  while (::waitpid(pid, &status, 0) < 0 && errno == EINTR) {
  }
  take();
  if (end.err.size() > ChildEnd::kMostErrors) end.err.erase(0, end.err.size() - ChildEnd::kMostErrors);
  if (end.how != ChildEnd::How::exited) return end;
  end.how = WIFEXITED(status) ? ChildEnd::How::exited : ChildEnd::How::killed;
  end.status = WIFEXITED(status) ? WEXITSTATUS(status) : WTERMSIG(status);
  return end;
}

}  // namespace rigor::sweep
