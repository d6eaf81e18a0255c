// The CAN source beside the plainest C program that reads the same interface (a thread with recvmsg and a
// timestamp): both hear the same frames of a vcan interface, which carry the instant of their sending.
// Latency from sending to the sample's arrival, CPU of each reader per frame, loss; and the time from
// "interface up again" to the first frame. Without CAN in the kernel, only what the codec and the bus of
// virtual time cost.
//
//   bench_can [--seconds 10] [--rate 1000] [--json FILE]
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <string>
#include <thread>

#include "drivers/can/can_interfaces.h"
#include "drivers/can/can_source.h"
#include "drivers/can/signal_codec.h"
#include "drivers/can/virtual_bus.h"
#include "rt-core/histogram.h"

namespace {

using namespace rigor;
using namespace rigor::can;

constexpr const char* kBus = "rigorbench";

std::int64_t cpu_ns(clockid_t clock) {
  timespec t{};
  clock_gettime(clock, &t);
  return t.tv_sec * 1'000'000'000 + t.tv_nsec;
}
BenchTime now() { return bench_now(); }
double us(Duration d) { return static_cast<double>(d.ns()) * 1e-3; }

struct Reader {
  Histogram latency;
  std::uint64_t frames = 0;
  double cpu_us = 0;
};

/// What one writes who has never heard of a bench.
void plain_reader(std::atomic<bool>& stop, Reader& out) {
  const int fd = ::socket(PF_CAN, SOCK_RAW, CAN_RAW);
  sockaddr_can a{};
  a.can_family = AF_CAN;
  a.can_ifindex = static_cast<int>(::if_nametoindex(kBus));
  const timeval timeout{0, 100000};
  ::setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof timeout);
  if (::bind(fd, reinterpret_cast<sockaddr*>(&a), sizeof a) != 0) return;
  const auto before = cpu_ns(CLOCK_THREAD_CPUTIME_ID);
  can_frame f{};
  while (!stop.load(std::memory_order_relaxed)) {
    if (::read(fd, &f, sizeof f) != sizeof f) continue;
    std::int64_t sent = 0;
    std::memcpy(&sent, f.data, 8);
    out.latency.record(now() - BenchTime(sent));
    ++out.frames;
  }
  out.cpu_us = static_cast<double>(cpu_ns(CLOCK_THREAD_CPUTIME_ID) - before) * 1e-3;
  ::close(fd);
}

bool check(const Status& s) {
  if (!s) std::fprintf(stderr, "%s\n", s.error().text().c_str());
  return s.has_value();
}

/// Per second: decoded signals, and frames over the bus of virtual time.
struct Pure {
  double signals_per_s = 0, virtual_frames_per_s = 0;
};

Pure pure() {
  Pure p;
  const auto dbc = parse_dbc(
      "BO_ 1 M: 8 N\n SG_ A : 0|32@1- (0.001,0) [0|0] \"\" N\n SG_ B : 39|32@0- (0.001,0) [0|0] \"\" N\n",
      "bench");
  CanFrame f;
  f.length = 8;
  double values[2], sum = 0;
  constexpr int kRounds = 2'000'000;
  auto t = monotonic_now();
  for (int i = 0; i < kRounds; ++i) {
    std::memcpy(f.data.data(), &i, sizeof i);
    decode(dbc->messages[0], {f.data.data(), 8}, values);
    sum += values[0] + values[1];
  }
  p.signals_per_s = 2.0 * kRounds / (monotonic_now() - t).seconds() + (sum == 0.5 ? 1 : 0);
  struct Talker final : VirtualBus::Participant {
    explicit Talker(VirtualBus& b) : bus(b) {}
    BenchTime next_action(BenchTime until) const noexcept override {
      return next <= until ? next : BenchTime::never();
    }
    void act(BenchTime) override {
      next = next + milliseconds(1);
      CanFrame out;
      out.id = 5;
      out.length = 8;
      (void)bus.send(this, out);
    }
    void receive(const CanFrame&, BenchTime) override {}
    VirtualBus& bus;
    BenchTime next;
  };
  VirtualBus bus({});
  Talker a(bus), b(bus);
  bus.join(&a, VirtualBus::Rank::node);
  bus.join(&b, VirtualBus::Rank::node);
  t = monotonic_now();
  for (BenchTime v(0); v < BenchTime(seconds(100).ns()); v = v + milliseconds(1)) bus.advance(v);
  p.virtual_frames_per_s = static_cast<double>(bus.frames()) / (monotonic_now() - t).seconds();
  bus.leave(&a);
  bus.leave(&b);
  return p;
}

}  // namespace

int main(int argc, char** argv) {
  double seconds_each = 10, rate_hz = 1000;
  std::string json;
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string key = argv[i];
    if (key == "--seconds")
      seconds_each = std::atof(argv[i + 1]);
    else if (key == "--rate")
      rate_hz = std::atof(argv[i + 1]);
    else if (key == "--json")
      json = argv[i + 1];
    else
      return std::fprintf(stderr, "usage: bench_can [--seconds S] [--rate HZ] [--json FILE]\n"), 2;
  }
  const Pure p = pure();
  std::printf("codec      %.1f million signals/s decoded; virtual bus %.2f million frames/s\n",
              p.signals_per_s * 1e-6, p.virtual_frames_per_s * 1e-6);
  std::ofstream out;
  if (!json.empty()) out.open(json);
  out << "{\"signals_per_s\": " << p.signals_per_s
      << ", \"virtual_frames_per_s\": " << p.virtual_frames_per_s;
  if (const auto missing = can_missing(); !missing.empty()) {
    std::printf("this kernel has no CAN (%s): no interface to read\n", missing.c_str());
    out << "}\n";
    return 0;
  }
  (void)remove_interface(kBus);
  if (!check(create_vcan(kBus))) return 1;

  CanSource source;
  ChannelConfig config;
  config.name = "bench";
  config.kind = SampleKind::can_frame;
  config.params = *ConfigDocument::parse(std::string("{interface: ") + kBus + ", slots: 4096}", "bench");
  if (!check(source.configure(config)) || !check(source.arm({})) || !check(source.start(now()))) return 1;
  std::atomic<bool> stop{false};
  Reader plain, ours;
  std::thread reader([&] { plain_reader(stop, plain); });
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  RawOptions send_only;
  send_only.receive = false;
  RawSocket sender;
  if (!check(sender.open(kBus, send_only))) return 1;
  const auto process_before = cpu_ns(CLOCK_PROCESS_CPUTIME_ID), main_before = cpu_ns(CLOCK_THREAD_CPUTIME_ID);
  const Duration period = seconds_from(1 / rate_hz);
  const BenchTime end = now() + seconds_from(seconds_each);
  std::uint64_t sent = 0;
  const auto take = [&] {
    while (auto s = source.poll(now())) {
      std::int64_t t = 0;
      std::memcpy(&t, s->as<CanFrame>()->data.data(), 8);
      ours.latency.record(s->stamp.t_arrival - BenchTime(t));
      ++ours.frames;
    }
  };
  for (BenchTime next = now(); next < end; next = next + period) {
    const timespec at{next.ns() / 1'000'000'000, next.ns() % 1'000'000'000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, nullptr);
    CanFrame f;
    f.id = 0x123;
    f.length = 8;
    const std::int64_t t = now().ns();
    std::memcpy(f.data.data(), &t, 8);
    sent += sender.send(f) == 0;
    take();
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  take();
  stop = true;
  reader.join();
  const auto main_cpu = cpu_ns(CLOCK_THREAD_CPUTIME_ID) - main_before;
  const auto all_cpu = cpu_ns(CLOCK_PROCESS_CPUTIME_ID) - process_before;
  ours.cpu_us = static_cast<double>(all_cpu - main_cpu) * 1e-3 - plain.cpu_us;
  const auto print = [&](const char* name, Reader& r) {
    const double frames = static_cast<double>(std::max<std::uint64_t>(1, r.frames));
    std::printf("%-10s %llu of %llu frames; sent to read p50 %.1f p99 %.1f max %.1f us; CPU %.2f us/frame\n",
                name, static_cast<unsigned long long>(r.frames), static_cast<unsigned long long>(sent),
                us(r.latency.percentile(0.5)), us(r.latency.percentile(0.99)), us(r.latency.max()),
                r.cpu_us / frames);
    out << ", \"" << name << "\": {\"sent\": " << sent << ", \"frames\": " << r.frames
        << ", \"p50_us\": " << us(r.latency.percentile(0.5))
        << ", \"p99_us\": " << us(r.latency.percentile(0.99))
        << ", \"cpu_us_per_frame\": " << r.cpu_us / frames << "}";
  };
  print("plain", plain);
  print("rigor", ours);
  const auto lost = source.health().lost;
  (void)set_up(kBus, false);
  while (source.health().connected) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  const BenchTime up = now();
  (void)set_up(kBus, true);
  while (!source.health().connected && now() - up < seconds(30))
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  const Duration recovery = now() - up;
  std::printf("lost %llu; back %.1f ms after the interface\n", static_cast<unsigned long long>(lost),
              us(recovery) * 1e-3);
  out << ", \"lost\": " << lost << ", \"recovery_ms\": " << us(recovery) * 1e-3 << "}\n";
  const bool good = check(source.stop()) && ours.frames + lost == sent;
  (void)remove_interface(kBus);
  return good ? 0 : 1;
}
