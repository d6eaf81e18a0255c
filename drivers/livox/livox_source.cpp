#include "drivers/livox/livox_source.h"

#include <arpa/inet.h>
#include <poll.h>
#include <pthread.h>

namespace rigor::livox {
namespace {

constexpr Duration kListen = seconds(2), kSilence = seconds(1), kTell = milliseconds(300);

}  // namespace

LivoxSource::~LivoxSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

LivoxSource::Counters LivoxSource::counters() const noexcept {
  const auto get = [](const auto& a) { return a.load(std::memory_order_relaxed); };
  return {get(packets_),      get(packets_lost_), get(packets_late_), get(clock_steps_),
          get(kernel_drops_), get(foreign_),      get(told_again_)};
}

Status LivoxSource::do_configure(const ChannelConfig& config) {
  settings_ = read_source_settings(config);
  description_.kind = config.kind;
  description_.frame_id = settings_.frame_id;
  return {};
}

Status LivoxSource::do_arm(const ArmContext& context) {
  warnings_.clear();
  for (auto* c :
       {&packets_, &packets_lost_, &packets_late_, &clock_steps_, &kernel_drops_, &foreign_, &told_again_})
    *c = 0;
  again_.reset();
  if (auto s = deadline_.open(); !s) return s;
  deadline_.reset();
  if (!settings_.file.empty()) return arm_file(context.virtual_time);
  auto s = arm_network();
  if (!s) {
    receiver_.close();
    client_.close();
    return fail(s.error().code, config().name, s.error().text());
  }
  return s;
}

void LivoxSource::open_samples(Feed feed) {
  if (is_imu()) {
    packet_lidar::ReadingStream::Options o;
    o.time = settings_.stream.time;
    if (config().period.ns() > 0) o.period = config().period;
    imu_.emplace(o, settings_.stream.utc_offset);
    open_readings(settings_.buffers, feed);
    return;
  }
  points_.emplace(settings_.stream);
  open_clouds(settings_.buffers, points_->max_points(), feed);
}

Status LivoxSource::tell_device(MonotonicTime deadline) {
  const std::uint8_t on = 1, sampling = static_cast<std::uint8_t>(WorkState::sampling);
  const auto type = static_cast<std::uint8_t>(settings_.data_type.value_or(DataType::cartesian_mm));
  const auto host = bytes_of({client_.local_ipv4(), receiver_.port(), is_imu() ? kImuPort : kPointPort});
  std::vector<Parameter> parameters;
  if (settings_.data_type) parameters.push_back({Key::data_type, Bytes(&type, 1)});
  parameters.push_back({is_imu() ? Key::imu_host : Key::point_host, host});
  if (is_imu()) parameters.push_back({Key::imu_enable, Bytes(&on, 1)});
  parameters.push_back({Key::target_mode, Bytes(&sampling, 1)});
  return client_.set(parameters, deadline, deadline_.cut_fd());
}

Status LivoxSource::wait_until_sampling() {
  const MonotonicTime ready = monotonic_now() + settings_.ready;
  while (true) {
    const auto state = client_.state(monotonic_now() + seconds(2), deadline_.cut_fd());
    if (!state) return tl::unexpected<Error>(state.error());
    if (*state == WorkState::sampling) return {};
    if (*state == WorkState::error || monotonic_now() >= ready)
      return fail(
          ErrorCode::unavailable, settings_.host,
          "expected the device to be SAMPLING" +
              (*state == WorkState::error ? std::string()
                                          : " within " + std::to_string(settings_.ready.seconds()) + " s") +
              ", it is in " + std::string(name_of(*state)));
    (void)deadline_.wait_until(monotonic_now() + milliseconds(50));
  }
}

bool LivoxSource::is_wanted(Bytes bytes) const {
  PacketFault fault{};
  const auto packet = Packet::parse(bytes, fault);
  return packet && (packet->data_type() == DataType::imu) == is_imu();
}

Status LivoxSource::arm_network() {
  if (auto s =
          receiver_.open(settings_.address, settings_.port, settings_.socket_buffer_bytes, kMaxPacketBytes);
      !s)
    return s;
  if (!is_imu() && receiver_.buffer_bytes() < settings_.socket_buffer_bytes)
    warnings_.push_back("the kernel grants " + std::to_string(receiver_.buffer_bytes() / 1024) +
                        " KiB of the " + std::to_string(settings_.socket_buffer_bytes / 1024) +
                        " KiB asked for: `rigor doctor` says how to have more");
  device_ipv4_ = 0;
  if (!settings_.host.empty()) {
    in_addr parsed{};
    (void)inet_pton(AF_INET, settings_.host.c_str(), &parsed);
    device_ipv4_ = ntohl(parsed.s_addr);
    if (auto s = client_.open(settings_.host, settings_.command_port, settings_.address); !s) return s;
    if (auto s = tell_device(monotonic_now() + seconds(2)); !s) return s;
    if (auto s = wait_until_sampling(); !s) return s;
  }
  std::uint64_t good = 0, other = 0, foreign = 0;
  for (const BenchTime until = bench_now() + kListen; good == 0 && bench_now() < until;) {
    pollfd p{receiver_.fd(), POLLIN, 0};
    (void)::poll(&p, 1, 50);
    for (const auto& d : receiver_.receive(read_epoch())) {
      if (device_ipv4_ != 0 && d.source_ipv4 != device_ipv4_)
        ++foreign;
      else
        ++(is_wanted(d.bytes) ? good : other);
    }
  }
  if (good == 0)
    return fail(
        ErrorCode::unavailable, settings_.address + ":" + std::to_string(receiver_.port()),
        std::string("expected packets of a Livox Mid-360's ") + (is_imu() ? "inertial unit" : "points") +
            ", got " +
            (other > 0     ? std::to_string(other) + " of something else"
             : foreign > 0 ? std::to_string(foreign) + " of another sender than " + settings_.host
                           : "none in 2 s; with `host`, the device's address, it is told to send here"));
  open_samples(Feed::live);
  t_last_packet_ = bench_now();
  health_.connected = true;
  thread_ = std::thread([this] { run_network(); });
  return {};
}

Status LivoxSource::arm_file(bool virtual_time) {
  auto feed = network::PcapFeed::open(settings_.file, [this](const network::UdpDatagram& d) {
    return (!settings_.port_given || d.destination_port == settings_.port) && is_wanted(d.payload);
  });
  if (!feed) return fail(feed.error().code, config().name, feed.error().text());
  feed_.emplace(std::move(*feed));
  open_samples(virtual_time ? Feed::virtual_time : Feed::recording);
  health_.connected = true;
  if (!virtual_time) thread_ = std::thread([this] { run_file(); });
  return {};
}

Status LivoxSource::do_start(BenchTime t0) {
  t0_ = t0;
  // Of a recording; its thread waits for the origin, which is published after this.
  if (feed_) {
    const EpochPair epoch{t0, feed_->first_stamp(), Duration(0)};
    if (points_) points_->clock().set_epoch(epoch);
    if (imu_) imu_->clock().set_epoch(epoch);
  }
  return {};
}

Status LivoxSource::do_stop() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  receiver_.close();
  client_.close();
  feed_.reset();
  points_.reset();
  imu_.reset();
  close_stream();
  health_.connected = false;
  return {};
}

std::uint64_t LivoxSource::good_packets() const {
  return points_ ? points_->counters().packets : imu_->counters().readings;
}

void LivoxSource::publish() {
  packets_.store(good_packets(), std::memory_order_relaxed);
  if (points_) {
    const PointStream::Counters& c = points_->counters();
    packets_lost_.store(c.packets_lost, std::memory_order_relaxed);
    packets_late_.store(c.packets_late, std::memory_order_relaxed);
    clock_steps_.store(c.clock_steps, std::memory_order_relaxed);
  } else {
    packets_lost_.store(imu_->counters().lost, std::memory_order_relaxed);
    packets_late_.store(imu_->counters().repeated, std::memory_order_relaxed);
    clock_steps_.store(imu_->counters().clock_steps, std::memory_order_relaxed);
  }
  kernel_drops_.store(receiver_.dropped(), std::memory_order_relaxed);
}

void LivoxSource::take(Bytes datagram, BenchTime arrival) {
  if (points_) {
    points_->take(datagram, arrival, hand());
    count_malformed(points_->counters().malformed);
    return;
  }
  const auto reading = imu_->take(datagram, arrival);
  count_malformed(imu_->malformed());
  if (reading) hand_reading(*reading);
}

void LivoxSource::receive(std::span<const network::UdpReceiver::Datagram> batch) {
  for (const auto& d : batch) {
    if (device_ipv4_ != 0 && d.source_ipv4 != device_ipv4_) {
      foreign_.fetch_add(1, std::memory_order_relaxed);
      continue;
    }
    const std::uint64_t before = good_packets();
    take(d.bytes, d.arrival);
    if (good_packets() == before) continue;
    t_last_packet_ = d.arrival;
    if (!health_.connected.load(std::memory_order_relaxed)) {
      health_.connected.store(true, std::memory_order_release);
      health_.reconnects.fetch_add(1, std::memory_order_relaxed);
      again_.reset();
    }
  }
  publish();
}

/// A device that is silent is told again what it is to do.
void LivoxSource::look_after() {
  if (bench_now() - t_last_packet_ <= kSilence) return;
  health_.connected.store(false, std::memory_order_release);
  if (!client_.is_open() || !again_.due(monotonic_now())) return;
  if (tell_device(monotonic_now() + kTell)) told_again_.fetch_add(1, std::memory_order_relaxed);
  // Its motor may take a while.
  again_.failed(monotonic_now());
}

void LivoxSource::run_network() {
  pthread_setname_np(pthread_self(), is_imu() ? "livox-imu" : "livox");
  std::vector<network::UdpPort> ports{{&receiver_, settings_.address, receiver_.port(),
                                       settings_.socket_buffer_bytes, kMaxPacketBytes,
                                       [this](auto batch) { receive(batch); }}};
  network::serve_ports(
      ports, deadline_,
      [this](const EpochPair& epoch) {
        if (points_) points_->clock().set_epoch(epoch);
        if (imu_) imu_->clock().set_epoch(epoch);
      },
      [this] { look_after(); });
}

void LivoxSource::run_file() {
  pthread_setname_np(pthread_self(), "livox-file");
  const auto take_one = [this](Bytes datagram, BenchTime due) {
    take(datagram, due);
    publish();
  };
  if (feed_->play(origin(), deadline_, take_one)) end_of_file();
}

void LivoxSource::end_of_file() {
  if (feed_->broken()) health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
  health_.connected.store(false, std::memory_order_release);
  publish();
}

void LivoxSource::complete_until(BenchTime now) {
  if (!feed_) return;
  // On until a sample is there that is not released yet: what is released later was captured later.
  const auto more = [this, now] { return !handed_past(now); };
  if (feed_->play_while(more, t0_, [this](Bytes datagram, BenchTime due) { take(datagram, due); }))
    end_of_file();
  publish();
}

}  // namespace rigor::livox
