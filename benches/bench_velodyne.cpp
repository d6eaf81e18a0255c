// A Velodyne's packets over loopback, at the device's rate and at ten times that, by our source and beside it
// by the plainest program that reads the same packets: a thread with recvfrom and a timestamp.
//
// A sender thread sends packets at absolute instants to two ports in turn. With `unit: packet` each packet is
// a sample; its latency is from the send to its lying in the ring, decoded (t_arrival), that of the plain
// program to the return of recvfrom. A loop's thread takes samples every millisecond. Recovery: the sender
// pauses for 2 s.
//
//   bench_velodyne [--json FILE] [--seconds S]
#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <string>
#include <thread>
#include <vector>

#include "benches/packet_bench.h"
#include "drivers/velodyne/velodyne_source.h"
#include "tests/drivers/network/free_ports.h"
#include "tests/drivers/velodyne/made_packets.h"

namespace {

using namespace rigor;
using namespace rigor::velodyne;
using bench::at_share;

/// Packet k is due at start + k · period and is sent to both ports.
class Sender {
 public:
  Sender(std::array<std::uint16_t, 2> ports, double packets_per_s)
      : ports_(ports), period_(seconds_from(1 / packets_per_s)) {
    const velodyne::test::Rotor rotor{};
    // A second of packets, repeated: their stamps are written anew, and so the azimuth goes on.
    for (std::uint64_t k = 0; k < 754; ++k) {
      const auto w = rotor.packet(k, [](std::uint32_t i) {
        return DataPacket::Return{static_cast<std::uint16_t>(2000 + i), 20};
      });
      packets_.emplace_back(w.bytes().begin(), w.bytes().end());
    }
    thread_ = std::thread([this] { run(); });
  }
  ~Sender() {
    stop_ = true;
    thread_.join();
  }
  void pause(bool on) { paused_ = on; }
  [[nodiscard]] std::uint64_t sent() const { return sent_; }
  /// When packet k went out; for k below sent(). Of the last 2^16.
  [[nodiscard]] std::int64_t sent_at(std::uint64_t k) const { return at_[k % at_.size()].load(); }

 private:
  void run() {
    pthread_setname_np(pthread_self(), "bench-sender");
    const int fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const std::int64_t start = monotonic_now().ns() + 10'000'000;
    for (std::uint64_t k = 0; !stop_; ++k) {
      const std::int64_t due = start + static_cast<std::int64_t>(k) * period_.ns();
      const timespec ts{due / 1'000'000'000, due % 1'000'000'000};
      clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &ts, nullptr);
      if (paused_) continue;
      std::vector<std::uint8_t>& p = packets_[k % packets_.size()];
      const auto us = static_cast<std::uint32_t>(k * 1'327'104 / 1000 % kHour_us);
      std::memcpy(p.data() + 1200, &us, sizeof us);
      at_[sent_ % at_.size()] = monotonic_now().ns();
      for (const std::uint16_t port : ports_) {
        to.sin_port = htons(port);
        (void)sendto(fd, p.data(), p.size(), 0, reinterpret_cast<sockaddr*>(&to), sizeof to);
      }
      ++sent_;
    }
    close(fd);
  }
  std::array<std::uint16_t, 2> ports_;
  Duration period_;
  std::vector<std::vector<std::uint8_t>> packets_;
  std::array<std::atomic<std::int64_t>, 65536> at_{};
  std::atomic<std::uint64_t> sent_{0};
  std::atomic<bool> stop_{false}, paused_{false};
  std::thread thread_;
};

struct Row {
  double rate, seconds;
  std::uint64_t sent, ours, plain;
  std::uint64_t kernel_drops, not_taken;  ///< by our socket; for which the loop had left no slot
  double ours_p50_us, ours_p99_us, plain_p50_us, plain_p99_us, ours_cpu_us, plain_cpu_us, recover_ms;
};

Row measure(double packets_per_s, double seconds) {
  const auto ports = network::test::free_ports();
  // Packets come in the order in which they went out.
  bench::PlainReceiver plain(ports[1], kDataBytes, 2 << 20,
                             [](const std::vector<std::uint8_t>&, std::size_t count) { return count; });
  auto sender = std::make_unique<Sender>(ports, packets_per_s);
  VelodyneSource source;
  ChannelConfig config;
  config.name = "bench";
  config.kind = SampleKind::point_cloud;
  config.params = ConfigDocument::parse(
                      "{unit: packet, model: vlp16, time: arrival, buffers: 256, position_port: 0, port: " +
                      std::to_string(ports[0]) + "}")
                      .value();
  const auto must = [](const Status& s) {
    if (!s) std::fprintf(stderr, "%s\n", s.error().text().c_str()), std::exit(1);
  };
  must(source.configure(config));
  must(source.arm({}));
  must(source.start(bench_now()));
  std::vector<double> ours_us, plain_us;
  std::int64_t end = monotonic_now().ns() + static_cast<std::int64_t>(seconds * 1e9);
  const std::size_t plain_first = plain.arrivals.size();
  const std::uint64_t sent_first = sender->sent();
  std::uint64_t ours = 0, k = sent_first;
  while (monotonic_now().ns() < end) {
    while (SampleLease s = source.poll(bench_now())) {
      ++ours;
      // Which packet it was: the last that had gone out when the kernel had this one.
      const std::int64_t here = s->stamp.t_capture.ns() + 1'327'104;
      while (k + 1 < sender->sent() && sender->sent_at(k + 1) <= here) ++k;
      ours_us.push_back(static_cast<double>(s->stamp.t_arrival.ns() - sender->sent_at(k)) * 1e-3);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  Row r{};
  r.rate = packets_per_s, r.seconds = seconds;
  r.sent = sender->sent() - sent_first;
  r.ours = ours;
  r.ours_cpu_us =
      bench::cpu_of_threads("velodyne") * 1e6 / static_cast<double>(std::max<std::uint64_t>(1, ours));
  r.kernel_drops = source.counters().kernel_drops;
  r.not_taken = source.health().no_slot + source.health().ring_full;
  const std::size_t plain_last = plain.arrivals.size();
  r.plain = plain_last - plain_first;
  for (std::size_t i = plain_first; i < plain_last; ++i)
    plain_us.push_back(static_cast<double>(plain.arrivals[i].second - sender->sent_at(i)) * 1e-3);
  // Away for two seconds, and back.
  sender->pause(true);
  std::this_thread::sleep_for(std::chrono::seconds(2));
  while (source.poll(bench_now())) {
  }
  const std::int64_t back = monotonic_now().ns();
  sender->pause(false);
  while (!source.poll(bench_now()) && monotonic_now().ns() - back < 10'000'000'000) std::this_thread::yield();
  r.recover_ms = static_cast<double>(monotonic_now().ns() - back) * 1e-6;
  sender.reset();
  plain.stop();
  r.plain_cpu_us = plain.cpu_us_per_packet();
  (void)source.stop();
  r.ours_p50_us = at_share(ours_us, 0.5), r.ours_p99_us = at_share(ours_us, 0.99);
  r.plain_p50_us = at_share(plain_us, 0.5), r.plain_p99_us = at_share(plain_us, 0.99);
  return r;
}

}  // namespace

int main(int argc, char** argv) {
  const bench::PacketBenchOptions options(argc, argv);
  std::string out = "[";
  std::printf("%10s %9s %9s %9s | %22s | %22s | %17s | %8s\n", "packets/s", "sent", "source", "plain",
              "source p50/p99 us", "plain p50/p99 us", "CPU us/packet", "back ms");
  for (const double rate : {753.5, 7535.0}) {
    const Row r = measure(rate, options.seconds);
    std::printf("%10.1f %9lu %9lu %9lu | %10.1f %11.1f | %10.1f %11.1f | %8.2f %8.2f | %8.1f\n", r.rate,
                r.sent, r.ours, r.plain, r.ours_p50_us, r.ours_p99_us, r.plain_p50_us, r.plain_p99_us,
                r.ours_cpu_us, r.plain_cpu_us, r.recover_ms);
    char text[640];
    std::snprintf(
        text, sizeof text,
        "%s{\"packets_per_s\":%.1f,\"seconds\":%.1f,\"sent\":%lu,\"source\":{\"received\":%lu,\"kernel_"
        "drops\":%lu,\"not_taken\":%lu,\"p50_us\":%."
        "2f,"
        "\"p99_us\":%.2f,\"cpu_us_per_packet\":%.3f,\"recover_ms\":%.2f},\"plain\":{\"received\":%lu,"
        "\"p50_us\":%.2f,\"p99_us\":%.2f,\"cpu_us_per_packet\":%.3f}}",
        out.size() > 1 ? "," : "", r.rate, r.seconds, r.sent, r.ours, r.kernel_drops, r.not_taken,
        r.ours_p50_us, r.ours_p99_us, r.ours_cpu_us, r.recover_ms, r.plain, r.plain_p50_us, r.plain_p99_us,
        r.plain_cpu_us);
    out += text;
  }
  if (!options.json.empty()) std::ofstream(options.json) << out << "]\n";
  return 0;
}
