#include "bench/report/typed_command.h"

#include <fmt/format.h>
#include <sys/utsname.h>

#include <fstream>
#include <thread>

#include "bench/tune/lock_file.h"

namespace rigor {

std::string quoted_command(const std::vector<std::string>& words) {
  constexpr const char* kPlain = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_=+./:,@%";
  constexpr std::string_view kSecret = "--live-token";
  std::string out;
  bool secret = false;
  for (std::string word : words) {
    if (secret) word = "...";
    secret = word == kSecret;
    if (word.starts_with(std::string(kSecret) + "=")) word = std::string(kSecret) + "=...";
    if (!out.empty()) out += ' ';
    if (!word.empty() && word.find_first_not_of(kPlain) == std::string::npos) {
      out += word;
      continue;
    }
    out += '\'';
    for (const char c : word) out += c == '\'' ? std::string("'\\''") : std::string(1, c);
    out += '\'';
  }
  return out;
}

std::string typed_command() {
  std::ifstream in("/proc/self/cmdline", std::ios::binary);
  std::vector<std::string> words;
  for (std::string word; std::getline(in, word, '\0');) words.push_back(word);
  if (!words.empty()) words.front() = words.front().substr(words.front().rfind('/') + 1);
  return quoted_command(words);
}

std::string machine_name() {
  utsname u{};
  if (uname(&u) != 0) return cpu_name();
  return fmt::format("{}, {}, {} CPUs, {} {}", u.nodename, cpu_name(), std::thread::hardware_concurrency(),
                     u.sysname, u.release);
}

}  // namespace rigor
