// A SICK scanner over loopback, from an emulated one in a process of its own: time from the instant at which
// its telegram is due to the sample (the emulator's own wake-up is in it), CPU for each scan, scans lost;
// beside the plainest program that reads the same stream at the same time (recv into a buffer, a timestamp,
// nothing decoded). Then the scanner is killed and started again: time until scans come, and how many were
// counted as lost.
//
//   bench_sick [--seconds 30] [--rate 50] [--beams 1141] [--kills 5] [--json FILE]
#include <arpa/inet.h>
#include <netinet/tcp.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <string>
#include <thread>
#include <vector>

#include "drivers/sick/scanner_server.h"
#include "drivers/sick/sick_source.h"
#include "rt-core/histogram.h"
#include "sensor-hal/config/yaml.h"

namespace {

using namespace rigor;
using namespace rigor::sick;

struct Options {
  double seconds = 30, rate_hz = 50;
  int beams = 1141, kills = 5;
  std::string json;
};

ScannerConfig scanner_of(const Options& o) {
  ScannerConfig c = scanner_config(Family::lms5xx);
  c.scan_frequency_hz = o.rate_hz;
  c.pattern = {-5, step_deg(static_cast<std::uint32_t>(std::lround(190.0 / (o.beams - 1) * 1e4))),
               static_cast<std::uint32_t>(o.beams)};
  return c;
}

/// What the scanner's process says when it is ready.
struct Ready {
  std::uint16_t port = 0;
  std::int64_t switched_on_ns = 0;
};

class ScannerProcess {
 public:
  ScannerProcess(const Options& o, std::uint16_t port) {
    int report[2];
    if (pipe(report) != 0) std::exit(1);
    pid_ = fork();
    if (pid_ == 0) {
      prctl(PR_SET_PDEATHSIG, SIGKILL);
      close(report[0]);
      be_scanner(o, port, report[1]);
    }
    close(report[1]);
    if (read(report[0], &ready, sizeof ready) != sizeof ready) std::exit(1);
    close(report[0]);
  }
  ~ScannerProcess() { kill_it(); }
  void kill_it() {
    if (pid_ <= 0) return;
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
    pid_ = -1;
  }
  Ready ready;

 private:
  [[noreturn]] static void be_scanner(const Options& o, std::uint16_t port, int report) {
    const ScannerConfig c = scanner_of(o);
    std::vector<LidarPoint> points;
    for (std::uint32_t b = 0; b < c.pattern.beams; ++b) {
      const double a = (c.pattern.start_deg - kAheadDeg + c.pattern.step_deg * b) * 0.017453292519943295;
      points.push_back(
          {static_cast<float>(5 * std::cos(a)), static_cast<float>(5 * std::sin(a)), 0, 100, 0, 0, 0, 0});
    }
    ScannerServer server(
        c, [&](std::uint64_t, BenchTime) { return std::optional<std::span<const LidarPoint>>(points); }, {});
    if (!server.listen("127.0.0.1", port) || !server.start()) {
      std::fprintf(stderr, "the scanner cannot be served\n");
      _exit(1);
    }
    const Ready ready{server.port(), server.switched_on().ns()};
    if (write(report, &ready, sizeof ready) != sizeof ready) _exit(1);
    while (true) pause();
  }
  pid_t pid_ = -1;
};

double cpu_s(int who) {
  rusage u{};
  getrusage(who, &u);
  const auto s = [](timeval t) {
    return static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_usec) * 1e-6;
  };
  return s(u.ru_utime) + s(u.ru_stime);
}

/// When the telegram of scan k is due.
struct Schedule {
  explicit Schedule(const Options& o, const Ready& r) : device(scanner_of(o)), on(r.switched_on_ns) {
    due = device.transmission(DeviceTime(0)) - DeviceTime(0);
    first = device.first_beam(DeviceTime(0)) - DeviceTime(0);
  }
  [[nodiscard]] std::int64_t of_scan(std::int64_t k) const {
    return on + device.period().ns() * k + due.ns();
  }
  [[nodiscard]] std::int64_t scan_at(BenchTime t_capture) const {
    const auto period = device.period().ns();
    return (t_capture.ns() - on - first.ns() + period / 2) / period;
  }
  ScannerDevice device;
  std::int64_t on;
  Duration due, first;
};

struct Figures {
  Histogram latency;
  std::uint64_t scans = 0, lost = 0;
  double cpu_us = 0;
};

/// The plainest reader there is.
void read_plainly(std::uint16_t port, const Schedule& schedule, const std::atomic<bool>& end, Figures& f) {
  const int s = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in a{};
  a.sin_family = AF_INET;
  a.sin_port = htons(port);
  a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const timeval limit{1, 0};
  setsockopt(s, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
  if (connect(s, reinterpret_cast<const sockaddr*>(&a), sizeof a) != 0) return;
  static const char kSubscribe[] = "\2\2\2\2\0\0\0\x11sEN LMDscandata \1\x33";
  if (send(s, kSubscribe, sizeof kSubscribe - 1, 0) < 0) return;
  static std::uint8_t buffer[1 << 20];
  const auto exactly = [&](std::size_t n) {
    for (std::size_t got = 0; got < n;) {
      const auto r = recv(s, buffer + got, n - got, 0);
      if (r <= 0) return false;
      got += static_cast<std::size_t>(r);
    }
    return true;
  };
  const double before = cpu_s(RUSAGE_THREAD);
  std::int64_t last = -1;
  while (!end && exactly(8)) {
    const std::size_t size =
        std::size_t{buffer[4]} << 24 | std::size_t{buffer[5]} << 16 | std::size_t{buffer[6]} << 8 | buffer[7];
    if (size + 1 > sizeof buffer || !exactly(size + 1)) break;
    const auto now = monotonic_now().ns();
    if (std::memcmp(buffer, "sSN", 3) != 0) continue;
    const auto counter =
        static_cast<std::uint16_t>(buffer[28] << 8 | buffer[29]);  // behind name, version … telegram counter
    // The counter is that of the scan, modulo 2^16, from 1.
    const std::int64_t about = (now - schedule.on) / schedule.device.period().ns();
    const std::int64_t k = about - static_cast<std::int16_t>(static_cast<std::uint16_t>(about + 1) - counter);
    f.latency.record(Duration(now - schedule.of_scan(k)));
    if (last >= 0) f.lost += static_cast<std::uint64_t>(k - last - 1);
    last = k;
    ++f.scans;
  }
  f.cpu_us = (cpu_s(RUSAGE_THREAD) - before) * 1e6 / static_cast<double>(std::max<std::uint64_t>(1, f.scans));
  close(s);
}

bool good(const Status& s) {
  if (!s) std::fprintf(stderr, "%s\n", s.error().text().c_str());
  return s.has_value();
}

double us(Duration d) { return d.seconds() * 1e6; }

void print(const char* name, const Figures& f) {
  std::printf("%-8s %llu scans, %llu lost | due to here p50 %.0f p99 %.0f max %.0f us | CPU %.1f us/scan\n",
              name, static_cast<unsigned long long>(f.scans), static_cast<unsigned long long>(f.lost),
              us(f.latency.percentile(0.5)), us(f.latency.percentile(0.99)), us(f.latency.max()), f.cpu_us);
}

void to_json(std::ofstream& out, const char* name, const Figures& f) {
  out << "\"" << name << "\": {\"scans\": " << f.scans << ", \"lost\": " << f.lost
      << ", \"latency_p50_us\": " << us(f.latency.percentile(0.5))
      << ", \"latency_p99_us\": " << us(f.latency.percentile(0.99))
      << ", \"latency_max_us\": " << us(f.latency.max()) << ", \"cpu_us_per_scan\": " << f.cpu_us << "}";
}

}  // namespace

int main(int argc, char** argv) {
  Options o;
  for (int i = 1; i < argc; ++i) {
    const std::string key = argv[i];
    if (i + 1 >= argc) {
      std::fprintf(stderr,
                   "usage: bench_sick [--seconds S] [--rate HZ] [--beams N] [--kills N] [--json FILE]\n");
      return 2;
    }
    const char* value = argv[++i];
    if (key == "--seconds")
      o.seconds = std::atof(value);
    else if (key == "--rate")
      o.rate_hz = std::atof(value);
    else if (key == "--beams")
      o.beams = std::atoi(value);
    else if (key == "--kills")
      o.kills = std::atoi(value);
    else if (key == "--json")
      o.json = value;
    else {
      std::fprintf(stderr, "unknown option %s\n", key.c_str());
      return 2;
    }
  }
  auto scanner = std::make_unique<ScannerProcess>(o, std::uint16_t{0});
  const std::uint16_t port = scanner->ready.port;
  const Schedule schedule(o, scanner->ready);
  std::printf("%d beams with RSSI at %g Hz over loopback, %g s\n", o.beams, o.rate_hz, o.seconds);

  ChannelConfig config;
  config.name = "bench";
  config.kind = SampleKind::point_cloud;
  config.period = seconds_from(1 / o.rate_hz);
  config.latency = milliseconds(100);
  config.params = *ConfigDocument::parse("{address: 127.0.0.1, port: " + std::to_string(port) + "}", "bench");
  SickSource source;
  const auto now = [] { return bench_now(); };
  if (!good(source.configure(config)) || !good(source.arm({})) || !good(source.start(now()))) return 1;

  Figures channel, hand, plain;
  Histogram clock_error;
  std::atomic<bool> end{false};
  std::thread reader([&] { read_plainly(port, schedule, end, plain); });
  double self_before = cpu_s(RUSAGE_SELF), poll_before = cpu_s(RUSAGE_THREAD);
  const BenchTime until = now() + seconds_from(o.seconds);
  while (now() < until) {
    while (SampleLease lease = source.poll(now())) {
      const std::int64_t k = schedule.scan_at(lease->stamp.t_capture);
      hand.latency.record(Duration(now().ns() - schedule.of_scan(k)));
      channel.latency.record(Duration(lease->stamp.t_arrival.ns() - schedule.of_scan(k)));
      const auto truth = schedule.on + schedule.device.period().ns() * k + schedule.first.ns();
      clock_error.record(Duration(std::abs(lease->stamp.t_capture.ns() - truth)));
      ++channel.scans;
    }
    usleep(200);
  }
  const double poll_s = cpu_s(RUSAGE_THREAD) - poll_before;
  const double self_s = cpu_s(RUSAGE_SELF) - self_before;
  end = true;
  reader.join();
  channel.lost = source.health().lost + source.health().no_slot + source.health().ring_full;
  const double scans = static_cast<double>(std::max<std::uint64_t>(1, channel.scans));
  channel.cpu_us = (self_s - poll_s) * 1e6 / scans - plain.cpu_us;
  hand.scans = channel.scans, hand.lost = channel.lost, hand.cpu_us = channel.cpu_us;
  print("channel", channel);
  print("loop", hand);
  print("plain", plain);
  std::printf("clock error p50 %.0f p99 %.0f us\n", us(clock_error.percentile(0.5)),
              us(clock_error.percentile(0.99)));

  // Killed and started again: from the new scanner's readiness to the first sample.
  Histogram recovery;
  std::uint64_t counted = 0, away = 0;
  for (int i = 0; i < o.kills; ++i) {
    while (SampleLease lease = source.poll(now())) {
    }
    const auto lost_before = source.health().lost;
    const auto killed = now();
    scanner->kill_it();
    usleep(300'000);
    scanner = std::make_unique<ScannerProcess>(o, port);
    const auto ready = now();
    SampleLease lease;
    while (source.health().reconnects <= static_cast<std::uint64_t>(i) || !(lease = source.poll(now()))) {
      if (!lease && source.health().reconnects <= static_cast<std::uint64_t>(i)) (void)source.poll(now());
      usleep(500);
    }
    recovery.record(now() - ready);
    away += static_cast<std::uint64_t>((lease->stamp.t_capture - killed).seconds() * o.rate_hz);
    counted += source.health().lost - lost_before;
  }
  if (o.kills > 0)
    std::printf(
        "killed %d times: back after p50 %.0f max %.0f ms, %llu scans counted as lost, %llu fit into the "
        "time\n",
        o.kills, us(recovery.percentile(0.5)) * 1e-3, us(recovery.max()) * 1e-3,
        static_cast<unsigned long long>(counted), static_cast<unsigned long long>(away));
  if (!good(source.stop())) return 1;
  if (!o.json.empty()) {
    std::ofstream out(o.json);
    out << "{\"rate_hz\": " << o.rate_hz << ", \"beams\": " << o.beams << ", ";
    to_json(out, "channel", channel), out << ", ", to_json(out, "loop", hand), out << ", ",
        to_json(out, "plain", plain);
    out << ", \"clock_error_p50_us\": " << us(clock_error.percentile(0.5))
        << ", \"clock_error_p99_us\": " << us(clock_error.percentile(0.99)) << ", \"kills\": " << o.kills
        << ", \"recovery_p50_ms\": " << us(recovery.percentile(0.5)) * 1e-3
        << ", \"recovery_max_ms\": " << us(recovery.max()) * 1e-3 << ", \"lost_while_away\": " << counted
        << ", \"due_while_away\": " << away << "}\n";
    if (!out.good()) return 1;
  }
  return channel.lost == 0 || o.kills > 0 ? 0 : 1;
}
