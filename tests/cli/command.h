// Runs `rigor` as a user does, and other programs, and keeps what they said.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <string>
#include <vector>

namespace rigor::test {

struct Said {
  int status = -1;  ///< exit status; 128 + signal where a signal ended it
  std::string out, err;
};

/// A program that runs beside the test; killed when it goes out of scope.
class Command {
 public:
  explicit Command(std::vector<std::string> words, const std::filesystem::path& work_dir = {});
  ~Command();
  Command(const Command&) = delete;
  Command& operator=(const Command&) = delete;

  void signal(int number) const;
  /// Waits for its end; kills it after `timeout`.
  Said wait(std::chrono::seconds timeout = std::chrono::seconds(100));
  [[nodiscard]] bool running() const;
  /// What it said so far.
  [[nodiscard]] std::string out() const;
  [[nodiscard]] std::string err() const;
  [[nodiscard]] pid_t pid() const { return pid_; }

 private:
  pid_t pid_ = -1;
  std::filesystem::path out_file_, err_file_;
};

/// build/…/rigor with these words.
Said rigor(std::vector<std::string> words, const std::filesystem::path& work_dir = {});
std::vector<std::string> rigor_words(std::vector<std::string> words);

/// A folder of the test's own, removed at its end.
class TempDir {
 public:
  TempDir();
  ~TempDir();
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  [[nodiscard]] std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

void write_file(const std::filesystem::path& file, const std::string& text);
std::string read_file(const std::filesystem::path& file);
std::string config(const std::string& name);  ///< path of configs/NAME in the source tree

}  // namespace rigor::test
