#include "drivers/livox/livox_emulator.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

namespace rigor::livox {
namespace {

/// Later than this, packets are given up instead of sent in a burst.
constexpr Duration kLatest = milliseconds(100);
/// How often a device that does not send looks whether it is to.
constexpr Duration kIdle = milliseconds(20);
constexpr Duration kPushEvery = seconds(1);
constexpr std::int64_t kTaiLessUtc_ns = 37'000'000'000;

void raise(std::atomic<std::uint64_t>& counter) { counter.fetch_add(1, std::memory_order_relaxed); }

/// A socket that listens; `port` becomes the one that it has.
Result<FileDescriptor> listen_at(const std::string& address, std::uint16_t& port) {
  const std::string where = address + ":" + std::to_string(port);
  FileDescriptor fd(socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  sockaddr_in at{};
  at.sin_family = AF_INET;
  at.sin_port = htons(port);
  const int on = 1;
  (void)inet_pton(AF_INET, address.c_str(), &at.sin_addr);
  // Broadcasts reach each device of this machine.
  if (fd && at.sin_addr.s_addr == INADDR_ANY)
    (void)setsockopt(fd.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  if (!fd || setsockopt(fd.get(), SOL_SOCKET, SO_BROADCAST, &on, sizeof on) != 0 ||
      bind(fd.get(), reinterpret_cast<const sockaddr*>(&at), sizeof at) != 0)
    return fail(ErrorCode::unavailable, where,
                std::string("expected to take commands here: ") + std::strerror(errno) +
                    "; `ss -lunp` shows who has a port");
  socklen_t length = sizeof at;
  if (getsockname(fd.get(), reinterpret_cast<sockaddr*>(&at), &length) == 0) port = ntohs(at.sin_port);
  return fd;
}

}  // namespace

LivoxEmulator::~LivoxEmulator() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

std::string LivoxEmulator::endpoint() const {
  return "Livox Mid-360 " + settings_.identity.serial + " at " + settings_.address + ":" +
         std::to_string(command_port_ != 0 ? command_port_ : settings_.identity.command_port);
}

Status LivoxEmulator::do_configure(const ChannelConfig& config) {
  settings_ = read_emulator_settings(config.params);
  description_.kind = SampleKind::point_cloud;
  return {};
}

LidarControl::Active LivoxEmulator::active() {
  const std::lock_guard lock(mutex_);
  return control_->active(monotonic_now());
}

Status LivoxEmulator::do_arm(const ArmContext&) {
  const std::string& name = config().name;
  auto device = Mid360Device::create(parts_.samples);
  if (!device) return fail(device.error().code, name, device.error().text());
  device_.emplace(std::move(*device));
  for (Deadline* d : {&sending_, &serving_})
    if (auto s = d->open(); !s) return s;
  commands_.reset();
  searches_.reset();
  command_port_ = settings_.identity.command_port;
  auto commands = listen_at(settings_.address, command_port_);
  if (!commands) return fail(commands.error().code, name, commands.error().text());
  search_port_ = settings_.search_port;
  if (search_port_ != 0) {
    // Broadcasts reach sockets of any address alone.
    const bool loopback = settings_.identity.ipv4 >> 24 == 127;
    auto searches = listen_at(loopback ? settings_.address : "0.0.0.0", search_port_);
    if (!searches) return fail(searches.error().code, name, searches.error().text());
    searches_ = std::move(*searches);
  }
  commands_ = std::move(*commands);
  if (!settings_.pcap.empty())
    if (auto s = points_.sender.record(settings_.pcap); !s)
      return fail(s.error().code, name, s.error().text());
  LidarControl::Identity identity = settings_.identity;
  identity.command_port = command_port_;
  control_.emplace(identity, settings_.setup, monotonic_now());
  return {};
}

Status LivoxEmulator::do_start(BenchTime t0) {
  scans_.emplace(packet_lidar::ScanAhead::Options{
      [this](std::uint64_t k, BenchTime begin, const WorldMotion& motion, packet_lidar::Scan& out) {
        return device_->measure(k, begin, motion, out);
      },
      [this](std::uint64_t k) { return device_->begin(k); }, device_->scan_time(), device_->make_scan(),
      parts_.motion, &health_.protocol_errors, "livox-scan"});
  if (auto s = scans_->prepare(); !s) return s;
  epoch_ = read_epoch();
  LidarControl::Identity identity = settings_.identity;
  identity.command_port = command_port_;
  control_.emplace(identity, settings_.setup, monotonic_now());
  t_first_ = std::max(t0, bench_now());
  sending_.reset();
  serving_.reset();
  health_.connected = true;
  server_ = std::thread([this] { serve(); });
  sender_ = std::thread([this] { run(); });
  return {};
}

Status LivoxEmulator::do_stop() {
  sending_.cut();
  serving_.cut();
  if (sender_.joinable()) sender_.join();
  if (server_.joinable()) server_.join();
  scans_.reset();
  commands_.reset();
  searches_.reset();
  command_port_ = search_port_ = 0;
  for (Way* w : {&points_, &readings_, &states_}) {
    w->sender.close();
    w->to = {};
    w->told = false;
  }
  health_.connected = false;
  return points_.sender.finish_recording();
}

void LivoxEmulator::serve() {
  pthread_setname_np(pthread_self(), "livox-command");
  MonotonicTime push_at = monotonic_now();
  while (true) {
    const Duration wait = push_at - monotonic_now();
    std::array<pollfd, 3> fds{
        {{serving_.cut_fd(), POLLIN, 0}, {commands_.get(), POLLIN, 0}, {searches_.get(), POLLIN, 0}}};
    (void)poll(fds.data(), fds.size(),
               static_cast<int>(std::clamp<std::int64_t>(wait.ns() / 1'000'000 + 1, 0, 1000)));
    if (fds[0].revents != 0) return;
    if ((fds[1].revents & POLLIN) != 0) answer(commands_.get(), false);
    if ((fds[2].revents & POLLIN) != 0) answer(searches_.get(), true);
    if (monotonic_now() < push_at) continue;
    push_at = monotonic_now() + kPushEvery;
    std::vector<std::uint8_t> bytes;
    HostAddress to;
    {
      const std::lock_guard lock(mutex_);
      bytes = control_->push(monotonic_now());
      to = control_->active(monotonic_now()).setup.state_host;
    }
    send(states_, to, bytes);
  }
}

void LivoxEmulator::answer(int fd, bool searching) {
  std::array<std::uint8_t, kMaxCommandBytes + 1> buffer{};
  // A flood must not keep this thread from its end.
  for (int i = 0; i < 64; ++i) {
    sockaddr_in from{};
    socklen_t length = sizeof from;
    const ssize_t n =
        recvfrom(fd, buffer.data(), buffer.size(), 0, reinterpret_cast<sockaddr*>(&from), &length);
    if (n < 0) return;
    std::vector<std::uint8_t> reply;
    {
      const std::lock_guard lock(mutex_);
      reply = control_->answer(Bytes(buffer).first(static_cast<std::size_t>(n)), searching, monotonic_now());
    }
    if (reply.empty()) {
      raise(health_.protocol_errors);
      continue;
    }
    const auto to = reinterpret_cast<const sockaddr*>(&from);
    if (sendto(fd, reply.data(), reply.size(), 0, to, sizeof from) < 0) raise(health_.retries);
    if (!searching || settings_.identity.ipv4 >> 24 == 127) continue;
    // A host in another network hears it, too.
    from.sin_addr.s_addr = htonl(INADDR_BROADCAST);
    (void)sendto(fd, reply.data(), reply.size(), 0, to, sizeof from);
  }
}

void LivoxEmulator::run() {
  pthread_setname_np(pthread_self(), "livox-send");
  while (true) {
    const LidarControl::Active a = active();
    if (a.state != WorkState::sampling) {
      if (!sending_.wait_until(monotonic_now() + kIdle)) return;
      continue;
    }
    send_points(a);
    scans_->stop();
    if (!sending_.wait_until(monotonic_now())) return;
  }
}

/// Until the device is set anew or this emulator is stopped.
void LivoxEmulator::send_points(const LidarControl::Active& a) {
  const BenchTime t_start = std::max(t_first_, bench_now()) + scans_->measuring_time() * 2 + milliseconds(5);
  DeviceClock clock{settings_.time, static_cast<std::uint64_t>(t_start.ns() - a.switched_on.ns())};
  if (a.gps) {
    clock = {TimeType::gps, clock.start_ns + static_cast<std::uint64_t>(a.gps_less_device_ns)};
  } else if (clock.type == TimeType::ptp) {
    clock.start_ns = static_cast<std::uint64_t>(epoch_.to_utc(t_start).ns() + kTaiLessUtc_ns);
  }
  scans_->start(t_start);
  readings_sent_ = 0;
  std::vector<std::uint8_t> bytes;
  for (std::uint64_t packet = 0;; ++packet) {
    // 50 packets are 24 ms.
    if (packet % 50 == 0) {
      const LidarControl::Active now = active();
      if (now.generation != a.generation || now.state != a.state) return;
    }
    const BenchTime due = t_start + Mid360Device::filled(packet);
    if (!sending_.wait_until(MonotonicTime(due.ns()))) return;
    if (a.setup.imu) send_readings(a, clock, t_start, due);
    bool there = false;
    scans_->use(device_->last_scan_of(packet), [&](const packet_lidar::ScanAhead::Of& of) {
      there = of(device_->last_scan_of(packet)) != nullptr;
      if (there) device_->compose(packet, a.setup.data_type, clock, of, bytes);
    });
    if (!there || bench_now() - due > kLatest) {
      raise(health_.lost);
      continue;
    }
    send(points_, a.setup.point_host, bytes);
    raise(health_.received);
  }
}

void LivoxEmulator::send_readings(const LidarControl::Active& a, const DeviceClock& clock, BenchTime t_start,
                                  BenchTime until) {
  const auto due =
      static_cast<std::uint64_t>(std::max<std::int64_t>(0, (until - t_start).ns() / kImuPeriod_ns));
  for (; readings_sent_ < due; ++readings_sent_) {
    PacketHead head;
    head.udp_count = static_cast<std::uint16_t>(readings_sent_);
    head.time_type = clock.type;
    head.timestamp_ns = clock.start_ns + (readings_sent_ + 1) * static_cast<std::uint64_t>(kImuPeriod_ns);
    send(readings_, a.setup.imu_host, compose_imu(head, at_rest()));
  }
}

void LivoxEmulator::send(Way& way, const HostAddress& to, Bytes bytes) {
  if (to.port == 0 || to.ipv4 == 0) return;
  if (way.to != to || !way.sender.is_open()) {
    if (way.to == to && way.told) return;
    way.to = to;
    // Nowhere to send to is no reason to stop: the next host may know better.
    const std::uint16_t from = settings_.lidar_ports ? to.lidar_port : 0;
    way.told = !way.sender.open(network::text_of_ipv4(to.ipv4), to.port, settings_.address, from);
    if (way.told) {
      raise(health_.retries);
      return;
    }
  }
  switch (way.sender.send(bytes, to.port, epoch_.to_utc(bench_now()))) {
    case network::UdpSender::Outcome::sent:
      if (&way == &points_) health_.connected.store(true, std::memory_order_relaxed);
      break;
    case network::UdpSender::Outcome::nobody:
      // What nobody takes of its state or its unit says nothing of its points.
      if (&way == &points_) health_.connected.store(false, std::memory_order_relaxed);
      break;
    case network::UdpSender::Outcome::failed:
      raise(health_.retries);
  }
}

}  // namespace rigor::livox
