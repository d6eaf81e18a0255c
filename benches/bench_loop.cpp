// What the executive adds to a bare loop.
//
// A bare loop (clock_nanosleep to the next grid point, read the clock, nothing else), the executive, and the
// executive with spin take turns, block by block, in one process and with the same real-time settings, so
// that whatever the machine does to one it does to all. The executive serves 16 channels: each is a ring that
// a device thread fills at 100 Hz, a and a port. A second part measures what 64 quiet channels cost.
//
//   bench_loop [--seconds 20] [--block 1] [--json FILE]
#include <pthread.h>
#include <sys/resource.h>

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "rt-core/executive.h"
#include "rt-core/port.h"
#include "rt-core/spsc_ring.h"
#ifdef RIGOR_BENCH_WITH_GUARD
#include "rt-core/realtime_guard.h"
#endif

namespace {

using namespace rigor;

constexpr Duration kPeriod = milliseconds(1);
constexpr Duration kSpin = microseconds(100);

struct Sample {
  Stamp stamp;
  double value[16];
};

/// What a channel costs the loop: take what arrived, make visible what is due.
struct Channel {
  Pool<Sample> pool{16};
  SpscRing<Lease<Sample>> ring{16};
  Port<Sample> port;
  std::uint64_t sequence = 0;

  Channel() {
    port.configure({milliseconds(10), milliseconds(5), milliseconds(500), LatePolicy::hold}, BenchTime(0));
  }
  void produce() noexcept {
    if (WritableSlot<Sample> slot = pool.try_acquire()) {
      Stamp& s = slot->stamp;
      s.sequence = sequence++;
      s.t_capture = s.t_arrival = bench_now();
      s.t_release = s.t_capture + microseconds(500);
      (void)ring.try_push(std::move(slot));
    }
  }
  void cycle(const CycleContext& c) noexcept {
    for (Lease<Sample> lease; ring.try_pop(lease);) port.push(std::move(lease));
    port.advance(c.t, true);
  }
};

/// Fills all channels at 100 Hz, as device threads do.
class Producer {
 public:
  explicit Producer(std::vector<std::unique_ptr<Channel>>& channels)
      : thread_([this, &channels] {
          while (!end_.load(std::memory_order_acquire)) {
            for (auto& c : channels) c->produce();
            std::this_thread::sleep_for(std::chrono::milliseconds(10));
          }
        }) {}
  ~Producer() {
    end_.store(true, std::memory_order_release);
    thread_.join();
  }

 private:
  std::atomic<bool> end_{false};
  std::thread thread_;
};

struct Totals {
  Histogram wake, cycle, bookkeeping;
  std::uint64_t run = 0, skipped = 0, expected = 0, overruns = 0, faults = 0, fresh = 0;
  std::uint64_t causes[kMissCauses] = {};
};

/// The bare loop: nothing but the sleep and one look at the clock; late grid points are passed over, as with
/// `skip`.
void bare_block(std::uint64_t cycles, Totals& totals) {
  RealtimeSetup setup;
  RealtimeConfig config;
  config.lock_memory = config.hold_dma_latency = false;  // the process has them already
  setup.prepare_thread(config);
  const std::int64_t period = kPeriod.ns();
  const std::int64_t t0 = bench_now().ns() + 20'000'000;
  for (std::uint64_t k = 0; k < cycles;) {
    const std::int64_t t = t0 + static_cast<std::int64_t>(k) * period;
    const timespec at{t / 1'000'000'000, t % 1'000'000'000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, nullptr);
    const std::int64_t late = bench_now().ns() - t;
    totals.wake.record(Duration(late));
    ++totals.run;
    const auto next = k + 1 + static_cast<std::uint64_t>(std::max<std::int64_t>(0, late) / period);
    totals.skipped += std::min(next, cycles) - (k + 1);
    k = next;
  }
  totals.expected += cycles;
  setup.restore_thread();
}

void executive_block(std::vector<std::unique_ptr<Channel>>& channels, std::uint64_t cycles, Duration spin,
                     Totals& totals) {
  ExecutiveConfig config;
  config.period = kPeriod;
  config.spin = spin;
  config.cycles = cycles;
  config.realtime = RealtimeConfig{};
  config.realtime.lock_memory = config.realtime.hold_dma_latency = false;
  Executive loop(config);
  std::uint64_t fresh = 0;
  // As the bench does it: one step takes what all channels have.
  (void)loop.add_step({.name = "channels"}, [&](const CycleContext& c) noexcept {
    for (auto& channel : channels) {
      channel->cycle(c);
      fresh += channel->port.status() == PortStatus::fresh;
    }
  });
  (void)loop.add_step({.name = "app", .after = {"channels"}}, [](const CycleContext&) noexcept {});
  if (const Status armed = loop.arm(); !armed)
    std::fprintf(stderr, "%s\n", armed.error().text().c_str()), std::exit(1);
  const auto s = loop.run({}, bench_now() + milliseconds(60));
  if (!s) std::fprintf(stderr, "%s\n", s.error().text().c_str()), std::exit(1);
  totals.wake.merge(s->wake_error);
  totals.cycle.merge(s->cycle_time);
  totals.bookkeeping.merge(s->bookkeeping);
  totals.run += s->cycles_run;
  totals.skipped += s->cycles_skipped;
  totals.expected += cycles;
  totals.overruns += s->overruns;
  totals.faults += s->minor_faults + s->major_faults;
  totals.fresh += fresh;
  for (std::size_t i = 0; i < kMissCauses; ++i) totals.causes[i] += s->misses.by_cause[i];
}

double us(Duration d) { return static_cast<double>(d.ns()) * 1e-3; }

void print_row(const char* name, const Totals& t) {
  std::printf("%-22s %9llu %8llu %10.3f %10.3f %10.3f %12.1f %10.3f\n", name,
              static_cast<unsigned long long>(t.run), static_cast<unsigned long long>(t.skipped),
              us(t.wake.percentile(0.5)), us(t.wake.percentile(0.9)), us(t.wake.percentile(0.99)),
              us(t.wake.max()), us(t.cycle.percentile(0.5)));
}

std::string json_row(const char* name, const Totals& t) {
  char text[512];
  std::snprintf(
      text, sizeof text,
      "\"%s\":{\"cycles\":%llu,\"skipped\":%llu,\"expected\":%llu,\"overruns\":%llu,\"page_faults\":%llu,"
      "\"wake_error_us\":{\"p50\":%.3f,\"p90\":%.3f,\"p99\":%.3f,\"max\":%.3f},\"cycle_us\":{\"p50\":%.3f,"
      "\"p99\":%.3f}}",
      name, static_cast<unsigned long long>(t.run), static_cast<unsigned long long>(t.skipped),
      static_cast<unsigned long long>(t.expected), static_cast<unsigned long long>(t.overruns),
      static_cast<unsigned long long>(t.faults), us(t.wake.percentile(0.5)), us(t.wake.percentile(0.9)),
      us(t.wake.percentile(0.99)), us(t.wake.max()), us(t.cycle.percentile(0.5)),
      us(t.cycle.percentile(0.99)));
  return text;
}

}  // namespace

int main(int argc, char** argv) {
  double total_s = 20, block_s = 1;
  std::string json_path;
  for (int i = 1; i < argc; ++i) {
    const std::string option = argv[i];
    const auto value = [&]() -> const char* {
      if (i + 1 < argc) return argv[++i];
      std::fprintf(stderr, "%s needs a value\n", option.c_str());
      std::exit(2);
    };
    if (option == "--seconds") {
      total_s = std::atof(value());
    } else if (option == "--block") {
      block_s = std::atof(value());
    } else if (option == "--json") {
      json_path = value();
    } else {
      std::fprintf(stderr, "usage: %s [--seconds 20] [--block 1] [--json FILE]\n", argv[0]);
      return option == "--help" ? 0 : 2;
    }
  }
  if (!(block_s >= 0.01) || !(total_s >= block_s)) {
    std::fprintf(stderr, "expected --seconds of at least one --block, and that of at least 0.01\n");
    return 2;
  }

  // --seconds is the time of each of the three loops.
  const auto blocks = static_cast<int>(total_s / block_s + 0.5);
  const std::uint64_t cycles = cycles_in(seconds_from(block_s), kPeriod);
  std::vector<std::unique_ptr<Channel>> channels, quiet;
  for (int i = 0; i < 16; ++i) channels.push_back(std::make_unique<Channel>());
  for (int i = 0; i < 64; ++i) quiet.push_back(std::make_unique<Channel>());

  RealtimeSetup process;
  process.prepare_process(RealtimeConfig{});
  {
    RealtimeSetup thread;  // asked for here only to say what the machine grants
    thread.prepare_thread(RealtimeConfig{});
    thread.restore_thread();
    for (const auto* setup : {&process, &thread})
      for (const RealtimeSetting& s : setup->settings())
        std::printf("%-16s %-3s %s\n", s.name.c_str(), s.granted ? "yes" : "no", s.text.c_str());
  }
  Totals bare, sleep_only, spin, idle;
  {
    const Producer producer(channels);
    for (int b = 0; b < blocks; ++b) {
      // The order turns, so that none of them always runs first after a pause.
      for (int i = 0; i < 3; ++i) {
        switch ((b + i) % 3) {
          case 0:
            bare_block(cycles, bare);
            break;
          case 1:
            executive_block(channels, cycles, Duration(0), sleep_only);
            break;
          default:
            executive_block(channels, cycles, kSpin, spin);
            break;
        }
      }
    }
  }
  // The guard makes system calls slower, so it has a part of its own, behind the parts that are timed.
#ifdef RIGOR_BENCH_WITH_GUARD
  const auto guarded_part = [&] {
    const Status guarded = guard::install();
    if (!guarded) std::printf("guard: %s\n", guarded.error().text().c_str());
    Totals ignored;
    const Producer producer(channels);
    for (int b = 0; b < std::max(1, blocks / 6); ++b)
      executive_block(channels, cycles, b % 2 ? kSpin : Duration(0), ignored);
    guard::uninstall();
    return guarded.has_value();
  };
#endif
  const int idle_blocks = std::max(1, blocks / 6);
  for (int b = 0; b < idle_blocks; ++b) executive_block(quiet, cycles, kSpin, idle);

  std::printf("\n1 kHz, blocks of %.2f s in turns, %d of each; wake-up error and cycle time in us\n", block_s,
              blocks);
  std::printf("%-22s %9s %8s %10s %10s %10s %12s %10s\n", "", "cycles", "skipped", "p50", "p90", "p99", "max",
              "cycle p50");
  print_row("bare clock_nanosleep", bare);
  print_row("executive, 16 channels", sleep_only);
  print_row("  with spin 100 us", spin);
  print_row("64 quiet channels", idle);
  std::printf("misses by cause:");
  for (std::size_t i = 0; i < kMissCauses; ++i)
    std::printf(" %s %llu;", to_string(static_cast<MissCause>(i)),
                static_cast<unsigned long long>(sleep_only.causes[i] + spin.causes[i] + idle.causes[i]));
  std::printf("\n\n");

  bool all_met = true;
  std::string checks;
  const auto check = [&](const char* name, double value, double limit) {
    const bool met = value <= limit;
    all_met &= met;
    std::printf("%-52s %10.3f  limit %8.3f  %s\n", name, value, limit, met ? "met" : "NOT MET");
    char text[256];
    std::snprintf(text, sizeof text, "%s{\"name\":\"%s\",\"value\":%.4f,\"limit\":%.4f,\"met\":%s}",
                  checks.empty() ? "" : ",", name, value, limit, met ? "true" : "false");
    checks += text;
  };
  const auto ratio = [](Duration a, Duration b) {
    return static_cast<double>(a.ns()) / static_cast<double>(std::max<std::int64_t>(1, b.ns()));
  };
  check("p50 with spin [us]", us(spin.wake.percentile(0.5)), 1.0);
  check("p50 without spin / bare", ratio(sleep_only.wake.percentile(0.5), bare.wake.percentile(0.5)), 1.1);
  check("p99 without spin / bare", ratio(sleep_only.wake.percentile(0.99), bare.wake.percentile(0.99)), 1.2);
  check("p99 with spin / bare", ratio(spin.wake.percentile(0.99), bare.wake.percentile(0.99)), 1.2);
  check("64 quiet channels, steps and bookkeeping, p50 [us]",
        us(idle.cycle.percentile(0.5) + idle.bookkeeping.percentile(0.5)), 5.0);
  double uncounted = 0;
  for (const Totals* t : {&sleep_only, &spin, &idle})
    uncounted += std::abs(static_cast<double>(t->run + t->skipped) - static_cast<double>(t->expected));
  check("grid points neither run nor counted as skipped", uncounted, 0);
  check("page faults of the loop after arm",
        static_cast<double>(sleep_only.faults + spin.faults + idle.faults), 0);
#ifdef RIGOR_BENCH_WITH_GUARD
  const bool system_calls_seen = guarded_part();
  const guard::Report report = guard::report();
  check("allocations of the loop after arm", static_cast<double>(report.allocations), 0);
  check("locks of the loop after arm", static_cast<double>(report.locks), 0);
  if (system_calls_seen)
    check("blocking system calls of the loop after arm", static_cast<double>(report.system_calls), 0);
  if (!report.clean()) std::printf("%s", report.text().c_str());
#endif

  if (!json_path.empty()) {
    std::ofstream file(json_path);
    file << "{\"bench\":\"bench_loop\",\"period_us\":1000,\"seconds_each\":" << total_s << ",\"rows\":{"
         << json_row("bare", bare) << ',' << json_row("executive", sleep_only) << ','
         << json_row("executive_spin", spin) << ',' << json_row("quiet_64", idle) << "},\"checks\":["
         << checks << "]}\n";
    if (!file.flush()) {
      std::fprintf(stderr, "%s: cannot be written\n", json_path.c_str());
      return 2;
    }
  }
  return all_met ? 0 : 1;
}
