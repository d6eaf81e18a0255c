#include "bench/control/control_socket.h"

#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstdlib>
#include <cstring>
#include <nlohmann/json.hpp>
#include <thread>

#include "bench/console/terminal.h"
#include "sensor-hal/config/json_text.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {
namespace {

using nlohmann::json;

const char* code_name(ErrorCode code) {
  switch (code) {
    case ErrorCode::bad_input:
      return "bad_input";
    case ErrorCode::not_found:
      return "not_found";
    case ErrorCode::unavailable:
      return "unavailable";
    case ErrorCode::wrong_state:
      return "wrong_state";
    default:
      return "failed";
  }
}
ErrorCode code_of(const std::string& name) {
  for (const ErrorCode c :
       {ErrorCode::bad_input, ErrorCode::not_found, ErrorCode::unavailable, ErrorCode::wrong_state})
    if (name == code_name(c)) return c;
  return ErrorCode::io;
}

std::filesystem::path control_folder() {
  if (const char* runtime = std::getenv("XDG_RUNTIME_DIR"); runtime && *runtime)
    return std::filesystem::path(runtime) / "rigor";
  return std::filesystem::path(fmt::format("/tmp/rigor-{}", getuid()));
}

/// In /tmp another user could have been there first: only a folder of ours, closed to others, is used.
Status check_folder(const std::filesystem::path& folder) {
  const auto refuse = [&](const std::string& why) {
    return fail(ErrorCode::unavailable, folder.string(),
                "expected a folder for control sockets that belongs to this user alone: " + why +
                    "; remove it, or set XDG_RUNTIME_DIR to a folder of your own");
  };
  struct stat s {};
  if (lstat(folder.c_str(), &s) != 0) return refuse(std::strerror(errno));
  if (!S_ISDIR(s.st_mode)) return refuse("it is no folder");
  if (s.st_uid != getuid()) return refuse("it is another user's");
  if ((s.st_mode & 0077) != 0 && chmod(folder.c_str(), 0700) != 0) return refuse(std::strerror(errno));
  return {};
}

Status make_folder(const std::filesystem::path& folder) {
  if (mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST)
    return fail(ErrorCode::unavailable, folder.string(),
                std::string("expected a folder for control sockets that can be made: ") +
                    std::strerror(errno) + "; set XDG_RUNTIME_DIR to a folder of your own");
  return check_folder(folder);
}

std::string plain(const std::string& name) {
  std::string out;
  for (const char c : name.substr(0, 40))
    out += std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_' || c == '-' ? c : '_';
  return out.empty() ? "run" : out;
}

bool address_of(const std::filesystem::path& path, sockaddr_un& address) {
  address = {};
  address.sun_family = AF_UNIX;
  if (path.native().size() >= sizeof address.sun_path) return false;
  std::memcpy(address.sun_path, path.c_str(), path.native().size() + 1);
  return true;
}

void set_timeout(int fd, Duration d) {
  const timeval timeout{static_cast<time_t>(d.ns() / 1'000'000'000),
                        static_cast<suseconds_t>(d.ns() % 1'000'000'000 / 1000)};
  (void)setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &timeout, sizeof timeout);
  (void)setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof timeout);
}

int connect_to(const std::filesystem::path& path, Duration timeout) {
  sockaddr_un address{};
  if (!address_of(path, address)) return -1;
  const int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (fd < 0) return -1;
  set_timeout(fd, timeout);  // of connecting, too: the run may have many who wait
  if (connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) return fd;
  const int error = errno;
  close(fd);
  errno = error;
  return -1;
}

bool send_all(int fd, std::string_view text) {
  while (!text.empty()) {
    const ssize_t n = send(fd, text.data(), text.size(), MSG_NOSIGNAL);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    text.remove_prefix(static_cast<std::size_t>(n));
  }
  return true;
}

}  // namespace

// ------------------------------------------------------------------ commands

ControlCommands::ControlCommands() = default;
ControlCommands::~ControlCommands() = default;

void ControlCommands::add(const std::string& name, Handler handler) { handlers_[name] = std::move(handler); }

Result<json> ControlCommands::result_of(const json& request) {
  if (!request.is_object() || !request.contains("command") || !request["command"].is_string())
    return fail(ErrorCode::bad_input, "", "expected a line with an object of JSON that has a `command`");
  const std::string name = request["command"];
  const auto it = handlers_.find(name);
  if (it == handlers_.end()) {
    std::string all;
    std::vector<std::string> names;
    for (const auto& [n, h] : handlers_) names.push_back(n), all += (all.empty() ? "" : ", ") + n;
    const std::string near = nearest(name, names);
    return fail(
        ErrorCode::bad_input, "command",
        "expected one of " + all + ", got " + name + (near.empty() ? "" : "; did you mean '" + near + "'?"));
  }
  try {
    return it->second(request);
  } catch (const json::exception& e) {  // a key of another type than the command expects
    return fail(ErrorCode::bad_input, name, std::string("the request is not as expected: ") + e.what());
  }
}

Result<json> ControlCommands::ask(const json& request) {
  const std::lock_guard lock(mutex_);
  return result_of(request);
}

std::string ControlCommands::answer(std::string_view line) {
  const auto parsed = parse_json(line);
  const json request = parsed ? *parsed : json();
  const std::lock_guard lock(mutex_);
  std::string id;
  if (request.is_object() && request.contains("id") && request["id"].is_string()) id = request["id"];
  if (!id.empty())
    for (const auto& [known, said] : answered_)
      if (known == id) return said;
  const auto result = parsed ? result_of(request) : parsed;
  const json reply =
      result
          ? json{{"ok", true}, {"result", *result}}
          : json{{"ok", false},
                 {"error", {{"code", code_name(result.error().code)}, {"message", result.error().text()}}}};
  std::string said = reply.dump(-1, ' ', false, json::error_handler_t::replace);
  if (!id.empty()) {
    answered_.emplace_back(std::move(id), said);
    if (answered_.size() > kAnswersKept) answered_.pop_front();
  }
  return said;
}

// ------------------------------------------------------------------ server

Result<std::unique_ptr<ControlSocket>> ControlSocket::open(const std::string& run_name,
                                                           ControlCommands& commands) {
  const auto folder = control_folder();
  if (auto s = make_folder(folder); !s) return tl::unexpected<Error>(s.error());
  const auto path = folder / fmt::format("{}.{}.sock", plain(run_name), getpid());
  sockaddr_un address{};
  if (!address_of(path, address))
    return fail(ErrorCode::unavailable, path.string(),
                "expected a path of less than 108 characters for a control socket; set XDG_RUNTIME_DIR to a "
                "shorter one");
  (void)running_benches();  // removes what dead runs left
  std::error_code ignored;
  std::filesystem::remove(path, ignored);  // of a dead process that had our number
  const int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  const int stop = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  if (fd < 0 || stop < 0 || bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
      chmod(path.c_str(), 0600) != 0 || listen(fd, 8) != 0) {
    const std::string why = std::strerror(errno);
    if (fd >= 0) close(fd);
    if (stop >= 0) close(stop);
    return fail(ErrorCode::unavailable, path.string(), "the control socket cannot be made: " + why);
  }
  return std::unique_ptr<ControlSocket>(new ControlSocket(path, fd, stop, commands));
}

ControlSocket::ControlSocket(std::filesystem::path path, int listener, int stop, ControlCommands& commands)
    : path_(std::move(path)), listener_(listener), stop_(stop), commands_(commands), thread_([this] {
        serve();
      }) {}

ControlSocket::~ControlSocket() {
  const std::uint64_t one = 1;
  (void)!write(stop_, &one, sizeof one);
  thread_.join();
  close(listener_);
  close(stop_);
  std::error_code ignored;
  std::filesystem::remove(path_, ignored);
}

void ControlSocket::serve() {
  std::vector<Client> clients;
  std::vector<pollfd> wait;
  while (true) {
    wait.assign({{stop_, POLLIN, 0}, {listener_, POLLIN, 0}});
    for (const Client& c : clients) wait.push_back({c.fd, POLLIN, 0});
    if (poll(wait.data(), wait.size(), -1) < 0 && errno != EINTR) break;
    if (wait[0].revents != 0) break;
    std::vector<Client> left;
    for (std::size_t i = 0; i < clients.size(); ++i) {
      if (wait[i + 2].revents == 0 || serve_client(clients[i]))
        left.push_back(std::move(clients[i]));
      else
        close(clients[i].fd);
    }
    clients = std::move(left);
    if ((wait[1].revents & POLLIN) == 0) continue;
    const int fd = accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
    if (fd < 0) continue;
    set_timeout(fd, seconds(2));  // whoever does not read his answers is let go
    if (clients.size() < kMaxClients)
      clients.push_back({fd, {}});
    else
      close(fd);
  }
  for (const Client& c : clients) close(c.fd);
}

bool ControlSocket::serve_client(Client& client) {
  char buffer[4096];
  const ssize_t n = recv(client.fd, buffer, sizeof buffer, MSG_DONTWAIT);
  if (n < 0) return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR;
  if (n == 0) return false;
  client.pending.append(buffer, static_cast<std::size_t>(n));
  for (std::size_t end = client.pending.find('\n'); end != std::string::npos;
       end = client.pending.find('\n')) {
    const std::string reply = commands_.answer(std::string_view(client.pending).substr(0, end)) + "\n";
    client.pending.erase(0, end + 1);
    if (!send_all(client.fd, reply)) return false;
  }
  return client.pending.size() <= kMaxLine;
}

// ------------------------------------------------------------------ client

namespace {

/// The process is gone, or another has its number by now: nobody listens at a socket that is no longer new.
bool left_behind(const RunningBench& bench) {
  if (kill(bench.pid, 0) != 0 && errno == ESRCH) return true;
  struct stat s {};
  constexpr time_t kNew_s = 10;  // one that is being made is bound before it listens
  if (lstat(bench.socket.c_str(), &s) != 0 || time(nullptr) - s.st_mtime < kNew_s) return false;
  const int fd = connect_to(bench.socket, seconds(1));
  if (fd < 0) return errno == ECONNREFUSED;
  close(fd);
  return false;
}

}  // namespace

std::vector<RunningBench> running_benches() {
  std::vector<RunningBench> all;
  std::error_code none;
  if (!check_folder(control_folder())) return all;  // nobody else's sockets are talked to
  for (const auto& entry : std::filesystem::directory_iterator(control_folder(), none)) {
    const std::string file = entry.path().filename();
    const std::size_t end = file.rfind(".sock"),
                      dot = end == std::string::npos ? end : file.rfind('.', end - 1);
    if (dot == std::string::npos || end + 5 != file.size()) continue;
    RunningBench b;
    b.name = file.substr(0, dot);
    b.socket = entry.path();
    const char *first = file.data() + dot + 1, *last = file.data() + end;
    if (const auto [at, ec] = std::from_chars(first, last, b.pid); ec != std::errc{} || at != last) continue;
    if (left_behind(b)) {
      std::filesystem::remove(b.socket, none);
      continue;
    }
    all.push_back(std::move(b));
  }
  std::sort(all.begin(), all.end(), [](const auto& a, const auto& b) { return a.pid < b.pid; });
  return all;
}

namespace {

/// What came back for one line; empty, and why, where nothing did.
struct Asked {
  std::string reply, why;
  bool gone = false;  ///< there is nobody to ask again
};

Asked ask_once(const std::filesystem::path& path, const std::string& line, Duration timeout) {
  const auto too_late = [&] { return fmt::format("no answer within {:g} s", timeout.seconds()); };
  const int fd = connect_to(path, timeout);
  if (fd < 0) {
    const bool busy = errno == EAGAIN || errno == EINTR;
    return {"", busy ? too_late() : std::strerror(errno), !busy};
  }
  Asked asked;
  bool good = send_all(fd, line);
  if (!good) asked.why = too_late();
  while (good && asked.reply.find('\n') == std::string::npos) {
    char buffer[4096];
    const ssize_t n = recv(fd, buffer, sizeof buffer, 0);
    if (n < 0 && errno == EINTR) continue;
    good = n > 0 && asked.reply.size() < kMaxJsonBytes;
    if (good) asked.reply.append(buffer, static_cast<std::size_t>(n));
    if (!good && n > 0) asked.why = "its answer does not end";
    if (n == 0) asked.why = "it closed the connection";
    if (n < 0) asked.why = errno == EAGAIN ? too_late() : std::strerror(errno);
  }
  close(fd);
  if (!good) asked.reply.clear();
  return asked;
}

}  // namespace

Result<json> ask_bench(const std::string& name_or_pid, const json& request, RetryPolicy retry) {
  const auto folder = control_folder();
  std::error_code none;
  if (std::filesystem::exists(folder, none))
    if (auto s = check_folder(folder); !s) return tl::unexpected<Error>(s.error());
  const auto all = running_benches();
  std::vector<const RunningBench*> fits;
  std::string list;
  for (const RunningBench& b : all) {
    if (b.name == plain(name_or_pid) || std::to_string(b.pid) == name_or_pid) fits.push_back(&b);
    list += (list.empty() ? "" : ", ") + fmt::format("{} ({})", b.name, b.pid);
  }
  if (fits.size() != 1)
    return fail(
        ErrorCode::not_found, name_or_pid,
        fmt::format("expected the name or the process id of one run of this user; {}; running now: {}",
                    fits.empty() ? "none has it" : "several have it, give the process id",
                    list.empty() ? "none" : list));
  json with_id = request;
  with_id["id"] = fmt::format("{}-{}", getpid(), monotonic_now().ns());
  const std::string line = with_id.dump() + "\n";
  const std::string where = fits.front()->socket.string();
  Asked asked;
  for (int i = 1; i <= retry.times; ++i) {
    asked = ask_once(fits.front()->socket, line, retry.each);
    if (!asked.reply.empty() || asked.gone) break;
    if (i < retry.times) {
      write_stderr(fmt::format("rigor: {}: {}; asking again\n", where, asked.why));
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
  }
  if (asked.gone) return fail(ErrorCode::io, where, "the run does not answer: " + asked.why);
  if (asked.reply.empty())
    return fail(
        ErrorCode::timeout, where,
        fmt::format("the run does not answer, asked {} times: {}; whether it did what it was asked is "
                    "not known (`rigor fault RUN --list` tells of faults)",
                    retry.times, asked.why));
  const auto parsed = parse_json(asked.reply, where);
  if (!parsed) return tl::unexpected<Error>(parsed.error());
  const json& answer = *parsed;
  if (!answer.is_object())
    return fail(ErrorCode::io, where, "the run does not answer: its answer is no object of JSON");
  if (answer.value("ok", false)) return answer.value("result", json::object());
  const json error = answer.value("error", json::object());
  return fail(code_of(error.value("code", "")), "", error.value("message", "it refused"));
}

}  // namespace rigor
