// The channel over a pseudo-terminal and over TCP, against the emulated scanner.
#include "drivers/usb/scip_source.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <poll.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <fstream>
#include <thread>

#include "tests/drivers/usb/usb_test_tools.h"
#include "tests/paths.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::usb {
namespace {

using testing::formula_scan;
using ::testing::HasSubstr;
using testing::RunningEmulator;
using testing::scanner_config;

BenchTime now() { return bench_now(); }

/// Polls until `until` or a generous limit.
template <class See>
void poll_until(Source& source, Duration limit, See&& see, const std::function<bool()>& until) {
  const BenchTime end = now() + limit;
  while (now() < end && !until()) {
    while (SampleLease lease = source.poll(now())) see(*lease);
    usleep(1000);
  }
}

struct Started {
  explicit Started(const std::string& params, Duration period = milliseconds(25)) : source(make_plain_link) {
    Status s = source.configure(scanner_config(params, period));
    if (s) s = source.arm({});
    if (s) s = source.start(now());
    if (!s) problem = s.error().text();
  }
  ScipSource source;
  std::string problem;
};

class Transports : public ::testing::TestWithParam<const char*> {};

TEST_P(Transports, EveryScanComesWholeAndAtItsTime) {
  RunningEmulator e(GetParam());
  ASSERT_EQ(e.problem, "");
  const bool tcp = e.emulator.where()[0] != '/';
  const std::string params = tcp ? "{transport: tcp, address: 127.0.0.1, intensity: true, port: " +
                                       e.emulator.where().substr(e.emulator.where().find(':') + 1) + "}"
                                 : e.tty_with("intensity: true, slots: 64");
  Started s(params);
  ASSERT_EQ(s.problem, "");
  EXPECT_EQ(s.source.parameters().model, utm_30lx().parameters.model);
  std::int64_t last = -1;
  std::uint64_t n = 0, gaps = 0, sequence = 0;
  poll_until(
      s.source, seconds(20),
      [&](const Sample& sample) {
        const std::int64_t scan = formula_scan(sample, utm_30lx());
        ASSERT_GE(scan, 0) << "points of different scans in one sample";
        EXPECT_EQ(sample.as<PointCloudInfo>()->count, 1081u);
        LidarPoint p;
        std::memcpy(&p, sample.bytes().data(), sizeof p);
        EXPECT_EQ(p.remission, 1000.0F);
        if (n++ > 0) {
          gaps += static_cast<std::uint64_t>((scan - last + 1000) % 1000) - 1;
          EXPECT_EQ(static_cast<std::uint64_t>((scan - last + 1000) % 1000),
                    (sample.stamp.sequence - sequence) % 1000);
        }
        last = scan;
        sequence = sample.stamp.sequence;
        EXPECT_EQ(sample.stamp.validity, kValid);
        EXPECT_GT(sample.stamp.sigma_capture, Duration(0));
        EXPECT_LT(sample.stamp.t_capture, sample.stamp.t_arrival);
      },
      [&] { return n >= 40; });
  EXPECT_GE(n, 40u);
  ASSERT_TRUE(s.source.stop());
  EXPECT_EQ(gaps, s.source.health().lost + s.source.health().ring_full + s.source.health().no_slot);
  EXPECT_EQ(s.source.health().protocol_errors, 0u);
}
INSTANTIATE_TEST_SUITE_P(Scip, Transports,
                         ::testing::Values("{as: pty, model: utm-30lx}",
                                           "{as: tcp, port: 0, model: utm-30lx}"),
                         [](const auto& c) { return c.index == 0 ? "pty" : "tcp"; });

TEST(ScipSource, TheScannerIsBackAfterItWasGoneAndWhatIsMissingIsCounted) {
  test::TemporaryDirectory folder;
  const std::string link = folder.file("scanner");
  const std::string emulator = "{as: pty, model: utm-30lx, link: " + link + "}";
  auto e = std::make_unique<RunningEmulator>(emulator);
  ASSERT_EQ(e->problem, "");
  Started s("{transport: tty, device: " + link + ", slots: 64}");
  ASSERT_EQ(s.problem, "");
  std::uint64_t n = 0, first_sequence = 0, last_sequence = 0, missing = 0;
  const auto see = [&](const Sample& sample) {
    if (n == 0) first_sequence = sample.stamp.sequence;
    missing += sample.stamp.lost_before;
    last_sequence = sample.stamp.sequence;
    ++n;
  };
  poll_until(s.source, seconds(20), see, [&] { return n >= 5; });
  e.reset();  // in the middle of a scan, mostly
  poll_until(s.source, seconds(20), see, [&] { return !s.source.health().connected; });
  EXPECT_FALSE(s.source.health().connected);
  const std::uint64_t before = n;
  e = std::make_unique<RunningEmulator>(emulator);
  ASSERT_EQ(e->problem, "");
  poll_until(s.source, seconds(30), see, [&] { return n >= before + 5; });
  EXPECT_GE(n, before + 5);
  EXPECT_TRUE(s.source.health().connected);
  EXPECT_GE(s.source.health().reconnects, 1u);
  ASSERT_TRUE(s.source.stop());
  EXPECT_EQ(last_sequence - first_sequence + 1, n + missing) << "every instant is a sample or a loss";
  EXPECT_GT(missing, 0u);
}

TEST(ScipSource, SaysWhatIsWrongAtArm) {
  RunningEmulator e("{as: pty, model: urg-04lx, serial: H1234567}", urg_04lx());
  ASSERT_EQ(e.problem, "");
  const auto problem = [&](const std::string& params, Duration period = milliseconds(100)) {
    return Started(params, period).problem;
  };
  EXPECT_THAT(problem(e.tty_with("start_step: 10")),
              HasSubstr("start_step: expected a step of the scanner's"));
  EXPECT_THAT(problem(e.tty_with("end_step: 726")), HasSubstr("44 … 725"));
  EXPECT_THAT(problem(e.tty_with("characters: 2")), HasSubstr("4095"));
  EXPECT_THAT(problem(e.tty_with("serial: H7")), HasSubstr("found H1234567"));
  EXPECT_THAT(problem(e.tty(), milliseconds(25)), HasSubstr("rate_hz: expected 10"));
  EXPECT_THAT(problem("{transport: tty, device: /dev/no-such-scanner}"), HasSubstr("rigor devices"));
  EXPECT_THAT(problem("{transport: tty, device: /dev/null}"), HasSubstr("expected a terminal"));
  EXPECT_THAT(problem("{transport: tcp, address: 127.0.0.1, port: 1}"),
              HasSubstr("that listens here, got: Connection refused"));
  EXPECT_THAT(problem(e.tty_with("cluster: 100")), HasSubstr("test.yaml:1:"));
  EXPECT_EQ(problem(e.tty_with("start_step: 100, end_step: 600, cluster: 4, skip: 1"), milliseconds(200)),
            "");
}

TEST(ScipSource, GarbageBetweenScansCostsNoMoreThanItHits) {
  // A scanner behind a bad cable: bytes are changed on the way, by a relay between two terminals.
  RunningEmulator e("{as: tcp, port: 0, model: utm-30lx}");
  ASSERT_EQ(e.problem, "");
  const auto port =
      static_cast<std::uint16_t>(std::stoi(e.emulator.where().substr(e.emulator.where().find(':') + 1)));
  auto wire = serial::make_tcp_link("127.0.0.1", port);
  ASSERT_TRUE(wire->open());
  const int master = ::posix_openpt(O_RDWR | O_NOCTTY);
  ASSERT_GE(master, 0);
  ::grantpt(master);
  ::unlockpt(master);
  const std::string slave = ::ptsname(master);
  const int held = ::open(slave.c_str(), O_RDWR | O_NOCTTY);
  std::atomic<bool> end{false};
  std::atomic<int> spoilt{0};
  std::thread relay([&] {
    char buffer[4096];
    std::uint64_t bytes = 0;
    bool spoil = false;
    while (!end) {
      pollfd p{master, POLLIN, 0};
      if (::poll(&p, 1, 0) == 1) {
        const ssize_t n = ::read(master, buffer, sizeof buffer);
        if (n > 0 && !wire->send({buffer, static_cast<std::size_t>(n)})) return;
        if (n > 0 && std::string_view(buffer, static_cast<std::size_t>(n)).starts_with("M")) spoil = true;
      }
      const auto r = wire->receive(buffer, monotonic_now() + milliseconds(1));
      if (r.state == ByteLink::State::gone) return;
      for (std::size_t i = 0; i < r.bytes; ++i)
        if (spoil && ++bytes % 20011 == 0) buffer[i] = static_cast<char>(buffer[i] ^ 0x15), ++spoilt;
      for (std::size_t at = 0; at < r.bytes;) {
        const ssize_t n = ::write(master, buffer + at, r.bytes - at);
        if (n <= 0) return;
        at += static_cast<std::size_t>(n);
      }
    }
  });
  {
    Started s("{transport: tty, slots: 64, device: " + slave + "}");
    ASSERT_EQ(s.problem, "");
    std::uint64_t n = 0, wrong = 0, first = 0, last = 0, missing = 0;
    poll_until(
        s.source, seconds(30),
        [&](const Sample& sample) {
          wrong += formula_scan(sample, utm_30lx()) < 0;
          if (n++ == 0) first = sample.stamp.sequence;
          last = sample.stamp.sequence;
          missing += sample.stamp.lost_before;
        },
        [&] { return n >= 60 && spoilt > 3; });
    ASSERT_TRUE(s.source.stop());
    EXPECT_EQ(wrong, 0u);
    EXPECT_GE(n, 60u);
    EXPECT_GT(missing, 0u);
    EXPECT_LE(missing, 2u * static_cast<unsigned>(spoilt.load()) + 2);
    EXPECT_EQ(last - first + 1, n + missing);
    EXPECT_GT(s.source.health().protocol_errors, 0u);
  }
  end = true;
  relay.join();
  ::close(held);
  ::close(master);
}

// Somebody else's view of the protocol: a reader in Python, from the specification alone.
TEST(ScipEmulator, AnIndependentReaderGetsScans) {
  if (std::system("command -v python3 >/dev/null") != 0) GTEST_SKIP() << "python3 is not installed";
  RunningEmulator e("{as: pty, model: urg-04lx}", urg_04lx());
  ASSERT_EQ(e.problem, "");
  const std::string command = "python3 " + rigor::test::source_dir() + "/tests/drivers/usb/scip_reader.py " +
                              e.emulator.where() + " 3";
  EXPECT_EQ(std::system(command.c_str()), 0) << command;
}

TEST(ScipEmulator, SurvivesHostileHosts) {
  RunningEmulator e("{as: tcp, port: 0, model: utm-30lx}");
  ASSERT_EQ(e.problem, "");
  const auto port =
      static_cast<std::uint16_t>(std::stoi(e.emulator.where().substr(e.emulator.where().find(':') + 1)));
  {
    auto greedy = serial::make_tcp_link("127.0.0.1", port);  // asks for everything and reads nothing
    ASSERT_TRUE(greedy->open());
    ASSERT_TRUE(greedy->send("ME0000108000000\n"));
    std::string noise(100000, 'x');
    for (std::size_t i = 0; i < noise.size(); i += 7) noise[i] = static_cast<char>(i);
    for (int i = 0; i < 20; ++i) (void)greedy->send(noise);
    for (int i = 0; i < 2000; ++i)
      if (!greedy->send("PP\n")) break;
    usleep(100000);
  }
  Started s("{transport: tcp, address: 127.0.0.1, port: " + std::to_string(port) + "}");
  ASSERT_EQ(s.problem, "");
  std::uint64_t n = 0;
  poll_until(
      s.source, seconds(20), [&](const Sample&) { ++n; }, [&] { return n >= 3; });
  EXPECT_GE(n, 3u);
}

/// There is one place: a client that never comes to the end of a command lets the next one wait for good.
TEST(ScipEmulator, AClientWithoutAWholeCommandGivesItsPlaceToTheNext) {
  RunningEmulator e("{as: tcp, port: 0, model: utm-30lx, idle_limit_s: 0.1}");
  ASSERT_EQ(e.problem, "");
  const auto port =
      static_cast<std::uint16_t>(std::stoi(e.emulator.where().substr(e.emulator.where().find(':') + 1)));
  auto trickle = serial::make_tcp_link("127.0.0.1", port);
  ASSERT_TRUE(trickle->open());
  std::atomic<bool> stop{false};
  std::thread trickling([&] {
    while (!stop.load() && trickle->send("x")) usleep(5000);
  });
  Started s("{transport: tcp, address: 127.0.0.1, port: " + std::to_string(port) + "}");
  EXPECT_EQ(s.problem, "");
  stop = true;
  trickling.join();
}

TEST(ScipVirtual, MeasuresOnTheBenchsGridAndRepeats) {
  std::vector<std::vector<std::byte>> runs;
  for (int run = 0; run < 2; ++run) {
    DeviceParts parts;
    parts.samples = std::make_shared<testing::FormulaScans>(urg_04lx());
    const auto node = ConfigDocument::parse("{model: urg-04lx, clock_ppm: 30}", "rig");
    ScipVirtualSource source(parts, *node);
    ASSERT_TRUE(source.configure(scanner_config("{}", milliseconds(100), milliseconds(75))));
    ArmContext context;
    context.virtual_time = true;
    const auto armed = source.arm(context);
    ASSERT_TRUE(armed) << armed.error().text();
    ASSERT_TRUE(source.start(BenchTime(0)));
    std::vector<std::byte> bytes;
    std::int64_t n = 0;
    for (BenchTime t; t < BenchTime(0) + seconds(5); t = t + milliseconds(1)) {
      source.complete_until(t);
      while (SampleLease lease = source.poll(t)) {
        EXPECT_EQ(formula_scan(*lease, urg_04lx()), n % 1000);
        EXPECT_EQ(lease->stamp.sequence, static_cast<std::uint64_t>(n));
        const Duration off = lease->stamp.t_capture - (BenchTime(0) + milliseconds(100) * n);
        EXPECT_LT(std::abs(off.seconds()), 1e-3);
        EXPECT_LT(std::abs(static_cast<double>(off.ns())),
                  4.0 * static_cast<double>(lease->stamp.sigma_capture.ns()));
        bytes.insert(bytes.end(), lease->bytes().begin(), lease->bytes().end());
        const auto* stamp = reinterpret_cast<const std::byte*>(&lease->stamp.t_capture);
        bytes.insert(bytes.end(), stamp, stamp + sizeof lease->stamp.t_capture);
        ++n;
      }
    }
    EXPECT_EQ(n, 50);
    EXPECT_EQ(source.health().lost, 0u);
    ASSERT_TRUE(source.stop());
    runs.push_back(std::move(bytes));
  }
  EXPECT_EQ(runs[0], runs[1]);
}

}  // namespace
}  // namespace rigor::usb
