#include "bench/console/terminal.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <nlohmann/json.hpp>

namespace rigor {

namespace {
std::atomic<bool> g_line_open{false};  ///< the terminal's last line is one that is rewritten
constexpr std::string_view kClear = "\r\033[K";
}  // namespace

void write_stderr(std::string_view text) noexcept {
  if (g_line_open.exchange(false)) (void)std::fwrite(kClear.data(), 1, kClear.size(), stderr);
  (void)std::fwrite(text.data(), 1, text.size(), stderr);
  (void)std::fflush(stderr);
}

void rewrite_line(std::string_view text) noexcept {
  const bool open = g_line_open.exchange(false);
  if (!open && text.empty()) return;
  std::array<char, 1024> line{};  // one call: no other thread's text comes between
  const std::size_t n = std::min(text.size(), line.size() - kClear.size());
  std::copy_n(kClear.begin(), kClear.size(), line.begin());
  std::copy_n(text.begin(), n, line.begin() + static_cast<std::ptrdiff_t>(kClear.size()));
  (void)std::fwrite(line.data(), 1, kClear.size() + n, stderr);
  (void)std::fflush(stderr);
  g_line_open = n > 0;
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
  write_stderr(fmt::format("rigor: standard output does not take what is printed{}{}\n",
                           errno != 0 ? ": " : "", errno != 0 ? std::strerror(errno) : ""));
  return status != 0 ? status : 1;
}

int report_error(const Error& error, bool json) {
  write_stderr(fmt::format("rigor: {}\n", error.text()));
  if (json)
    fmt::print("{}\n", nlohmann::json{{"error", error.text()}, {"exit_status", error.exit_status()}}.dump(
                           -1, ' ', false, nlohmann::json::error_handler_t::replace));
  return error.exit_status();
}

std::string json_text(const nlohmann::json& json) {
  return json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace);
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
