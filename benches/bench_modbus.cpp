// Modbus TCP over loopback, 100 registers a thousand times a second, from an emulated device in a process of
// its own: what the channel adds to the plainest program that does the same. In one run, one after the other:
// a loop of clock_nanosleep, modbus_read_input_registers and a timestamp; then the channel with a consumer
// that polls. For both: the time from the device's looking at its registers (which it writes into them) to
// the values in hand, CPU of the reading process for each sample, rate and loss. Then the device is killed
// and comes back: time to recover, and whether every instant is accounted for. An instant is left out where
// the reader is more than half a period late for it; on a machine that is busy both readers do, and the load
// is in the JSON file. The channel's consumer polls a thousand times a second, which the plain program has no
// need of: its part of the CPU is said by itself. Some 45 s.
//
//   bench_modbus [--seconds 20] [--rate 1000] [--json FILE]
#include <modbus/modbus.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>

#include "drivers/modbus/modbus_server.h"
#include "drivers/modbus/modbus_source.h"
#include "rt-core/histogram.h"

namespace {

using namespace rigor;

constexpr int kRegisters = 100;

/// 100 input registers; the first four are the instant at which they were read.
class Clock final : public RegisterModel {
 public:
  bool read(RegisterTable, std::uint16_t address, std::span<std::uint16_t> out, BenchTime t) override {
    if (address + out.size() > kRegisters) return false;
    for (std::size_t i = 0; i < out.size(); ++i) {
      const std::size_t a = address + i;
      out[i] = static_cast<std::uint16_t>(a < 4 ? t.ns() >> (16 * (3 - a)) : 0x1000 + a);
    }
    return true;
  }
  bool write(RegisterTable, std::uint16_t, std::span<const std::uint16_t>, BenchTime) override {
    return false;
  }
};

BenchTime now() { return bench_now(); }

double thread_cpu_s() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_nsec) * 1e-9;
}

double cpu_s() {
  rusage u{};
  getrusage(RUSAGE_SELF, &u);
  const auto s = [](timeval t) {
    return static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_usec) * 1e-6;
  };
  return s(u.ru_utime) + s(u.ru_stime);
}

/// The device in a process of its own; its port comes back.
struct Device {
  pid_t pid = -1;
  std::uint16_t port = 0;
  bool start(std::uint16_t wanted) {
    int pipes[2];
    if (pipe(pipes) != 0) return false;
    pid = fork();
    if (pid == 0) {
      prctl(PR_SET_PDEATHSIG, SIGKILL);
      modbus::Server server(std::make_shared<Clock>(), now, {});
      if (const auto s = server.listen("127.0.0.1", wanted); !s || !server.start()) _exit(1);
      const std::uint16_t p = server.port();
      if (write(pipes[1], &p, sizeof p) != sizeof p) _exit(1);
      while (true) pause();
    }
    close(pipes[1]);
    const bool good = read(pipes[0], &port, sizeof port) == sizeof port;
    close(pipes[0]);
    return good;
  }
  void stop() {
    if (pid > 0) kill(pid, SIGKILL), waitpid(pid, nullptr, 0);
    pid = -1;
  }
  ~Device() { stop(); }
};

struct Figures {
  Histogram latency;
  std::uint64_t samples = 0, lost = 0, not_taken = 0;
  double rate_hz = 0, cpu_us = 0, polling_us = 0;
};

std::int64_t instant_of(const std::uint16_t* r) {
  return static_cast<std::int64_t>(std::uint64_t{r[0]} << 48 | std::uint64_t{r[1]} << 32 |
                                   std::uint64_t{r[2]} << 16 | r[3]);
}

bool plain(std::uint16_t port, double rate_hz, double seconds_long, Figures& f) {
  modbus_t* m = modbus_new_tcp("127.0.0.1", port);
  if (modbus_connect(m) != 0) return false;
  std::uint16_t r[kRegisters];
  const std::int64_t period = std::llround(1e9 / rate_hz), t0 = monotonic_now().ns() + 10'000'000;
  const double cpu = cpu_s();
  const auto instants = static_cast<std::int64_t>(seconds_long * rate_hz);
  for (std::int64_t k = 0; k < instants; ++k) {
    const std::int64_t due = t0 + k * period;
    if (monotonic_now().ns() > due + period / 2) {
      ++f.lost;
      continue;
    }
    const timespec t{due / 1'000'000'000, due % 1'000'000'000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, nullptr);
    if (modbus_read_input_registers(m, 0, kRegisters, r) != kRegisters) return false;
    f.latency.record(Duration(monotonic_now().ns() - instant_of(r)));
    ++f.samples;
  }
  f.cpu_us = (cpu_s() - cpu) * 1e6 / static_cast<double>(f.samples);
  f.rate_hz = static_cast<double>(f.samples) / (static_cast<double>(monotonic_now().ns() - t0) * 1e-9);
  modbus_close(m);
  modbus_free(m);
  return true;
}

/// 50 values of two registers: what a sample carries at most is 64 values.
std::unique_ptr<modbus::ModbusSource> open(std::uint16_t port, double rate_hz) {
  std::string keys = "timeout_ms: 200\naddress: 127.0.0.1\nport: " + std::to_string(port) + "\nregisters:\n";
  for (int i = 0; i < kRegisters / 2; ++i)
    keys += "  - { name: r" + std::to_string(i) +
            ", table: input_registers, address: " + std::to_string(2 * i) + ", type: u32 }\n";
  ChannelConfig c;
  c.name = "bench";
  c.kind = SampleKind::register_block;
  c.period = seconds_from(1 / rate_hz);
  c.latency = milliseconds(1);
  c.params = *ConfigDocument::parse(keys, "bench");
  auto source = std::make_unique<modbus::ModbusSource>();
  auto s = source->configure(c);
  if (s) s = source->arm({});
  if (s) return source;
  std::fprintf(stderr, "%s\n", s.error().text().c_str());
  return nullptr;
}

bool channel(std::uint16_t port, double rate_hz, double seconds_long, Figures& f) {
  const auto source = open(port, rate_hz);
  if (!source || !source->start(now() + milliseconds(10))) return false;
  const double cpu = cpu_s(), polling = thread_cpu_s();
  const auto begin = now(), end = begin + seconds_from(seconds_long);
  while (now() < end) {
    while (const auto s = source->poll(now())) {
      const auto* v = s->as<RegisterBlock>()->value.data();
      const auto looked = static_cast<std::int64_t>(v[0]) << 32 | static_cast<std::int64_t>(v[1]);
      f.latency.record(s->stamp.t_arrival - BenchTime(looked));
      ++f.samples;
    }
    usleep(1000);
  }
  f.cpu_us = (cpu_s() - cpu) * 1e6 / static_cast<double>(std::max<std::uint64_t>(1, f.samples));
  f.polling_us =
      (thread_cpu_s() - polling) * 1e6 / static_cast<double>(std::max<std::uint64_t>(1, f.samples));
  f.rate_hz = static_cast<double>(f.samples) / (now() - begin).seconds();
  f.lost = source->health().lost;
  f.not_taken = source->health().no_slot + source->health().ring_full;
  return source->stop().has_value();
}

struct Recovery {
  double gone_s = 0, back_ms = 0;
  std::uint64_t missing = 0, counted = 0;
};

bool recover(Device& device, double rate_hz, Recovery& r) {
  const auto source = open(device.port, rate_hz);
  if (!source || !source->start(now() + milliseconds(10))) return false;
  Stamp last;
  bool any = false;
  const auto take = [&] {
    bool came = false;
    while (const auto s = source->poll(now())) {
      if (any) r.missing += s->stamp.sequence - last.sequence - 1, r.counted += s->stamp.lost_before;
      last = s->stamp;
      came = any = true;
    }
    return came;
  };
  for (const auto end = now() + seconds(1); now() < end; usleep(1000)) (void)take();
  device.stop();
  const auto killed = now();
  for (const auto end = killed + milliseconds(1500); now() < end; usleep(1000)) (void)take();
  if (!device.start(device.port)) return false;
  const auto there = now();
  r.gone_s = (there - killed).seconds();
  while (!take() && now() < there + seconds(20)) usleep(200);
  r.back_ms = (now() - there).seconds() * 1e3;
  for (const auto end = now() + milliseconds(200); now() < end; usleep(1000)) (void)take();
  return source->stop().has_value();
}

double us(Duration d) { return d.seconds() * 1e6; }

void print(const char* name, const Figures& f) {
  std::printf(
      "%-8s %8llu samples, %.1f Hz, %llu lost, %llu not taken by the consumer in time | device to hand p50 "
      "%.1f p99 %.1f max %.1f us | CPU %.1f us "
      "each, polling %.1f of it\n",
      name, static_cast<unsigned long long>(f.samples), f.rate_hz, static_cast<unsigned long long>(f.lost),
      static_cast<unsigned long long>(f.not_taken), us(f.latency.percentile(0.5)),
      us(f.latency.percentile(0.99)), us(f.latency.max()), f.cpu_us, f.polling_us);
}

void to_json(std::ofstream& out, const char* name, const Figures& f) {
  out << "\"" << name << "\": {\"samples\": " << f.samples << ", \"rate_hz\": " << f.rate_hz
      << ", \"lost\": " << f.lost << ", \"not_taken\": " << f.not_taken
      << ", \"latency_p50_us\": " << us(f.latency.percentile(0.5))
      << ", \"latency_p99_us\": " << us(f.latency.percentile(0.99))
      << ", \"latency_max_us\": " << us(f.latency.max()) << ", \"cpu_us_per_sample\": " << f.cpu_us
      << ", \"polling_cpu_us_per_sample\": " << f.polling_us << "}";
}

}  // namespace

int main(int argc, char** argv) {
  double seconds_long = 20, rate_hz = 1000;
  std::string json;
  for (int i = 1; i < argc; i += 2) {
    const std::string key = argv[i];
    if (i + 1 < argc && key == "--seconds")
      seconds_long = std::atof(argv[i + 1]);
    else if (i + 1 < argc && key == "--rate")
      rate_hz = std::atof(argv[i + 1]);
    else if (i + 1 < argc && key == "--json")
      json = argv[i + 1];
    else
      return std::fprintf(stderr, "usage: bench_modbus [--seconds S] [--rate HZ] [--json FILE]\n"), 2;
  }
  Device device;
  Figures p, c;
  Recovery r;
  if (!device.start(0) || !plain(device.port, rate_hz, seconds_long, p) ||
      !channel(device.port, rate_hz, seconds_long, c) || !recover(device, rate_hz, r))
    return 1;
  print("plain C", p);
  print("channel", c);
  const double added50 = us(c.latency.percentile(0.5)) - us(p.latency.percentile(0.5)),
               added99 = us(c.latency.percentile(0.99)) - us(p.latency.percentile(0.99));
  std::printf("added    p50 %.1f us, p99 %.1f us\n", added50, added99);
  std::printf(
      "killed   gone for %.2f s, back %.0f ms after the device; %llu instants missing, %llu accounted for\n",
      r.gone_s, r.back_ms, static_cast<unsigned long long>(r.missing),
      static_cast<unsigned long long>(r.counted));
  if (!json.empty()) {
    std::ofstream out(json);
    double load[1] = {0};
    (void)getloadavg(load, 1);
    out << "{\"registers\": " << kRegisters << ", \"wanted_hz\": " << rate_hz << ", \"load\": " << load[0]
        << ", \"cpus\": " << sysconf(_SC_NPROCESSORS_ONLN) << ", ";
    to_json(out, "plain", p);
    out << ", ";
    to_json(out, "channel", c);
    out << ", \"added_p50_us\": " << added50 << ", \"added_p99_us\": " << added99
        << ", \"gone_s\": " << r.gone_s << ", \"recovery_ms\": " << r.back_ms
        << ", \"missing\": " << r.missing << ", \"accounted\": " << r.counted << "}\n";
    if (!out.good()) return 1;
  }
  return r.missing == r.counted ? 0 : 1;
}
