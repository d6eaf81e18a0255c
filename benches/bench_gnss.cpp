// A satellite receiver on a pseudo-terminal, from an emulated one in a process of its own: time from the
// instant of a solution to its sample (the receiver's 20 ms of processing are taken off), CPU for each
// solution, solutions lost; beside the plainest program that reads the same kind of stream from another
// receiver like it (read into a buffer, find NAV-PVT by its head, take a time, check nothing). Then the same
// at ten times the rate.
//
//   bench_gnss [--seconds 10] [--rate 10] [--json FILE]
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <string>
#include <thread>

#include "drivers/gnss/gnss_emulator.h"
#include "drivers/gnss/gnss_source.h"
#include "rt-core/epoch.h"
#include "rt-core/histogram.h"

namespace {

using namespace rigor;
using namespace rigor::gnss;

constexpr Duration kProcessing = milliseconds(20);

class StandingReceiver final : public SampleProvider {
 public:
  Geometry geometry() const override { return {SampleKind::nav_fix, 0, 0, 0, "receiver"}; }
  Status capture(const Request&, Sample& s) override {
    NavFix f;
    f.status = FixStatus::rtk_fixed;
    f.satellites = 24;
    f.latitude_deg = 48, f.longitude_deg = 9, f.height_m = 400;
    f.covariance_enu_m2 = {1e-4, 0, 0, 0, 1e-4, 0, 0, 0, 4e-4};
    s.info = f;
    return {};
  }
};

ChannelConfig config_of(const std::string& keys, double rate_hz) {
  ChannelConfig c;
  c.name = "rover";
  c.kind = SampleKind::nav_fix;
  c.period = Period::of_hz(rate_hz);
  c.latency = milliseconds(60);
  c.params = *ConfigDocument::parse(keys, "bench");
  return c;
}

/// An emulated receiver in a process of its own.
class ReceiverProcess {
 public:
  explicit ReceiverProcess(double rate_hz) {
    int report[2];
    if (pipe(report) != 0) std::exit(1);
    pid_ = fork();
    if (pid_ == 0) {
      prctl(PR_SET_PDEATHSIG, SIGKILL);
      GnssEmulator emulator;
      DeviceParts parts;
      parts.samples = std::make_shared<StandingReceiver>();
      emulator.attach(parts);
      const std::string keys = "{baud: 921600, rate_hz: " + std::to_string(rate_hz) + "}";
      auto s = emulator.configure(config_of(keys, rate_hz));
      if (s) s = emulator.arm({});
      if (s) s = emulator.start(bench_now());
      if (!s) std::fprintf(stderr, "%s\n", s.error().text().c_str()), _exit(1);
      const std::string at = emulator.where() + "\n";
      if (write(report[1], at.data(), at.size()) < 0) _exit(1);
      while (true) pause();
    }
    close(report[1]);
    char c = 0;
    while (read(report[0], &c, 1) == 1 && c != '\n') device += c;
    close(report[0]);
  }
  ~ReceiverProcess() {
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
  }
  std::string device;

 private:
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

struct Figures {
  Histogram latency;
  std::uint64_t solutions = 0, lost = 0;
  double cpu_us = 0;
};

/// Instants lie on whole periods of UTC: how long ago the last one was, less the processing.
void note(Figures& f, const EpochPair& epoch, double rate_hz) {
  const auto period = static_cast<std::int64_t>(1e9 / rate_hz);
  const std::int64_t utc = epoch.to_utc(bench_now()).ns() - kProcessing.ns();
  f.latency.record(Duration(utc % period));
  ++f.solutions;
}

void read_plainly(const std::string& device, double rate_hz, const std::atomic<bool>& end, Figures& f) {
  const int fd = open(device.c_str(), O_RDWR | O_NOCTTY);
  termios t{};
  tcgetattr(fd, &t);
  cfmakeraw(&t);
  cfsetspeed(&t, B921600);
  tcsetattr(fd, TCSANOW, &t);
  const EpochPair epoch = read_epoch();
  static unsigned char buffer[65536];
  const double before = cpu_s(RUSAGE_THREAD);
  std::uint32_t last = 0;
  while (!end) {
    pollfd p{fd, POLLIN, 0};
    if (poll(&p, 1, 100) <= 0) continue;
    const ssize_t n = read(fd, buffer, sizeof buffer);
    for (ssize_t i = 0; i + 10 < n; ++i) {
      if (buffer[i] != 0xB5 || buffer[i + 1] != 0x62 || buffer[i + 2] != 1 || buffer[i + 3] != 7) continue;
      std::uint32_t itow = 0;
      std::memcpy(&itow, buffer + i + 6, 4);
      const auto step = static_cast<std::uint32_t>(1000 / rate_hz + 0.5);
      if (last != 0 && itow > last) f.lost += (itow - last) / step - 1;
      last = itow;
      note(f, epoch, rate_hz);
    }
  }
  f.cpu_us =
      (cpu_s(RUSAGE_THREAD) - before) * 1e6 / static_cast<double>(std::max<std::uint64_t>(1, f.solutions));
  close(fd);
}

double us(Duration d) { return d.seconds() * 1e6; }

void print(const char* name, double rate_hz, const Figures& f) {
  std::printf(
      "%-6s %4.0f Hz  %llu solutions, %llu lost | instant to here p50 %.0f p99 %.0f max %.0f us | CPU %.1f "
      "us each\n",
      name, rate_hz, static_cast<unsigned long long>(f.solutions), static_cast<unsigned long long>(f.lost),
      us(f.latency.percentile(0.5)), us(f.latency.percentile(0.99)), us(f.latency.max()), f.cpu_us);
}
void to_json(std::ofstream& out, const char* name, const Figures& f) {
  out << "\"" << name << "\": {\"solutions\": " << f.solutions << ", \"lost\": " << f.lost
      << ", \"latency_p50_us\": " << us(f.latency.percentile(0.5))
      << ", \"latency_p99_us\": " << us(f.latency.percentile(0.99))
      << ", \"latency_max_us\": " << us(f.latency.max()) << ", \"cpu_us_each\": " << f.cpu_us << "}";
}

bool measure(double rate_hz, double duration_s, Figures& ours, Figures& plain) {
  const ReceiverProcess one(rate_hz), other(rate_hz);
  std::atomic<bool> end{false};
  std::thread reader([&] { read_plainly(other.device, rate_hz, end, plain); });
  GnssSource source;
  auto s =
      source.configure(config_of("{baud: 921600, output_delay_ms: 20, device: " + one.device + "}", rate_hz));
  if (s) s = source.arm({});
  if (s) s = source.start(bench_now());
  if (!s) std::fprintf(stderr, "%s\n", s.error().text().c_str());
  const EpochPair epoch = read_epoch();
  const double before = cpu_s(RUSAGE_SELF);
  const MonotonicTime until = monotonic_now() + seconds_from(duration_s);
  double polling_s = 0;
  while (s && monotonic_now() < until) {
    const double poll_began = cpu_s(RUSAGE_THREAD);
    while (auto lease = source.poll(bench_now() + seconds(1))) {
      const auto period = static_cast<std::int64_t>(1e9 / rate_hz);
      const std::int64_t utc = epoch.to_utc(lease->stamp.t_arrival).ns() - kProcessing.ns();
      ours.latency.record(Duration(utc % period));
      ++ours.solutions;
    }
    const timespec pause{0, 1'000'000};
    nanosleep(&pause, nullptr);
    polling_s += cpu_s(RUSAGE_THREAD) - poll_began;
  }
  end = true;
  reader.join();
  ours.lost = source.health().lost + source.health().no_slot + source.health().ring_full;
  const double plain_s = plain.cpu_us * 1e-6 * static_cast<double>(plain.solutions);
  ours.cpu_us = (cpu_s(RUSAGE_SELF) - before - polling_s - plain_s) * 1e6 /
                static_cast<double>(std::max<std::uint64_t>(1, ours.solutions));
  if (s) (void)source.stop();
  return s.has_value();
}

}  // namespace

int main(int argc, char** argv) {
  double duration_s = 10, rate_hz = 10;
  std::string json;
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string key = argv[i];
    if (key == "--seconds") duration_s = std::atof(argv[i + 1]);
    if (key == "--rate") rate_hz = std::atof(argv[i + 1]);
    if (key == "--json") json = argv[i + 1];
  }
  std::ofstream out;
  if (!json.empty()) out.open(json), out << "{";
  for (const double times : {1.0, 10.0}) {
    Figures ours, plain;
    if (!measure(rate_hz * times, duration_s, ours, plain)) return 1;
    print("Rigor", rate_hz * times, ours);
    print("plain", rate_hz * times, plain);
    if (json.empty()) continue;
    out << (times > 1 ? ", \"ten_times\": {" : "\"rate\": {");
    to_json(out, "rigor", ours), out << ", ", to_json(out, "plain", plain), out << "}";
  }
  if (!json.empty()) out << "}\n";
  return 0;
}
