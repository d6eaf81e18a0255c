#include "drivers/usb/scip_emulator.h"

#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>

#include "drivers/usb/device_ends.h"

namespace rigor::usb {

ScipEmulator::~ScipEmulator() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

std::string ScipEmulator::endpoint() const {
  return scanner_.model.identity.product + " " + config().name + " at " +
         (end_ ? end_->endpoint() : "(not armed)");
}

Status ScipEmulator::do_configure(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  (void)n.choice_or("protocol", {"scip"}, "scip");
  scanner_ = read_emulated_scanner(n);
  const std::string as = n.choice_or("as", {"pty", "tcp", "gadget"}, "pty");
  if (as == "pty") {
    make_end_ = [link = n.text_or("link", "")] { return make_pty_end(link); };
  } else if (as == "tcp") {
    make_end_ = [address = n.text_or("address", "127.0.0.1"),
                 port = static_cast<std::uint16_t>(n.integer_or("port", 10940, {.min = 0, .max = 65535}))] {
      return make_tcp_end(address, port);
    };
    idle_limit_ = seconds_from(n.number_or("idle_limit_s", 60, {.min = 0, .max = 1e6}));
  } else {
    GadgetSettings g;
    g.name = "rigor." + config.name;
    std::replace(g.name.begin(), g.name.end(), '/', '.');
    g.vendor = static_cast<std::uint16_t>(n.integer_or("vendor", g.vendor, {.min = 0, .max = 65535}));
    g.product = static_cast<std::uint16_t>(n.integer_or("product", g.product, {.min = 0, .max = 65535}));
    g.udc = n.text_or("udc", "");
    make_end_ = [g] { return make_gadget_end(g); };
  }
  description_.kind = SampleKind::point_cloud;
  description_.frame_id = config.name;
  return {};
}

Status ScipEmulator::do_arm(const ArmContext&) {
  if (!measure_ && (!parts_.samples || parts_.samples->geometry().kind != SampleKind::point_cloud))
    return fail(ErrorCode::bad_input, config().params.place(),
                config().name +
                    ": expected something that scans: give this emulator a LiDAR's sensor model as `sensor`");
  if (auto s = deadline_.open(); !s) return s;
  auto end = make_end_();
  if (auto s = end->open(); !s) return fail(s.error().code, config().name, s.error().text());
  end_ = std::move(end);
  return {};
}

Status ScipEmulator::do_start(BenchTime) {
  deadline_.reset();
  thread_ = std::thread([this] { run(); });
  return {};
}

Status ScipEmulator::do_stop() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  end_.reset();
  set_connected(false);
  return {};
}

void ScipEmulator::run() {
  const MonotonicTime power_on = monotonic_now();
  WorldScans world(parts_, scanner_.model, BenchTime(power_on.ns()));
  ScipDevice device(
      scanner_.model,
      measure_ ? measure_
               : [&](std::uint64_t scan, DeviceTime t, std::span<std::uint32_t> range,
                     std::span<std::uint32_t> intensity) { return world.measure(scan, t, range, intensity); },
      scanner_.options);
  const auto device_now = [&] { return DeviceTime((monotonic_now() - power_on).ns()); };
  const auto publish = [&] {
    const auto& c = device.counters();
    counters_.scans_sent.store(c.scans_sent, std::memory_order_relaxed);
    counters_.scans_dropped.store(c.scans_dropped, std::memory_order_relaxed);
    counters_.scans_missing.store(c.scans_missing, std::memory_order_relaxed);
    counters_.commands.store(c.commands, std::memory_order_relaxed);
  };
  bool had_host = false;
  std::uint64_t asked = 0;  // commands when something was last asked for
  MonotonicTime last_asked;
  char buffer[4096];
  while (true) {
    const int fd = end_->fd();
    if (fd < 0) {
      if (had_host) device.host_gone();
      had_host = false;
      set_connected(false);
      pollfd cut{deadline_.cut_fd(), POLLIN, 0};
      if (::poll(&cut, 1, 0) == 1) break;
      end_->await(deadline_.cut_fd(), milliseconds(200));
      continue;
    }
    if (!had_host) {
      had_host = true;
      last_asked = monotonic_now();
      counters_.hosts.fetch_add(1, std::memory_order_relaxed);
      set_connected(true);
    }
    device.advance(device_now());
    std::string& out = device.output();
    bool gone = false;
    while (!out.empty()) {
      const ssize_t n = put_bytes(fd, out.data(), std::min<std::size_t>(out.size(), 16384));
      if (n > 0) {
        out.erase(0, static_cast<std::size_t>(n));
        continue;
      }
      if (n < 0 && errno == EINTR) continue;
      if (n < 0 && errno != EAGAIN && errno != EWOULDBLOCK) gone = true;
      break;
    }
    publish();
    const auto& c = device.counters();
    if (device.measuring() || c.commands + c.refused != asked) {
      asked = c.commands + c.refused;
      last_asked = monotonic_now();
    }
    // There is one place: whoever never comes to the end of a command does not keep it.
    if (idle_limit_.ns() > 0 && monotonic_now() - last_asked >= idle_limit_) gone = true;
    // The next scan, or a look at whether the host is still there.
    const DeviceTime next = std::min(device.next_event(), device_now() + milliseconds(100));
    const std::int64_t wait = std::clamp<std::int64_t>((next - device_now()).ns(), 0, milliseconds(100).ns());
    pollfd p[2] = {{fd, static_cast<short>(out.empty() ? POLLIN : POLLIN | POLLOUT), 0},
                   {deadline_.cut_fd(), POLLIN, 0}};
    const timespec t{0, static_cast<long>(wait)};
    if (!gone && ::ppoll(p, 2, &t, nullptr) < 0 && errno != EINTR) gone = true;
    if (p[1].revents != 0) break;
    if (!gone && (p[0].revents & (POLLIN | POLLHUP | POLLERR)) != 0) {
      const ssize_t n = ::read(fd, buffer, sizeof buffer);
      if (n > 0) {
        device.receive({buffer, static_cast<std::size_t>(n)}, device_now());
      } else if (n == 0 || (errno != EAGAIN && errno != EINTR && errno != EWOULDBLOCK)) {
        gone = true;
      }
    }
    if (gone) {
      device.host_gone();
      had_host = false;
      set_connected(false);
      end_->lost();
      pollfd cut{deadline_.cut_fd(), POLLIN, 0};
      const timespec pause{0, 5'000'000};
      if (::ppoll(&cut, 1, &pause, nullptr) == 1) break;
    }
  }
  publish();
}

}  // namespace rigor::usb
