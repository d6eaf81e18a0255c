#include "tests/cli/command.h"
#include "tests/paths.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <fstream>
#include <sstream>
#include <thread>

namespace rigor::test {
namespace {
std::filesystem::path fresh_name() {
  static std::atomic<int> count{0};
  return std::filesystem::temp_directory_path() /
         ("rigor-test-" + std::to_string(getpid()) + "-" + std::to_string(count++));
}
}  // namespace

Command::Command(std::vector<std::string> words, const std::filesystem::path& work_dir)
    : out_file_(fresh_name().string() + ".out"), err_file_(fresh_name().string() + ".err") {
  std::vector<char*> argv;
  for (std::string& w : words) argv.push_back(w.data());
  argv.push_back(nullptr);
  pid_ = fork();
  if (pid_ == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    // Whatever the test itself was started with.
    for (int s = 1; s < NSIG; ++s) ::signal(s, SIG_DFL);
    if (!work_dir.empty() && chdir(work_dir.c_str()) != 0) _exit(126);
    const int out = open(out_file_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    const int err = open(err_file_.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    dup2(open("/dev/null", O_RDONLY), 0);
    dup2(out, 1);
    dup2(err, 2);
    execvp(argv[0], argv.data());
    _exit(127);
  }
}

Command::~Command() {
  if (pid_ > 0) {
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
  }
  std::error_code ec;
  std::filesystem::remove(out_file_, ec);
  std::filesystem::remove(err_file_, ec);
}

void Command::signal(int number) const {
  if (pid_ > 0) kill(pid_, number);
}

bool Command::running() const {
  siginfo_t info{};
  return pid_ > 0 && waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 &&
         info.si_pid == 0;
}

std::string Command::out() const { return read_file(out_file_); }
std::string Command::err() const { return read_file(err_file_); }

Said Command::wait(std::chrono::seconds timeout) {
  const auto end = std::chrono::steady_clock::now() + timeout;
  while (running() && std::chrono::steady_clock::now() < end)
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  if (running()) {
    ADD_FAILURE() << "killed after " << timeout.count() << " s; it had said: " << err();
    kill(pid_, SIGKILL);
  }
  int status = 0;
  waitpid(pid_, &status, 0);
  pid_ = -1;
  return {WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status), out(), err()};
}

std::vector<std::string> rigor_words(std::vector<std::string> words) {
  words.insert(words.begin(), rigor::test::build_dir() + "/rigor");
  return words;
}
Said rigor(std::vector<std::string> words, const std::filesystem::path& work_dir) {
  return Command(rigor_words(std::move(words)), work_dir).wait();
}

TempDir::TempDir() : path_(fresh_name()) { std::filesystem::create_directories(path_); }
TempDir::~TempDir() {
  std::error_code ec;
  std::filesystem::remove_all(path_, ec);
}

void write_file(const std::filesystem::path& file, const std::string& text) {
  std::ofstream(file, std::ios::binary) << text;
}
std::string read_file(const std::filesystem::path& file) {
  std::ostringstream out;
  out << std::ifstream(file, std::ios::binary).rdbuf();
  return out.str();
}
std::string config(const std::string& name) { return (rigor::test::source_dir() + "/configs/") + name; }

}  // namespace rigor::test
