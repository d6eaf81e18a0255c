#include "drivers/velodyne/velodyne_emulator.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <pthread.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cmath>
#include <cstring>
#include <ctime>

#include "rt-core/epoch.h"

namespace rigor::velodyne {
namespace {

constexpr std::int64_t kHour_ns = 3'600'000'000'000;
/// Later than this, packets are given up instead of sent in a burst.
constexpr Duration kLatest = milliseconds(100);

void raise(std::atomic<std::uint64_t>& counter, std::uint64_t by = 1) {
  counter.fetch_add(by, std::memory_order_relaxed);
}

}  // namespace

VelodyneEmulator::~VelodyneEmulator() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

std::string VelodyneEmulator::endpoint() const {
  return std::string(facts_of(settings_.model).name) + " sending to " + settings_.address + ":" +
         std::to_string(settings_.port) + (settings_.returns == ReturnMode::dual ? ", dual returns" : "");
}

Status VelodyneEmulator::do_configure(const ChannelConfig& config) {
  settings_ = read_emulator_settings(config.params);
  description_.kind = SampleKind::point_cloud;
  return {};
}

Status VelodyneEmulator::do_arm(const ArmContext& context) {
  const std::string& name = config().name;
  if (context.virtual_time)
    return fail(ErrorCode::bad_input, name, "an emulator on the network runs by the wall clock only");
  RotorSettings rotor;
  rotor.model = settings_.model;
  rotor.dual = settings_.returns == ReturnMode::dual;
  rotor.single = rotor.dual ? ReturnMode::strongest : settings_.returns;
  rotor.product = settings_.product;
  if (auto device = RotorDevice::create(rotor, parts_.samples); !device)
    return fail(device.error().code, name, device.error().text());
  if (auto s = sending_.open(); !s) return s;
  socket_ = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  const int on = 1;
  if (socket_ < 0 || setsockopt(socket_, SOL_SOCKET, SO_BROADCAST, &on, sizeof on) != 0)
    return fail(ErrorCode::io, name, std::string("expected a UDP socket: ") + std::strerror(errno));
  // Connected for a moment: which address of ours leads there.
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(settings_.port);
  (void)inet_pton(AF_INET, settings_.address.c_str(), &to.sin_addr);
  destination_ipv4_ = ntohl(to.sin_addr.s_addr);
  if (connect(socket_, reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0) {
    const int why = errno;
    close(socket_);
    socket_ = -1;
    return fail(
        ErrorCode::unavailable, name,
        "expected a way to " + settings_.address + ": " + std::strerror(why) + "; `ip route` lists them");
  }
  sockaddr_in local{};
  socklen_t length = sizeof local;
  if (getsockname(socket_, reinterpret_cast<sockaddr*>(&local), &length) == 0) {
    local_ipv4_ = ntohl(local.sin_addr.s_addr);
    local_port_ = ntohs(local.sin_port);
  }
  if (!settings_.pcap.empty()) {
    auto writer = PcapWriter::create(settings_.pcap);
    if (!writer) {
      close(socket_);
      socket_ = -1;
      return tl::unexpected<Error>(writer.error());
    }
    pcap_.emplace(std::move(*writer));
  }
  return {};
}

Status VelodyneEmulator::do_start(BenchTime t0) {
  epoch_ = read_epoch();
  RotorSettings rotor;
  rotor.model = settings_.model;
  rotor.dual = settings_.returns == ReturnMode::dual;
  rotor.single = rotor.dual ? ReturnMode::strongest : settings_.returns;
  rotor.product = settings_.product;
  // One revolution for nothing: the first measurement takes longest, and packets shall be there from t_start
  // on.
  auto trial = RotorDevice::create(rotor, parts_.samples);
  if (!trial) return tl::unexpected<Error>(trial.error());
  Revolution scratch = trial->make_revolution();
  for (int i = 0; i < 2; ++i) {
    const BenchTime began(monotonic_now().ns());
    const WorldMotion motion = parts_.motion ? parts_.motion->motion_at(began) : WorldMotion{};
    if (auto s = trial->measure(0, began, motion, scratch); !s) return s;
    measuring_time_ = bench_now() - began;
  }
  t_start_ = std::max(t0, bench_now()) + trial->revolution_time() + measuring_time_ * 2;
  // Whole microseconds: what the device counts.
  t_start_ = t_start_ - Duration(epoch_.to_utc(t_start_).ns() % 1000);
  rotor.start_us = static_cast<std::uint32_t>(epoch_.to_utc(t_start_).ns() % kHour_ns / 1000);
  auto device = RotorDevice::create(rotor, parts_.samples);
  if (!device) return tl::unexpected<Error>(device.error());
  device_.emplace(std::move(*device));
  revolutions_.clear();
  for (std::size_t i = 0; i < kKept; ++i) revolutions_.push_back(device_->make_revolution());
  measured_ = sending_revolution_ = 0;
  stop_ = false;
  sending_.reset();
  health_.connected = true;
  measuring_thread_ = std::thread([this] { measure_ahead(); });
  sending_thread_ = std::thread([this] { send_packets(); });
  return {};
}

Status VelodyneEmulator::do_stop() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  changed_.notify_all();
  sending_.cut();
  if (sending_thread_.joinable()) sending_thread_.join();
  if (measuring_thread_.joinable()) measuring_thread_.join();
  if (socket_ >= 0) close(socket_);
  socket_ = -1;
  health_.connected = false;
  Status written;
  if (pcap_) written = pcap_->flush();
  pcap_.reset();
  return written;
}

std::uint64_t VelodyneEmulator::next_revolution() const {
  // Where measuring takes longer than a turn, those that would come too late are left out, so that the others
  // are whole.
  const double ready = (bench_now() + measuring_time_ - t_start_).seconds();
  const double in_time = std::max(0.0, std::floor(ready * device_->rotation_hz()) + 1);
  return std::max(measured_, std::min(static_cast<std::uint64_t>(in_time), sending_revolution_ + kKept - 2));
}

void VelodyneEmulator::measure_ahead() {
  pthread_setname_np(pthread_self(), "velodyne-scan");
  Revolution scratch = device_->make_revolution();
  while (true) {
    std::uint64_t k = 0;
    {
      std::unique_lock lock(mutex_);
      // A slot is free once its revolution is two behind the one that is being sent.
      changed_.wait(lock, [&] { return stop_ || measured_ <= sending_revolution_ + kAhead; });
      if (stop_) return;
      k = next_revolution();
    }
    const BenchTime begin = t_start_ + Duration(device_->begin_ns(k));
    const BenchTime now(monotonic_now().ns());
    WorldMotion motion;
    if (parts_.motion) motion = parts_.motion->motion_at(std::min(begin, now));
    if (!device_->measure(k, begin, motion, scratch)) raise(health_.protocol_errors);
    const std::lock_guard lock(mutex_);
    // A machine that is busy now is busy a little longer.
    measuring_time_ = std::max(bench_now() - now, measuring_time_ * 3 / 4);
    std::swap(scratch, revolutions_[k % kKept]);
    measured_ = k + 1;
  }
}

void VelodyneEmulator::send_packets() {
  pthread_setname_np(pthread_self(), "velodyne-send");
  DataPacketWriter packet;
  const Duration packet_time(device_->packet_ns());
  const Duration position_every =
      settings_.position_rate_hz > 0 ? seconds_from(1 / settings_.position_rate_hz) : Duration(0);
  std::uint64_t positions = 0;
  for (std::uint64_t j = 0;; ++j) {
    const BenchTime due = t_start_ + packet_time * static_cast<std::int64_t>(j + 1);
    if (!sending_.wait_until(MonotonicTime(due.ns()))) return;
    const std::uint64_t last = device_->last_revolution_of(j);
    bool there = true;
    {
      const std::lock_guard lock(mutex_);
      if (last > sending_revolution_) {
        sending_revolution_ = last;
        changed_.notify_all();
      }
      const auto of = [&](std::uint64_t k) {
        const Revolution& r = revolutions_[k % kKept];
        const bool has = r.seen && r.index == k;
        there = there && has;
        return has ? &r : nullptr;
      };
      device_->compose(j, of, packet);
    }
    if (!there || bench_now() - due > kLatest) {
      raise(health_.lost);
    } else {
      send(packet.bytes(), settings_.port);
      raise(health_.received);
    }
    while (position_every.ns() > 0 &&
           t_start_ + position_every * static_cast<std::int64_t>(positions) <= due) {
      send_position(t_start_ + position_every * static_cast<std::int64_t>(positions));
      ++positions;
    }
  }
}

void VelodyneEmulator::send(Bytes bytes, std::uint16_t port) {
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(port);
  to.sin_addr.s_addr = htonl(destination_ipv4_);
  const ssize_t n =
      sendto(socket_, bytes.data(), bytes.size(), 0, reinterpret_cast<const sockaddr*>(&to), sizeof to);
  // A port that nobody has open answers by ICMP, and the next call here tells of it.
  if (n >= 0) {
    if (port == settings_.port) health_.connected.store(true, std::memory_order_relaxed);
  } else if (errno == ECONNREFUSED) {
    health_.connected.store(false, std::memory_order_relaxed);
    (void)sendto(socket_, bytes.data(), bytes.size(), 0, reinterpret_cast<const sockaddr*>(&to), sizeof to);
  } else {
    raise(health_.retries);
  }
  if (pcap_) pcap_->write(epoch_.to_utc(bench_now()), {local_ipv4_, destination_ipv4_, port, port, bytes});
}

void VelodyneEmulator::send_position(BenchTime t) {
  const std::int64_t utc = epoch_.to_utc(t).ns();
  const auto second = static_cast<std::time_t>(utc / 1'000'000'000);
  std::tm when{};
  gmtime_r(&second, &when);
  NmeaRmc rmc;
  rmc.valid = settings_.pps == PpsStatus::locked;
  rmc.year = when.tm_year + 1900, rmc.month = when.tm_mon + 1, rmc.day = when.tm_mday;
  rmc.hour = when.tm_hour, rmc.minute = when.tm_min, rmc.second = when.tm_sec;
  rmc.latitude_deg = settings_.latitude_deg, rmc.longitude_deg = settings_.longitude_deg;
  const std::string sentence = settings_.pps == PpsStatus::absent ? std::string() : compose_rmc(rmc);
  const auto bytes =
      compose_position({static_cast<std::uint32_t>(utc % kHour_ns / 1000), settings_.pps, sentence});
  send(bytes, settings_.position_port);
}

}  // namespace rigor::velodyne
