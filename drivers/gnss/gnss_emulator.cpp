#include "drivers/gnss/gnss_emulator.h"

#include <poll.h>
#include <pthread.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>

#include "rt-core/epoch.h"

namespace rigor::gnss {
namespace {

/// More than a second of a receiver at its fastest: a host that reads nothing loses whole instants.
constexpr std::size_t kMostWaiting = 64 * 1024;

/// What a line that is set to another speed makes of the bytes: none of them is right.
void garble(Buffer& bytes) {
  for (std::uint8_t& b : bytes) b = static_cast<std::uint8_t>((b << 3 | b >> 5) ^ 0xD8);
}

}  // namespace

GnssEmulator::~GnssEmulator() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

std::string GnssEmulator::endpoint() const {
  return "satellite receiver " + config().name + " at " + (end_ ? end_->endpoint() : "(not armed)");
}

Status GnssEmulator::do_configure(const ChannelConfig& config) {
  settings_ = read_emulator_settings(config.params);
  if (auto s = MeasuredFix::check(parts_, config.params.place()); !s) return s;
  description_.kind = SampleKind::nav_fix;
  description_.frame_id = config.name;
  return {};
}

Status GnssEmulator::do_arm(const ArmContext&) {
  if (auto s = deadline_.open(); !s) return s;
  auto end = settings_.as == EmulatorSettings::As::pty
                 ? serial::make_pty_end(settings_.link)
                 : serial::make_tcp_end(settings_.address, settings_.port);
  if (auto s = end->open(); !s) return fail(s.error().code, config().name, s.error().text());
  end_ = std::move(end);
  return {};
}

Status GnssEmulator::do_start(BenchTime t0) {
  deadline_.reset();
  thread_ = std::thread([this, t0] { run(t0); });
  return {};
}

Status GnssEmulator::do_stop() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  end_.reset();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

void GnssEmulator::run(BenchTime t0) {
  pthread_setname_np(pthread_self(), "gnss-emulator");
  ReceiverDevice device(settings_);
  MeasuredFix measured(parts_, config().name, config().seed, settings_.velocity_sigma_mps);
  Buffer waiting;
  std::uint64_t index = 0;
  bool had_host = false;
  const EpochPair epoch = read_epoch();
  Duration period = device.period();
  // The next whole period of UTC, as this machine's clock had it when the receiver was switched on.
  const auto next_after = [&](RealtimeTime utc) {
    return RealtimeTime((utc.ns() / period.ns() + 1) * period.ns());
  };
  RealtimeTime next = next_after(epoch.to_utc(bench_now()));
  std::array<std::uint8_t, 4096> buffer;
  const auto publish = [&] {
    const auto c = device.counters();
    counters_.requests.store(c.requests, std::memory_order_relaxed);
    counters_.refused.store(c.refused, std::memory_order_relaxed);
    counters_.rtcm.store(c.rtcm, std::memory_order_relaxed);
    counters_.malformed.store(c.malformed, std::memory_order_relaxed);
  };
  while (true) {
    const BenchTime due = epoch.to_bench(next) + settings_.processing;
    int fd = end_->fd();
    if (fd < 0 && had_host) waiting.clear(), end_->lost();
    if (fd >= 0 && !had_host) counters_.hosts.fetch_add(1, std::memory_order_relaxed);
    had_host = fd >= 0;
    health_.connected.store(had_host, std::memory_order_release);
    if (bench_now() >= due) {
      const BenchTime t = epoch.to_bench(next);
      device.speak(measured.at(index, t, t0), next, index, t);
      ++index;
      next = next + period;
      if (bench_now() - t > seconds(5)) next = next_after(epoch.to_utc(bench_now()));  // it was stopped
    }
    if (Buffer& out = device.output(); !out.empty()) {
      const unsigned baud = had_host ? end_->client_baud() : 0;
      if (baud != 0 && baud != device.baud()) garble(out);
      if (had_host && waiting.size() + out.size() <= kMostWaiting) {
        waiting.insert(waiting.end(), out.begin(), out.end());
        health_.received.fetch_add(1, std::memory_order_relaxed);
      } else if (had_host) {
        health_.lost.fetch_add(1, std::memory_order_relaxed);
      }
      out.clear();
      if (device.period() != period) {
        period = device.period();
        next = next_after(epoch.to_utc(bench_now()));
      }
    }
    bool gone = false;
    while (had_host && !waiting.empty()) {
      const ssize_t n = serial::put_bytes(fd, reinterpret_cast<const char*>(waiting.data()), waiting.size());
      if (n > 0) {
        waiting.erase(waiting.begin(), waiting.begin() + n);
        continue;
      }
      if (n < 0 && errno == EINTR) continue;
      gone = n < 0 && errno != EAGAIN && errno != EWOULDBLOCK;
      break;
    }
    const std::int64_t left = (epoch.to_bench(next) + settings_.processing - bench_now()).ns();
    const Duration wait(std::clamp<std::int64_t>(left, 0, had_host ? 50'000'000 : 5'000'000));
    if (!had_host) {
      end_->await(deadline_.cut_fd(), wait);
      pollfd cut{deadline_.cut_fd(), POLLIN, 0};
      if (::poll(&cut, 1, 0) == 1) break;
      continue;
    }
    pollfd p[2] = {{fd, static_cast<short>(waiting.empty() ? POLLIN : POLLIN | POLLOUT), 0},
                   {deadline_.cut_fd(), POLLIN, 0}};
    const timespec t{0, static_cast<long>(wait.ns())};
    if (!gone && ::ppoll(p, 2, &t, nullptr) < 0 && errno != EINTR) gone = true;
    if (p[1].revents != 0) break;
    if (!gone && (p[0].revents & (POLLIN | POLLHUP | POLLERR)) != 0) {
      const ssize_t n = ::read(fd, buffer.data(), buffer.size());
      const unsigned baud = end_->client_baud();
      if (n > 0 && (baud == 0 || baud == device.baud())) {
        device.receive({buffer.data(), static_cast<std::size_t>(n)}, bench_now());
        publish();
      }
      if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR && errno != EWOULDBLOCK)) gone = true;
    }
    if (gone) {
      waiting.clear();
      end_->lost();
    }
  }
  publish();
}

}  // namespace rigor::gnss
