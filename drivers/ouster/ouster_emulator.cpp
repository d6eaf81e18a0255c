#include "drivers/ouster/ouster_emulator.h"

#include <pthread.h>

#include <algorithm>

namespace rigor::ouster {
namespace {

/// Later than this, packets are given up instead of sent in a burst.
constexpr Duration kLatest = milliseconds(100);
/// How often a sensor that does not send looks whether it is to.
constexpr Duration kIdle = milliseconds(20);

void raise(std::atomic<std::uint64_t>& counter) { counter.fetch_add(1, std::memory_order_relaxed); }

}  // namespace

OusterEmulator::~OusterEmulator() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

std::string OusterEmulator::endpoint() const {
  return settings_.product + " at http://" + settings_.address + ":" +
         std::to_string(http_port_ != 0 ? http_port_ : settings_.http_port);
}

Status OusterEmulator::do_configure(const ChannelConfig& config) {
  settings_ = read_emulator_settings(config.params);
  description_.kind = SampleKind::point_cloud;
  return {};
}

SensorControl::Active OusterEmulator::active() {
  const std::lock_guard lock(mutex_);
  return control_->active();
}

Status OusterEmulator::listen() {
  auto http =
      server_.listen(settings_.address, settings_.http_port, {},
                     network::http_server([this](const network::HttpRequest& r, std::string_view client) {
                       const std::lock_guard lock(mutex_);
                       const auto reply = control_->http(r.method, r.target, r.body, client, monotonic_now());
                       return network::HttpReply{reply.status, reply.body};
                     }));
  if (!http) return tl::unexpected<Error>(http.error());
  http_port_ = *http;
  if (settings_.tcp_port != 0) {
    auto tcp =
        server_.listen(settings_.address, settings_.tcp_port, {}, [this](network::TcpServer::Client& c) {
          for (std::size_t end = c.in.find('\n'); end != std::string::npos; end = c.in.find('\n')) {
            const std::lock_guard lock(mutex_);
            c.out += control_->tcp(std::string_view(c.in).substr(0, end), c.address, monotonic_now()) + "\n";
            c.in.erase(0, end + 1);
          }
        });
    if (!tcp) return tl::unexpected<Error>(tcp.error());
  }
  return {};
}

Status OusterEmulator::do_arm(const ArmContext&) {
  const std::string& name = config().name;
  auto device = SensorDevice::create(parts_.samples);
  if (!device) return fail(device.error().code, name, device.error().text());
  device_.emplace(std::move(*device));
  auto control = SensorControl::create(
      *device_, {settings_.product, settings_.serial, settings_.firmware, settings_.start_up},
      settings_.config, monotonic_now());
  if (!control) return fail(control.error().code, name, control.error().text());
  control_.emplace(std::move(*control));
  if (auto s = sending_.open(); !s) return s;
  const SensorControl::Active a = control_->active();
  Status s = sender_.open(a.udp_dest, a.metadata.lidar_port);
  sender_dest_ = a.udp_dest;
  if (s && !settings_.pcap.empty()) s = sender_.record(settings_.pcap);
  if (s) s = listen();
  if (!s) {
    sender_.close();
    server_.stop();
    return fail(s.error().code, name, s.error().text());
  }
  return {};
}

Status OusterEmulator::do_start(BenchTime t0) {
  scans_.emplace(packet_lidar::ScanAhead::Options{
      [this](std::uint64_t k, BenchTime begin, const WorldMotion& motion, packet_lidar::Scan& out) {
        return device_->measure(k, begin, motion, out);
      },
      [this](std::uint64_t k) { return device_->begin(k); }, device_->frame_time(), device_->make_scan(),
      parts_.motion, &health_.protocol_errors, "ouster-scan"});
  if (auto s = scans_->prepare(); !s) return s;
  epoch_ = read_epoch();
  t_on_ = bench_now();
  t_first_ = std::max(t0, t_on_);
  imu_sent_ = 0;
  sending_.reset();
  if (auto s = server_.start(); !s) return s;
  health_.connected = true;
  thread_ = std::thread([this] { run(); });
  return {};
}

Status OusterEmulator::do_stop() {
  sending_.cut();
  if (thread_.joinable()) thread_.join();
  server_.stop();
  http_port_ = 0;
  scans_.reset();
  sender_.close();
  health_.connected = false;
  return sender_.finish_recording();
}

void OusterEmulator::set_out(const SensorControl::Active& a, BenchTime earliest) {
  const RealtimeTime first = a.time.first_frame(
      epoch_.to_utc(earliest + scans_->measuring_time() * 2 + milliseconds(5)), device_->frame_time());
  t_start_ = epoch_.to_bench(first);
  start_ns_ = a.time.count_at(first, epoch_.to_utc(t_on_));
}

void OusterEmulator::run() {
  pthread_setname_np(pthread_self(), "ouster-send");
  while (true) {
    const SensorControl::Active a = active();
    if (a.standby || monotonic_now() < a.ready) {
      if (!sending_.wait_until(monotonic_now() + kIdle)) return;
      continue;
    }
    if (a.udp_dest != sender_dest_ || !sender_.is_open()) {
      sender_dest_ = a.udp_dest;
      // Nowhere to send to is no reason to stop: the next configuration may know better.
      if (!sender_.open(a.udp_dest, a.metadata.lidar_port)) raise(health_.retries);
    }
    set_out(a, std::max(t_first_, bench_now()));
    scans_->start(t_start_);
    send_frames(a);
    scans_->stop();
    if (!sending_.wait_until(monotonic_now())) return;
  }
}

/// Until the sensor is configured anew or this emulator is stopped.
void OusterEmulator::send_frames(const SensorControl::Active& a) {
  const Metadata& m = a.metadata;
  LidarPacketWriter packet(layout_of(m));
  for (std::uint64_t frame = 0;; ++frame) {
    {
      const std::lock_guard lock(mutex_);
      if (control_->active().generation != a.generation) return;
    }
    for (std::uint32_t slot = 0; slot < m.slots(); ++slot) {
      bool wanted = false;
      for (std::uint32_t c = 0; c < m.columns_per_packet; ++c)
        wanted = wanted || m.window.has(slot * m.columns_per_packet + c);
      const BenchTime due = t_start_ + device_->filled(frame, slot, m);
      if (!sending_.wait_until(MonotonicTime(due.ns()))) return;
      if (m.imu_port != 0) send_imu(m.imu_port, due);
      if (!wanted || m.lidar_port == 0) continue;
      bool there = false;
      scans_->use(frame, [&](const packet_lidar::ScanAhead::Of& of) {
        const packet_lidar::Scan* scan = of(frame);
        there = scan != nullptr;
        if (there) device_->compose(frame, slot, scan, m, start_ns_, packet);
      });
      if (!there || bench_now() - due > kLatest) {
        raise(health_.lost);
        continue;
      }
      send(packet.bytes(), m.lidar_port);
      raise(health_.received);
    }
  }
}

void OusterEmulator::send(Bytes bytes, std::uint16_t port) {
  if (!sender_.is_open()) return;
  switch (sender_.send(bytes, port, epoch_.to_utc(bench_now()))) {
    case network::UdpSender::Outcome::sent:
      health_.connected.store(true, std::memory_order_relaxed);
      break;
    case network::UdpSender::Outcome::nobody:
      // What nobody takes on the IMU's port says nothing of the lidar's.
      health_.connected.store(false, std::memory_order_relaxed);
      break;
    case network::UdpSender::Outcome::failed:
      raise(health_.retries);
  }
}

void OusterEmulator::send_imu(std::uint16_t port, BenchTime until) {
  if (!(settings_.imu_rate_hz > 0)) return;
  const Duration period = seconds_from(1 / settings_.imu_rate_hz);
  // Since it was switched on, so that a start-up shows as a gap.
  const auto due = static_cast<std::uint64_t>(std::max<std::int64_t>(0, (until - t_on_).ns() / period.ns()));
  if (imu_sent_ + 10 < due) imu_sent_ = due - 1;
  while (imu_sent_ < due) {
    ++imu_sent_;
    const std::int64_t since_start = (t_on_ + period * static_cast<std::int64_t>(imu_sent_) - t_start_).ns();
    ImuPacket p;
    p.system_ns = p.accelerometer_ns = p.gyroscope_ns = start_ns_ + static_cast<std::uint64_t>(since_start);
    p.acceleration_g = {0, 0, 1};
    send(compose_imu(p), port);
  }
}

}  // namespace rigor::ouster
