// stamped_camera as a child process that a test can kill.
#pragma once

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <stdexcept>
#include <string>

namespace rigor::testing {

class CameraProcess {
 public:
  CameraProcess(const std::string& program, const std::string& address, const std::string& serial,
                const std::string& width, const std::string& height) {
    int out[2];
    if (pipe2(out, O_CLOEXEC) != 0) throw std::runtime_error("pipe");
    pid_ = fork();
    if (pid_ == 0) {
      prctl(PR_SET_PDEATHSIG, SIGKILL);
      dup2(out[1], 1);
      execl(program.c_str(), program.c_str(), address.c_str(), serial.c_str(), width.c_str(), height.c_str(),
            static_cast<char*>(nullptr));
      _exit(127);
    }
    close(out[1]);
    out_ = out[0];
    if (read_line() != "ready\n")
      throw std::runtime_error("the camera process " + program + " did not come up");
  }
  CameraProcess(const CameraProcess&) = delete;
  CameraProcess& operator=(const CameraProcess&) = delete;
  ~CameraProcess() {
    kill_now();
    close(out_);
  }
  void kill_now() { end(SIGKILL); }
  /// Asks it to end; what it says of its work.
  std::string finish() {
    if (pid_ <= 0) return {};
    ::kill(pid_, SIGTERM);
    const std::string text = read_line();
    end(0);
    return text;
  }

 private:
  void end(int signal) {
    if (pid_ <= 0) return;
    if (signal != 0) ::kill(pid_, signal);
    waitpid(pid_, nullptr, 0);
    pid_ = -1;
  }
  std::string read_line() const {
    std::string line;
    char c = 0;
    pollfd p{out_, POLLIN, 0};
    while (poll(&p, 1, 5000) > 0 && read(out_, &c, 1) == 1) {
      line += c;
      if (c == '\n') break;
    }
    return line;
  }
  pid_t pid_ = -1;
  int out_ = -1;
};

}  // namespace rigor::testing
