// An OS1-128 over loopback, with its 24,832 bytes a packet: our source, and beside it the plainest program
// that reads the same packets, a thread with recvfrom and a timestamp. What sends is a process of its own.
//
//   sender    packets of whole frames at absolute instants, to both in turn: 1024x10, 2048x10, and ten times
//             1024x10. Latency of the source is from the send of a frame's last packet until the frame,
//             decoded, lies in the channel's ring (t_arrival); that of the plain program from the send of
//             each packet until recvfrom returns. CPU is that of the receiving thread for each packet.
//   emulator  the emulated sensor with its HTTP server in place of the sender, at 1024x10 and 2048x10: what
//   is
//             lost between it and the source, and the CPU of the emulator's process for each packet. The
//             simulated LiDAR of it takes no time.
//
//   bench_ouster [--json FILE] [--seconds S]
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "benches/packet_bench.h"
#include "drivers/ouster/ouster_emulator.h"
#include "drivers/ouster/ouster_source.h"
#include "rt-core/byte_order.h"
#include "tests/drivers/network/free_ports.h"

namespace {

using namespace rigor;
using namespace rigor::ouster;
using bench::at_share;
using bench::cpu_of_threads;

constexpr std::uint32_t kBeams = 128;

[[noreturn]] void give_up(const std::string& why) {
  std::fprintf(stderr, "bench_ouster: %s\n", why.c_str());
  std::exit(1);
}
void must(const Status& s) {
  if (!s) give_up(s.error().text());
}

/// A sensor in the middle of a hall: every beam has a return.
class Hall final : public SampleProvider {
 public:
  explicit Hall(LidarMode mode) {
    scan_.columns = mode.columns;
    scan_.column_period_s = 1.0 / (mode.columns * mode.rate_hz);
    scan_.rotation_radps = -2 * M_PI * mode.rate_hz;
    scan_.start_azimuth_rad = M_PI;
    scan_.beams.resize(kBeams);
    for (std::size_t row = 0; row < kBeams; ++row) {
      scan_.beams[row].elevation_rad = (22.5 - static_cast<double>(row) * 45 / 127) * M_PI / 180;
      scan_.beams[row].radial_offset_m = 0.0158;
    }
    for (std::uint32_t c = 0; c < mode.columns; ++c)
      for (std::size_t row = 0; row < kBeams; ++row) {
        const auto aim = models::rotor_aim(scan_.beams[row], scan_.azimuth_rad(c));
        const double range = 10 + 0.01 * static_cast<double>(c % 100);
        points_.push_back({static_cast<float>(aim.origin_m[0] + range * aim.direction[0]),
                           static_cast<float>(aim.origin_m[1] + range * aim.direction[1]),
                           static_cast<float>(aim.origin_m[2] + range * aim.direction[2]), 40,
                           static_cast<std::int32_t>(std::lround(c * scan_.column_period_s * 1e9)),
                           static_cast<std::uint16_t>(row), 0, 0});
      }
  }
  Geometry geometry() const override {
    return {SampleKind::point_cloud, 0, 0, points_.size() * sizeof(LidarPoint), "lidar"};
  }
  const models::LidarScan* scan() const override { return &scan_; }
  Status capture(const Request&, Sample& sample) override {
    sample.size_bytes = points_.size() * sizeof(LidarPoint);
    std::memcpy(sample.memory().data(), points_.data(), sample.size_bytes);
    sample.info = PointCloudInfo{static_cast<std::uint32_t>(points_.size())};
    return {};
  }

 private:
  models::LidarScan scan_;
  std::vector<LidarPoint> points_;
};

/// What both processes see.
struct Shared {
  std::atomic<bool> stop{false}, ready{false};
  std::atomic<std::uint64_t> sent{0};  ///< packets, to either port
  std::atomic<std::uint16_t> http_port{0};
  std::int64_t start_ns = 0;                                         ///< of frame 0, monotonic
  std::array<std::array<std::atomic<std::int64_t>, 2>, 65536> at{};  ///< when packet k went to either port
  double cpu_s = 0;
};
/// A process of its own while it lives.
class Child {
 public:
  template <class F>
  explicit Child(F&& work) {
    void* memory = mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (memory == MAP_FAILED) give_up("no shared memory");
    shared_ = new (memory) Shared;
    std::fflush(nullptr);
    pid_ = fork();
    if (pid_ < 0) give_up("fork failed");
    if (pid_ == 0) {
      (void)prctl(PR_SET_PDEATHSIG, SIGKILL);
      work(*shared_);
      shared_->cpu_s = bench::cpu_s(RUSAGE_SELF);
      _exit(0);
    }
    while (!shared_->ready) {
      int status = 0;
      if (waitpid(pid_, &status, WNOHANG) == pid_) give_up("the sender did not start");
      usleep(1000);
    }
  }
  ~Child() { munmap(shared_, sizeof(Shared)); }
  void stop() {
    shared_->stop = true;
    (void)waitpid(pid_, nullptr, 0);
  }
  Shared* operator->() { return shared_; }

 private:
  Shared* shared_ = nullptr;
  pid_t pid_ = -1;
};

/// Frame after frame, the same but for its id and its times, which are UTC.
void send_packets(Shared& shared, const SensorDevice& device, const Metadata& m,
                  std::array<std::uint16_t, 2> ports) {
  auto scan = device.make_scan();
  {
    auto measuring = SensorDevice::create(std::make_shared<Hall>(m.mode));
    if (!measuring || !measuring->measure(0, BenchTime(0), {}, scan)) give_up("no scan");
  }
  const PacketLayout layout = layout_of(m);
  std::vector<std::vector<std::uint8_t>> packets;
  LidarPacketWriter w(layout);
  for (std::uint32_t slot = 0; slot < m.slots(); ++slot) {
    device.compose(0, slot, &scan, m, 0, w);
    packets.emplace_back(w.bytes().begin(), w.bytes().end());
  }
  const int fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const EpochPair epoch = read_epoch();
  const double column_ns = m.column_period_s() * 1e9;
  shared.start_ns = monotonic_now().ns() + 20'000'000;
  shared.ready = true;
  const std::int64_t utc = epoch.to_utc(BenchTime(shared.start_ns)).ns();
  for (std::uint64_t k = 0; !shared.stop; ++k) {
    const std::uint64_t slot = k % m.slots(), first = k * m.columns_per_packet;
    auto& p = packets[slot];
    store_le(p, 2, static_cast<std::uint16_t>(k / m.slots()));
    for (std::uint64_t i = 0; i < m.columns_per_packet; ++i)
      store_le(p, layout.header_bytes + i * layout.column_bytes,
               static_cast<std::uint64_t>(utc + std::llround(static_cast<double>(first + i) * column_ns)));
    const std::int64_t due =
        shared.start_ns + std::llround(static_cast<double>(first + m.columns_per_packet) * column_ns);
    const timespec ts{due / 1'000'000'000, due % 1'000'000'000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &ts, nullptr);
    for (const std::size_t to_whom : {k % 2, 1 - k % 2}) {
      to.sin_port = htons(ports[to_whom]);
      shared.at[k % shared.at.size()][to_whom] = monotonic_now().ns();
      (void)sendto(fd, p.data(), p.size(), 0, reinterpret_cast<sockaddr*>(&to), sizeof to);
    }
    shared.sent = k + 1;
  }
  close(fd);
}

ChannelConfig config_of(const std::string& params, const LidarMode& mode) {
  ChannelConfig c;
  c.name = "bench";
  c.kind = SampleKind::point_cloud;
  c.period = Period(seconds_from(1.0 / mode.rate_hz));
  c.params = ConfigDocument::parse(params).value();
  return c;
}

nlohmann::json measure_sender(LidarMode mode, const std::string& name, double run_s) {
  auto device = SensorDevice::create(std::make_shared<Hall>(mode));
  if (!device) give_up(device.error().text());
  auto control = SensorControl::create(*device, {}, "{}", MonotonicTime(0));
  if (!control) give_up(control.error().text());
  const Metadata m = control->active().metadata;
  const PacketLayout layout = layout_of(m);
  const std::string file = "/tmp/bench_ouster_" + std::to_string(getpid()) + ".json";
  std::ofstream(file) << control->http("GET", "/api/v1/sensor/metadata", "", "", MonotonicTime(1)).body;
  const auto ports = network::test::free_ports();
  Child sender([&](Shared& shared) { send_packets(shared, *device, m, ports); });
  bench::PlainReceiver plain(
      ports[1], layout.packet_bytes, 4 << 20, [&](const std::vector<std::uint8_t>& bytes, std::size_t) {
        return load_le<std::uint16_t>(bytes, 2) * std::uint64_t{m.slots()} +
               load_le<std::uint16_t>(bytes, layout.header_bytes + 8) / m.columns_per_packet;
      });
  OusterSource source;
  must(source.configure(config_of("{time: utc, utc_offset_s: 0, buffers: 64, address: 127.0.0.1, metadata: " +
                                      file + ", lidar_port: " + std::to_string(ports[0]) + "}",
                                  mode)));
  must(source.arm({}));
  std::remove(file.c_str());
  must(source.start(bench_now()));
  const auto before = source.counters();
  const double cpu_before = cpu_of_threads("ouster");
  const std::uint64_t sent_before = sender->sent;
  const std::size_t plain_before = plain.arrivals.size();
  std::vector<double> source_us, plain_us;
  const double frame_ns = 1e9 / mode.rate_hz;
  const std::int64_t end = monotonic_now().ns() + static_cast<std::int64_t>(run_s * 1e9);
  while (monotonic_now().ns() < end) {
    while (SampleLease s = source.poll(bench_now())) {
      const double since = static_cast<double>(s->stamp.t_capture.ns() - sender->start_ns);
      const auto last = (static_cast<std::uint64_t>(std::llround(since / frame_ns)) + 1) * m.slots() - 1;
      source_us.push_back(
          static_cast<double>(s->stamp.t_arrival.ns() - sender->at[last % sender->at.size()][0]) * 1e-3);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  const auto after = source.counters();
  const double cpu = cpu_of_threads("ouster") - cpu_before;
  const std::uint64_t sent = sender->sent - sent_before;
  const std::size_t plain_after = plain.arrivals.size();
  sender.stop();
  plain.stop();
  (void)source.stop();
  for (std::size_t i = plain_before; i < plain_after; ++i) {
    const auto& [k, t] = plain.arrivals[i];
    plain_us.push_back(static_cast<double>(t - sender->at[k % sender->at.size()][1]) * 1e-3);
  }
  const double packets = static_cast<double>(std::max<std::uint64_t>(1, after.packets - before.packets));
  return {{"name", name},
          {"packets_per_s", mode.rate_hz * m.slots()},
          {"seconds", run_s},
          {"sent", sent},
          {"source",
           {{"packets", after.packets - before.packets},
            {"frames", source_us.size()},
            {"packets_lost", after.packets_lost - before.packets_lost},
            {"frames_lost", after.frames_lost - before.frames_lost},
            {"kernel_drops", after.kernel_drops - before.kernel_drops},
            {"p50_us", at_share(source_us, 0.5)},
            {"p99_us", at_share(source_us, 0.99)},
            {"cpu_us_per_packet", cpu * 1e6 / packets}}},
          {"plain",
           {{"packets", plain_after - plain_before},
            {"p50_us", at_share(plain_us, 0.5)},
            {"p99_us", at_share(plain_us, 0.99)},
            {"cpu_us_per_packet", plain.cpu_us_per_packet()}}}};
}

nlohmann::json measure_emulator(LidarMode mode, const std::string& name, double run_s) {
  const auto ports = network::test::free_ports();
  Child device([&](Shared& shared) {
    OusterEmulator emulator;
    DeviceParts parts;
    parts.samples = std::make_shared<Hall>(mode);
    emulator.attach(std::move(parts));
    must(emulator.configure(
        config_of("{tcp_port: 0, http_port: 0, config: {udp_port_lidar: " + std::to_string(ports[0]) +
                      ", udp_port_imu: " + std::to_string(ports[1]) + "}}",
                  mode)));
    must(emulator.arm({}));
    must(emulator.start(bench_now()));
    shared.http_port = emulator.http_port();
    shared.ready = true;
    while (!shared.stop) usleep(1000);
    shared.sent = emulator.health().received;
    (void)emulator.stop();
  });
  OusterSource source;
  must(source.configure(config_of(
      "{buffers: 64, host: 127.0.0.1, http_port: " + std::to_string(device->http_port) + "}", mode)));
  must(source.arm({}));
  must(source.start(bench_now()));
  const auto before = source.counters();
  std::uint64_t frames = 0;
  for (const std::int64_t end = monotonic_now().ns() + static_cast<std::int64_t>(run_s * 1e9);
       monotonic_now().ns() < end;) {
    while (source.poll(bench_now())) ++frames;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  const auto after = source.counters();
  (void)source.stop();
  device.stop();
  return {{"name", name},
          {"packets_per_s", mode.rate_hz * mode.columns / 16},
          {"seconds", run_s},
          {"packets", after.packets - before.packets},
          {"frames", frames},
          {"packets_lost", after.packets_lost - before.packets_lost},
          {"frames_lost", after.frames_lost - before.frames_lost},
          {"emulator_cpu_us_per_packet",
           device->cpu_s * 1e6 / static_cast<double>(std::max<std::uint64_t>(1, device->sent))}};
}

}  // namespace

int main(int argc, char** argv) {
  const bench::PacketBenchOptions options(argc, argv);
  nlohmann::json out = {{"sender", nlohmann::json::array()}, {"emulator", nlohmann::json::array()}};
  std::printf("%-14s %9s %7s | %19s %13s | %19s %13s\n", "sender", "packets/s", "sent", "source p50/p99 us",
              "CPU us, lost", "plain p50/p99 us", "CPU us, lost");
  for (const auto& [mode, name] : {std::pair{LidarMode{1024, 10}, "1024x10"},
                                   {LidarMode{2048, 10}, "2048x10"},
                                   {LidarMode{1024, 100}, "1024x10 x 10"}}) {
    const nlohmann::json r = measure_sender(mode, name, options.seconds);
    const auto &s = r["source"], &p = r["plain"];
    std::printf("%-14s %9d %7lu | %9.1f %9.1f %8.2f %4lu | %9.1f %9.1f %8.2f %4ld\n", name,
                r["packets_per_s"].get<int>(), r["sent"].get<std::uint64_t>(), s["p50_us"].get<double>(),
                s["p99_us"].get<double>(), s["cpu_us_per_packet"].get<double>(),
                s["packets_lost"].get<std::uint64_t>(), p["p50_us"].get<double>(), p["p99_us"].get<double>(),
                p["cpu_us_per_packet"].get<double>(),
                std::max(0L, r["sent"].get<long>() - p["packets"].get<long>() - 1));
    out["sender"].push_back(r);
  }
  std::printf("%-14s %9s %7s %7s %13s\n", "emulator", "packets/s", "came", "lost", "CPU us/packet");
  for (const auto& [mode, name] :
       {std::pair{LidarMode{1024, 10}, "1024x10"}, {LidarMode{2048, 10}, "2048x10"}}) {
    const nlohmann::json r = measure_emulator(mode, name, options.seconds);
    std::printf("%-14s %9d %7lu %7lu %13.2f\n", name, r["packets_per_s"].get<int>(),
                r["packets"].get<std::uint64_t>(), r["packets_lost"].get<std::uint64_t>(),
                r["emulator_cpu_us_per_packet"].get<double>());
    out["emulator"].push_back(r);
  }
  if (!options.json.empty()) std::ofstream(options.json) << out.dump(2) << "\n";
  return 0;
}
