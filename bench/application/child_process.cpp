#include "bench/application/child_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <nlohmann/json.hpp>
#include <thread>
#include <utility>

#include "bench/files/installed_configs.h"
#include "sensor-hal/config/json_text.h"
#include "sensor-hal/types/sample_memory.h"

namespace rigor::application {
namespace {

using nlohmann::json;

/// What a process that is asked to end may take for it.
constexpr Duration kEndTimeout = seconds(2);
constexpr int kSlice_ms = 50;  ///< how soon Ctrl-C and the end of the process are seen while one waits

std::string how_it_ended(int status) {
  if (WIFEXITED(status)) return "exit status " + std::to_string(WEXITSTATUS(status));
  return "signal " + std::to_string(WTERMSIG(status)) + ", " + strsignal(WTERMSIG(status));
}

/// A listening socket in a folder that is this user's alone; both are gone with the object.
class Listener {
 public:
  static Result<Listener> open() {
    Listener l;
    std::string folder = (std::filesystem::temp_directory_path() / "rigor-application-XXXXXX").string();
    const auto failed = [&](const char* call) {
      return fail(ErrorCode::io, folder, std::string(call) + ": " + std::strerror(errno));
    };
    if (!mkdtemp(folder.data())) return failed("mkdtemp");
    l.folder_ = folder;
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    const std::string path = l.path();
    if (path.size() >= sizeof address.sun_path) {
      errno = ENAMETOOLONG;
      return failed("socket (TMPDIR is too long for one)");
    }
    std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
    l.fd_ = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (l.fd_ < 0 || bind(l.fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
        listen(l.fd_, 1) != 0)
      return failed("socket");
    return l;
  }
  Listener(Listener&& o) noexcept : fd_(std::exchange(o.fd_, -1)), folder_(std::exchange(o.folder_, {})) {}
  Listener& operator=(Listener&&) = delete;
  ~Listener() {
    if (fd_ >= 0) close(fd_);
    if (folder_.empty()) return;
    unlink(path().c_str());
    rmdir(folder_.c_str());
  }
  [[nodiscard]] int fd() const { return fd_; }
  [[nodiscard]] std::string path() const { return folder_ + "/socket"; }

 private:
  Listener() = default;
  int fd_ = -1;
  std::string folder_;
};

/// This process's, with RIGOR_SOCKET, and with the client for Python where `import` finds it.
std::vector<std::string> environment(const std::string& socket) {
  const std::string clients = installed_clients().empty() ? "" : (installed_clients() / "python").string();
  std::vector<std::string> out;
  std::string python = clients;
  for (char** e = environ; *e; ++e) {
    const std::string_view variable = *e;
    if (variable.starts_with("RIGOR_SOCKET=")) continue;
    if (variable.starts_with("PYTHONPATH=")) {
      python = std::string(variable.substr(11)) + (clients.empty() ? "" : ":" + clients);
      continue;
    }
    out.emplace_back(variable);
  }
  out.push_back("RIGOR_SOCKET=" + socket);
  if (!python.empty()) out.push_back("PYTHONPATH=" + python);
  return out;
}

/// In the child: the program, or its error into `report`.
[[noreturn]] void become(const char* directory, char* const* argv, char* const* envp, int memory_fd,
                         int report, pid_t parent) noexcept {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(1);
  setpgid(0, 0);
  // The run's own output stays its own (`--json`), and the terminal's input, too.
  dup2(STDERR_FILENO, STDOUT_FILENO);
  if (const int null = open("/dev/null", O_RDONLY); null >= 0) dup2(null, STDIN_FILENO);
  if (memory_fd >= 0) fcntl(memory_fd, F_SETFD, 0);
  // Handlers of the parent would run in its memory: none is left when signals are let in.
  for (int s = 1; s < NSIG; ++s) {
    struct sigaction action {};
    if (sigaction(s, nullptr, &action) == 0 && action.sa_handler != SIG_IGN && action.sa_handler != SIG_DFL) {
      action.sa_handler = SIG_DFL;
      action.sa_flags = 0;
      sigaction(s, &action, nullptr);
    }
  }
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  if (chdir(directory) == 0) execvpe(argv[0], argv, envp);
  const int error = errno;
  (void)!write(report, &error, sizeof error);
  _exit(127);
}

std::vector<char*> pointers(std::vector<std::string>& words) {
  std::vector<char*> out;
  for (std::string& w : words) out.push_back(w.data());
  out.push_back(nullptr);
  return out;
}

}  // namespace

ChildProcess::ChildProcess(ChildProcess&& o) noexcept
    : pid_(std::exchange(o.pid_, -1)),
      socket_(std::exchange(o.socket_, -1)),
      memory_fd_(std::exchange(o.memory_fd_, -1)),
      where_(std::move(o.where_)),
      who_(std::move(o.who_)),
      death_(std::move(o.death_)) {}
ChildProcess& ChildProcess::operator=(ChildProcess&& o) noexcept {
  if (this == &o) return *this;
  end();
  pid_ = std::exchange(o.pid_, -1);
  socket_ = std::exchange(o.socket_, -1);
  memory_fd_ = std::exchange(o.memory_fd_, -1);
  where_ = std::move(o.where_);
  who_ = std::move(o.who_);
  death_ = std::move(o.death_);
  return *this;
}
ChildProcess::~ChildProcess() { end(); }

void ChildProcess::end() noexcept {
  if (socket_ >= 0) close(std::exchange(socket_, -1));
  if (memory_fd_ >= 0) close(std::exchange(memory_fd_, -1));
  if (pid_ <= 0 || death()) return;
  ::kill(-pid_, SIGTERM);
  if (!wait_for_death(kEndTimeout)) kill();
}

void ChildProcess::kill() {
  if (pid_ <= 0 || death()) return;
  ::kill(-pid_, SIGKILL);
  int status = 0;
  while (waitpid(pid_, &status, 0) < 0 && errno == EINTR) {
  }
  death_ = how_it_ended(status);
}

std::optional<std::string> ChildProcess::death() {
  int status = 0;
  if (!death_ && pid_ > 0 && waitpid(pid_, &status, WNOHANG) == pid_) {
    death_ = how_it_ended(status);
    ::kill(-pid_, SIGKILL);  // whom it started and left behind
  }
  return death_;
}

std::optional<std::string> ChildProcess::wait_for_death(Duration timeout) {
  const MonotonicTime until = monotonic_now() + timeout;
  while (!death() && monotonic_now() < until) std::this_thread::sleep_for(std::chrono::milliseconds(2));
  return death_;
}

std::string sentence_of(const json& failed) {
  const auto it = failed.is_object() ? failed.find("error") : failed.end();
  return it != failed.end() && it->is_string() ? it->get<std::string>() : "nothing of what went wrong";
}

Result<ChildProcess> ChildProcess::start(const Command& command, Duration timeout, StopToken stop) {
  auto listener = Listener::open();
  if (!listener) return tl::unexpected<Error>(listener.error());
  ChildProcess child;
  child.where_ = command.where;
  child.who_ = command.who;
  if (command.reads_samples) child.memory_fd_ = sample_memory::open_for_reader();
  std::vector<std::string> words = command.words, variables = environment(listener->path());
  const std::vector<char*> argv = pointers(words), envp = pointers(variables);
  const std::string directory = command.directory.empty() ? "." : command.directory.string();
  int report[2];  // closed by exec; otherwise tells why there was none
  if (pipe2(report, O_CLOEXEC) != 0)
    return fail(ErrorCode::io, command.where, std::string("pipe: ") + std::strerror(errno));
  const pid_t parent = getpid();
  // fork would copy the tables of all pages, and the loop would stumble over each page that it writes to
  // next.
  sigset_t all, before;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  child.pid_ = vfork();
  if (child.pid_ == 0) {
    // Until exec this is the parent's memory: system calls only, and nothing is changed.
    become(directory.c_str(), argv.data(), envp.data(), child.memory_fd_, report[1], parent);
  }
  const int fork_error = errno;
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  close(report[1]);
  if (child.pid_ < 0) {
    close(report[0]);
    return fail(ErrorCode::io, command.where, std::string("vfork: ") + std::strerror(fork_error));
  }
  setpgid(child.pid_, child.pid_);  // both sides do it, so that it is done for either
  int exec_error = 0;
  ssize_t got;
  while ((got = read(report[0], &exec_error, sizeof exec_error)) < 0 && errno == EINTR) {
  }
  close(report[0]);
  if (got == sizeof exec_error)
    return fail(ErrorCode::bad_input, command.where,
                "expected a program that can be run in " + directory + ", got \"" + words[0] +
                    "\": " + std::strerror(exec_error));

  const MonotonicTime until = monotonic_now() + timeout;
  pollfd wait{listener->fd(), POLLIN, 0};
  while (poll(&wait, 1, kSlice_ms) <= 0) {
    if (stop.stop_requested())
      return fail(ErrorCode::unavailable, command.where,
                  "interrupted while " + command.who + " was starting");
    if (const auto how = child.death())
      return fail(
          ErrorCode::unavailable, command.where,
          words[0] + " ended before it connected to RIGOR_SOCKET: " + *how + "; what it said stands above");
    if (monotonic_now() > until)
      return fail(ErrorCode::timeout, command.where,
                  words[0] + " did not connect to RIGOR_SOCKET within " +
                      std::to_string(timeout.ns() / 1'000'000'000) + " s; see `start_timeout_s`");
  }
  child.socket_ = accept4(listener->fd(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK);
  if (child.socket_ < 0)
    return fail(ErrorCode::io, command.where, std::string("accept: ") + std::strerror(errno));
  const int room = 1 << 20;
  setsockopt(child.socket_, SOL_SOCKET, SO_SNDBUF, &room, sizeof room);

  const auto hello = child.receive(MessageType::hello, timeout, stop);
  if (!hello) return tl::unexpected<Error>(hello.error());
  const json version = hello->is_object() ? hello->value("protocol", json()) : json();
  if (version != kProtocolVersion)
    return fail(ErrorCode::protocol, command.where,
                "expected protocol " + std::to_string(kProtocolVersion) + " from " + words[0] + ", got " +
                    version.dump() + "; use the client that comes with this version of Rigor");
  return child;
}

Error ChildProcess::gone(ErrorCode code, std::string message) {
  // A connection that is closed is mostly the first sign of a process that ends.
  if (const auto how = wait_for_death(milliseconds(500))) message += ": " + *how;
  return {code, where_, std::move(message)};
}

Status ChildProcess::send(MessageType type, const json& text) {
  const std::string body = text.dump(-1, ' ', false, json::error_handler_t::replace);
  const MessageHeader header{static_cast<std::uint32_t>(body.size()), type};
  std::string bytes(sizeof header, '\0');
  std::memcpy(bytes.data(), &header, sizeof header);
  bytes += body;
  const MonotonicTime until = monotonic_now() + seconds(10);
  for (std::size_t sent = 0; sent < bytes.size();) {
    const ssize_t n = ::send(socket_, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
    if (n > 0) {
      sent += static_cast<std::size_t>(n);
      continue;
    }
    if (n < 0 && errno != EAGAIN && errno != EINTR)
      return tl::unexpected<Error>(gone(ErrorCode::unavailable, who_ + " has closed its connection"));
    if (monotonic_now() > until) return fail(ErrorCode::timeout, where_, who_ + " reads nothing");
    pollfd wait{socket_, POLLOUT, 0};
    (void)poll(&wait, 1, kSlice_ms);
  }
  return {};
}

Result<json> ChildProcess::receive(MessageType type, Duration timeout, StopToken stop) {
  const MonotonicTime until = monotonic_now() + timeout;
  std::string bytes(sizeof(MessageHeader), '\0');
  MessageHeader header;
  for (std::size_t got = 0;;) {
    const ssize_t n = recv(socket_, bytes.data() + got, bytes.size() - got, 0);
    if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR))
      return tl::unexpected<Error>(gone(ErrorCode::unavailable, who_ + " has closed its connection"));
    if (n > 0) got += static_cast<std::size_t>(n);
    if (got == sizeof header && bytes.size() == sizeof header) {
      std::memcpy(&header, bytes.data(), sizeof header);
      if (header.size_bytes > kMaxTextBytes)
        return fail(ErrorCode::protocol, where_,
                    "expected a message of at most " + std::to_string(kMaxTextBytes) + " bytes, got one of " +
                        std::to_string(header.size_bytes));
      bytes.resize(sizeof header + header.size_bytes);
    }
    if (got >= sizeof header && got == bytes.size()) break;
    if (n > 0) continue;
    if (stop.stop_requested()) return fail(ErrorCode::unavailable, where_, "interrupted");
    if (monotonic_now() > until) return fail(ErrorCode::timeout, where_, who_ + " does not answer");
    pollfd wait{socket_, POLLIN, 0};
    (void)poll(&wait, 1, kSlice_ms);
  }
  auto text = parse_json(std::string_view(bytes).substr(sizeof header), where_);
  if (header.type == MessageType::failed)
    return fail(ErrorCode::unavailable, where_, who_ + " says: " + sentence_of(text.value_or(json())));
  if (header.type != type)
    return fail(ErrorCode::protocol, where_,
                fmt::format("expected message {} with JSON from {}, got message {}",
                            static_cast<std::uint32_t>(type), who_, static_cast<std::uint32_t>(header.type)));
  if (!text) return fail(ErrorCode::protocol, where_, "the message of " + who_ + ": " + text.error().message);
  return text;
}

}  // namespace rigor::application
