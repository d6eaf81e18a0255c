#include "cli/terminal.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <nlohmann/json.hpp>

namespace rigor {

void write_stderr(std::string_view text) noexcept {
  (void)std::fwrite(text.data(), 1, text.size(), stderr);
  (void)std::fflush(stderr);
}

void prepare_streams() {
  for (const int fd : {0, 1, 2})
    if (::fcntl(fd, F_GETFD) < 0 && errno == EBADF) (void)::open("/dev/null", O_RDONLY);
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);
}

int finish_stdout(int status) {
  errno = 0;
  if (std::fflush(stdout) == 0 && std::ferror(stdout) == 0) return status;
  say("rigor: standard output does not take what is printed{}{}\n", errno != 0 ? ": " : "",
      errno != 0 ? std::strerror(errno) : "");
  return status != 0 ? status : 1;
}

int report_error(const Error& error, bool json) {
  say("rigor: {}\n", error.text());
  if (json)
    fmt::print("{}\n", nlohmann::json{{"error", error.text()}, {"exit_status", error.exit_status()}}.dump(
                           -1, ' ', false, nlohmann::json::error_handler_t::replace));
  return error.exit_status();
}

std::string json_text(const nlohmann::json& json) {
  return json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace);
}

LiveLine::LiveLine() : terminal_(isatty(STDERR_FILENO) == 1) {}
LiveLine::~LiveLine() { done(); }

void LiveLine::show(const std::string& text) {
  if (terminal_) {
    say("\r\033[K{}", text);
    open_ = true;
  } else {
    const auto now = std::chrono::steady_clock::now();
    if (shown_ != std::chrono::steady_clock::time_point{} && now - shown_ < std::chrono::seconds(1)) return;
    shown_ = now;
    say("{}\n", text);
  }
  std::fflush(stderr);
}

void LiveLine::done() {
  if (terminal_ && open_) say("\n");
  open_ = false;
}

std::string text_of(Duration d) {
  const double ns = static_cast<double>(d.ns()), size = std::abs(ns);
  const auto three = [](double v) {
    return std::abs(v) >= 100  ? fmt::format("{:.0f}", v)
           : std::abs(v) >= 10 ? fmt::format("{:.1f}", v)
                               : fmt::format("{:.2f}", v);
  };
  if (size < 1e3) return fmt::format("{:.0f} ns", ns);
  if (size < 1e6) return three(ns * 1e-3) + " µs";
  if (size < 1e9) return three(ns * 1e-6) + " ms";
  return three(ns * 1e-9) + " s";
}

}  // namespace rigor
