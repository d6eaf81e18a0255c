#include "drivers/velodyne/velodyne_emulator.h"

#include <pthread.h>

#include <algorithm>
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

RotorSettings VelodyneEmulator::rotor_settings() const {
  RotorSettings rotor;
  rotor.model = settings_.model;
  rotor.dual = settings_.returns == ReturnMode::dual;
  rotor.single = rotor.dual ? ReturnMode::strongest : settings_.returns;
  rotor.product = settings_.product;
  return rotor;
}

Status VelodyneEmulator::do_arm(const ArmContext&) {
  const std::string& name = config().name;
  if (auto device = RotorDevice::create(rotor_settings(), parts_.samples); !device)
    return fail(device.error().code, name, device.error().text());
  if (auto s = sending_.open(); !s) return s;
  if (auto s = sender_.open(settings_.address, settings_.port); !s)
    return fail(s.error().code, name, s.error().text());
  if (!settings_.pcap.empty())
    if (auto s = sender_.record(settings_.pcap); !s) {
      sender_.close();
      return s;
    }
  return {};
}

Status VelodyneEmulator::do_start(BenchTime t0) {
  epoch_ = read_epoch();
  auto device = RotorDevice::create(rotor_settings(), parts_.samples);
  if (!device) return tl::unexpected<Error>(device.error());
  device_.emplace(std::move(*device));
  scans_.emplace(packet_lidar::ScanAhead::Options{
      [this](std::uint64_t k, BenchTime begin, const WorldMotion& motion, Revolution& out) {
        return device_->measure(k, begin, motion, out);
      },
      [this](std::uint64_t k) { return Duration(device_->begin_ns(k)); }, device_->revolution_time(),
      device_->make_revolution(), parts_.motion, &health_.protocol_errors, "velodyne-scan"});
  // Packets shall be there from t_start on.
  if (auto s = scans_->prepare(); !s) return s;
  t_start_ = std::max(t0, bench_now()) + device_->revolution_time() + scans_->measuring_time() * 2;
  // Whole microseconds: what the device counts.
  t_start_ = t_start_ - Duration(epoch_.to_utc(t_start_).ns() % 1000);
  device_->set_start_us(static_cast<std::uint32_t>(epoch_.to_utc(t_start_).ns() % kHour_ns / 1000));
  sending_.reset();
  health_.connected = true;
  scans_->start(t_start_);
  sending_thread_ = std::thread([this] { send_packets(); });
  return {};
}

Status VelodyneEmulator::do_stop() {
  sending_.cut();
  if (sending_thread_.joinable()) sending_thread_.join();
  scans_.reset();
  sender_.close();
  health_.connected = false;
  return sender_.finish_recording();
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
    bool there = true;
    scans_->use(device_->last_revolution_of(j), [&](const packet_lidar::ScanAhead::Of& of) {
      device_->compose(
          j,
          [&](std::uint64_t k) {
            const Revolution* r = of(k);
            there = there && r;
            return r;
          },
          packet);
    });
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
  switch (sender_.send(bytes, port, epoch_.to_utc(bench_now()))) {
    case network::UdpSender::Outcome::sent:
      if (port == settings_.port) health_.connected.store(true, std::memory_order_relaxed);
      break;
    case network::UdpSender::Outcome::nobody:
      health_.connected.store(false, std::memory_order_relaxed);
      break;
    case network::UdpSender::Outcome::failed:
      raise(health_.retries);
  }
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
