// What the benches of packets over loopback share: the plainest program that reads the same packets, CPU of
// threads, and quantiles.
#pragma once

#include <netinet/in.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "rt-core/time.h"

namespace rigor::bench {

/// User and system time.
inline double cpu_s(int who) {
  rusage u{};
  getrusage(who, &u);
  return static_cast<double>(u.ru_utime.tv_sec + u.ru_stime.tv_sec) +
         static_cast<double>(u.ru_utime.tv_usec + u.ru_stime.tv_usec) * 1e-6;
}

/// recvfrom and a timestamp, no more: which packet came, and when.
class PlainReceiver {
 public:
  /// Packets of `packet_bytes` at a port of 127.0.0.1. `number_of(bytes, count)`: which one it is, as the
  /// sender counts them; `count` came before.
  template <class NumberOf>
  PlainReceiver(std::uint16_t port, std::size_t packet_bytes, int buffer_bytes, NumberOf number_of) {
    arrivals.reserve(1 << 20);
    thread_ = std::thread([this, port, packet_bytes, buffer_bytes, number_of] {
      const int fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
      if (setsockopt(fd, SOL_SOCKET, SO_RCVBUFFORCE, &buffer_bytes, sizeof buffer_bytes) != 0)
        (void)setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &buffer_bytes, sizeof buffer_bytes);
      const timeval wait{0, 100'000};
      (void)setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &wait, sizeof wait);
      sockaddr_in a{};
      a.sin_family = AF_INET;
      a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
      a.sin_port = htons(port);
      if (bind(fd, reinterpret_cast<sockaddr*>(&a), sizeof a) != 0) std::perror("bind");
      std::vector<std::uint8_t> buffer(65536);
      while (!stop_)
        if (recvfrom(fd, buffer.data(), buffer.size(), 0, nullptr, nullptr) ==
            static_cast<ssize_t>(packet_bytes)) {
          const std::int64_t now = monotonic_now().ns();
          arrivals.emplace_back(number_of(buffer, arrivals.size()), now);
        }
      thread_cpu_s_ = cpu_s(RUSAGE_THREAD);
      close(fd);
    });
  }
  ~PlainReceiver() { stop(); }
  void stop() {
    stop_ = true;
    if (thread_.joinable()) thread_.join();
  }
  /// After stop().
  [[nodiscard]] double cpu_us_per_packet() const {
    return thread_cpu_s_ * 1e6 / static_cast<double>(std::max<std::size_t>(1, arrivals.size()));
  }

  std::vector<std::pair<std::uint64_t, std::int64_t>> arrivals;  ///< number and instant, ns

 private:
  std::atomic<bool> stop_{false};
  double thread_cpu_s_ = 0;
  std::thread thread_;
};

inline double at_share(std::vector<double>& v, double share) {
  if (v.empty()) return 0;
  const auto n = static_cast<std::ptrdiff_t>(share * static_cast<double>(v.size() - 1));
  std::nth_element(v.begin(), v.begin() + n, v.end());
  return v[static_cast<std::size_t>(n)];
}

/// CPU so far of the threads of this process that are named so, in seconds.
inline double cpu_of_threads(const std::string& name) {
  double total = 0;
  const std::string command = "cat /proc/" + std::to_string(getpid()) + "/task/*/stat 2>/dev/null";
  if (FILE* in = popen(command.c_str(), "r")) {
    char line[1024];
    while (std::fgets(line, sizeof line, in)) {
      const std::string s = line;
      const auto open = s.find('('), close = s.rfind(')');
      if (open == std::string::npos || s.substr(open + 1, close - open - 1) != name) continue;
      unsigned long user = 0, system = 0;
      std::sscanf(s.c_str() + close + 2, "%*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %lu %lu", &user,
                  &system);
      total += static_cast<double>(user + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
    }
    pclose(in);
  }
  return total;
}

/// `--json FILE`, `--seconds S`.
struct PacketBenchOptions {
  std::string json;
  double seconds = 10;
  PacketBenchOptions(int argc, char** argv) {
    for (int i = 1; i + 1 < argc; i += 2) {
      if (std::string(argv[i]) == "--json") json = argv[i + 1];
      if (std::string(argv[i]) == "--seconds") seconds = std::atof(argv[i + 1]);
    }
  }
};

}  // namespace rigor::bench
