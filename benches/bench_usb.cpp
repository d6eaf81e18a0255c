// A Hokuyo scanner on a pseudo-terminal, from an emulated UTM-30LX in a process of its own to the channel's
// ring, beside the plainest C reader of the same device: time from a scan's departure to its arrival, CPU of
// the reading side for each scan, scans lost, and the time to be back after the scanner was killed.
//
//   bench_usb [--seconds 30] [--json FILE]
//
// The plain reader is a thread with poll and read that stamps each empty line; the time that scans need to
// leave is the emulator's own note of when it wrote their last byte, by the scanner's clock at step 0 and the
// rotation.
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <string>

#include "drivers/usb/scip_emulator.h"
#include "drivers/usb/scip_source.h"
#include "rt-core/histogram.h"

namespace {

using namespace rigor;
using namespace rigor::usb;

const std::string kLink = "/tmp/rigor-bench-usb-" + std::to_string(getpid());

struct Figures {
  std::uint64_t scans = 0, lost = 0;
  Histogram latency;
  double cpu_us_per_scan = 0, recover_ms = 0;
};

double cpu_s(int who) {
  rusage u{};
  getrusage(who, &u);
  const auto s = [](timeval t) {
    return static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_usec) * 1e-6;
  };
  return s(u.ru_utime) + s(u.ru_stime);
}

/// Range of the step that carries the instant at which the scan went out: microseconds of CLOCK_MONOTONIC,
/// 17 bits in each of two steps.
constexpr std::uint32_t kLow = 0, kHigh = 1;
bool stamped(std::uint64_t, DeviceTime, std::span<std::uint32_t> range, std::span<std::uint32_t>) {
  for (std::size_t s = 0; s < range.size(); ++s) range[s] = static_cast<std::uint32_t>(1000 + s);
  const auto us = static_cast<std::uint64_t>(monotonic_now().ns() / 1000);
  range[kLow] = static_cast<std::uint32_t>(us & 0x7fff) + 100;
  range[kHigh] = static_cast<std::uint32_t>(us >> 15 & 0x7fff) + 100;
  return true;
}
/// Since that instant.
Duration since(std::uint32_t low_mm, std::uint32_t high_mm, std::int64_t arrival_ns) {
  const std::int64_t sent = static_cast<std::int64_t>(high_mm - 100) << 15 | (low_mm - 100);
  const std::int64_t now = arrival_ns / 1000 & 0x3fffffff;
  return microseconds((now - sent) & 0x3fffffff);
}

pid_t start_scanner() {
  int ready[2];
  if (pipe(ready) != 0) return -1;
  const pid_t pid = fork();
  if (pid == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    ScipEmulator e;
    e.measure_by(stamped);
    ChannelConfig c;
    c.name = "bench";
    c.params = *ConfigDocument::parse("{as: pty, model: utm-30lx, link: " + kLink + "}", "bench");
    Status s = e.configure(c);
    if (s) s = e.arm({});
    if (s) s = e.start(BenchTime(0));
    if (!s) std::fprintf(stderr, "%s\n", s.error().text().c_str());
    if (write(ready[1], "r", 1) != 1 || !s) _exit(1);
    while (true) pause();
  }
  close(ready[1]);
  char c = 0;
  if (read(ready[0], &c, 1) != 1) std::exit(1);
  close(ready[0]);
  return pid;
}
void kill_scanner(pid_t pid) {
  kill(pid, SIGKILL);
  waitpid(pid, nullptr, 0);
}

/// poll, read, look for empty lines.
void plain(double seconds_long, Figures& f) {
  const int fd = open(kLink.c_str(), O_RDWR | O_NOCTTY);
  if (fd < 0) std::exit(1);
  termios t{};
  tcgetattr(fd, &t);
  cfmakeraw(&t);
  tcsetattr(fd, TCSANOW, &t);
  const std::string start = "QT\nMD0000108000000\n";
  if (write(fd, start.data(), start.size()) < 0) std::exit(1);
  const double cpu = cpu_s(RUSAGE_THREAD);
  const MonotonicTime end = monotonic_now() + seconds_from(seconds_long);
  static char buffer[65536];
  std::size_t have = 0;
  while (monotonic_now() < end) {
    pollfd p{fd, POLLIN, 0};
    if (poll(&p, 1, 100) <= 0) continue;
    const ssize_t n = read(fd, buffer + have, sizeof buffer - have);
    if (n <= 0) break;
    const std::int64_t arrival = monotonic_now().ns();
    have += static_cast<std::size_t>(n);
    while (char* e = static_cast<char*>(memmem(buffer, have, "\n\n", 2))) {
      const std::string_view reply(buffer, static_cast<std::size_t>(e - buffer));
      const std::size_t data = reply.find("\n99b\n");
      if (data != std::string_view::npos && reply.size() > data + 5 + 6 + 6) {
        const char* v = reply.data() + data + 5 + 6;  // after the status and the time
        const auto value = [](const char* c) {
          return static_cast<std::uint32_t>((c[0] - 0x30) << 12 | (c[1] - 0x30) << 6 | (c[2] - 0x30));
        };
        f.latency.record(since(value(v), value(v + 3), arrival));
        ++f.scans;
      }
      const std::size_t used = reply.size() + 2;
      memmove(buffer, buffer + used, have - used);
      have -= used;
    }
    if (have == sizeof buffer) have = 0;
  }
  f.cpu_us_per_scan =
      (cpu_s(RUSAGE_THREAD) - cpu) * 1e6 / static_cast<double>(std::max<std::uint64_t>(1, f.scans));
  if (write(fd, "QT\n", 3) < 0) std::exit(1);
  close(fd);
}

void ours(double seconds_long, pid_t& scanner, Figures& f) {
  ScipSource source(make_plain_link);
  ChannelConfig c;
  c.name = "bench";
  c.kind = SampleKind::point_cloud;
  c.period = milliseconds(25);
  c.latency = milliseconds(40);
  c.params = *ConfigDocument::parse("{transport: tty, slots: 64, device: " + kLink + "}", "bench");
  Status s = source.configure(c);
  if (s) s = source.arm({});
  if (s) s = source.start(bench_now());
  if (!s) {
    std::fprintf(stderr, "%s\n", s.error().text().c_str());
    std::exit(1);
  }
  const double cpu = cpu_s(RUSAGE_SELF), mine = cpu_s(RUSAGE_THREAD);
  const auto take = [&](auto&& each) {
    while (SampleLease lease = source.poll(bench_now())) each(*lease);
  };
  const MonotonicTime end = monotonic_now() + seconds_from(seconds_long);
  while (monotonic_now() < end) {
    take([&](const Sample& sample) {
      LidarPoint low, high;
      std::memcpy(&low, sample.bytes().data(), sizeof low);
      std::memcpy(&high, sample.bytes().data() + sizeof low, sizeof high);
      const auto mm = [](const LidarPoint& p) {
        return static_cast<std::uint32_t>(std::lround(
            1e3 * std::sqrt(static_cast<double>(p.x_m) * p.x_m + static_cast<double>(p.y_m) * p.y_m)));
      };
      f.latency.record(since(mm(low), mm(high), sample.stamp.t_arrival.ns()));
      f.lost += sample.stamp.lost_before;
      ++f.scans;
    });
    usleep(1000);
  }
  f.cpu_us_per_scan = (cpu_s(RUSAGE_SELF) - cpu - (cpu_s(RUSAGE_THREAD) - mine)) * 1e6 /
                      static_cast<double>(std::max<std::uint64_t>(1, f.scans));
  kill_scanner(scanner);
  while (source.health().connected) usleep(1000), take([](const Sample&) {});
  scanner = start_scanner();
  const MonotonicTime back = monotonic_now();
  bool seen = false;
  while (!seen && monotonic_now() < back + seconds(20))
    take([&](const Sample&) { seen = true; }), usleep(500);
  f.recover_ms = (monotonic_now() - back).seconds() * 1e3;
  (void)source.stop();
}

}  // namespace

int main(int argc, char** argv) {
  double seconds_long = 30;
  std::string json;
  for (int i = 1; i + 1 < argc; i += 2) {
    if (std::string(argv[i]) == "--seconds") seconds_long = std::atof(argv[i + 1]);
    if (std::string(argv[i]) == "--json") json = argv[i + 1];
  }
  pid_t scanner = start_scanner();
  Figures reader, channel;
  plain(seconds_long, reader);
  usleep(300000);
  ours(seconds_long, scanner, channel);
  kill_scanner(scanner);
  unlink(kLink.c_str());
  std::printf("%-14s %8s %6s %10s %10s %14s\n", "", "scans", "lost", "p50 us", "p99 us", "CPU us/scan");
  const auto row = [](const char* name, const Figures& f) {
    std::printf("%-14s %8lu %6lu %10.1f %10.1f %14.1f\n", name, f.scans, f.lost,
                static_cast<double>(f.latency.percentile(0.5).ns()) * 1e-3,
                static_cast<double>(f.latency.percentile(0.99).ns()) * 1e-3, f.cpu_us_per_scan);
  };
  row("plain reader", reader);
  row("channel", channel);
  std::printf("back after a kill: %.0f ms from the scanner's start to the first scan\n", channel.recover_ms);
  if (!json.empty()) {
    std::ofstream out(json);
    const auto put = [&](const char* name, const Figures& f) {
      out << "  \"" << name << "\": {\"scans\": " << f.scans << ", \"lost\": " << f.lost
          << ", \"p50_us\": " << static_cast<double>(f.latency.percentile(0.5).ns()) * 1e-3
          << ", \"p99_us\": " << static_cast<double>(f.latency.percentile(0.99).ns()) * 1e-3
          << ", \"cpu_us_per_scan\": " << f.cpu_us_per_scan << "},\n";
    };
    out << "{\n";
    put("plain", reader);
    put("channel", channel);
    out << "  \"recover_ms\": " << channel.recover_ms << "\n}\n";
    if (!out) return 1;
  }
  return channel.scans > 0 ? 0 : 1;
}
