#include "drivers/livox/livox_source.h"

#include <poll.h>
#include <pthread.h>

namespace rigor::livox {
namespace {

constexpr Duration kListen = seconds(2), kTell = milliseconds(300);

}  // namespace

LivoxSource::~LivoxSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status LivoxSource::do_configure(const ChannelConfig& config) {
  settings_ = read_source_settings(config);
  description_.kind = config.kind;
  description_.frame_id = settings_.frame_id;
  return {};
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
  again_.reset();
  told_again_ = 0;
  counters_.store({});
  if (auto s =
          receiver_.open(settings_.address, settings_.port, settings_.socket_buffer_bytes, kMaxPacketBytes);
      !s)
    return s;
  if (!is_imu()) warn_of_small_buffer(receiver_.buffer_bytes(), settings_.socket_buffer_bytes);
  device_ipv4_ = 0;
  if (!settings_.host.empty()) {
    device_ipv4_ = packet_lidar::ipv4_of(settings_.host);
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
  begin_listening();
  thread_ = std::thread([this] { run_network(); });
  return {};
}

Status LivoxSource::arm_file(Feed feed) {
  told_again_ = 0;
  counters_.store({});
  if (auto s = open_recording(settings_.file,
                              [this](const network::UdpDatagram& d) {
                                return (!settings_.port_given || d.destination_port == settings_.port) &&
                                       is_wanted(d.payload);
                              });
      !s)
    return s;
  open_samples(feed);
  return {};
}

void LivoxSource::leave_network() {
  receiver_.close();
  client_.close();
  points_.reset();
  imu_.reset();
}

void LivoxSource::set_epoch(const EpochPair& epoch) {
  if (points_) points_->clock().set_epoch(epoch);
  if (imu_) imu_->clock().set_epoch(epoch);
}

std::uint64_t LivoxSource::good_packets() const {
  return points_ ? points_->counters().packets : imu_->counters().readings;
}

void LivoxSource::publish() {
  Counters c;
  c.packets = good_packets();
  if (points_) {
    const PointStream::Counters& of = points_->counters();
    c.packets_lost = of.packets_lost, c.packets_late = of.packets_late, c.clock_steps = of.clock_steps;
  } else {
    const auto& of = imu_->counters();
    c.packets_lost = of.lost, c.packets_late = of.repeated, c.clock_steps = of.clock_steps;
  }
  c.kernel_drops = receiver_.dropped();
  c.foreign = foreign();
  c.told_again = told_again_;
  counters_.store(c);
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

/// A device that is silent is told again what it is to do.
void LivoxSource::look_after() {
  if (!watch_silence()) return;
  if (!client_.is_open() || !again_.due(monotonic_now())) return;
  if (tell_device(monotonic_now() + kTell)) ++told_again_;
  // Its motor may take a while.
  again_.failed(monotonic_now());
  publish();
}

void LivoxSource::run_network() {
  pthread_setname_np(pthread_self(), is_imu() ? "livox-imu" : "livox");
  std::vector<network::UdpPort> ports{{&receiver_, settings_.address, receiver_.port(),
                                       settings_.socket_buffer_bytes, kMaxPacketBytes,
                                       [this](auto batch) { receive(batch); }}};
  network::serve_ports(
      ports, deadline_, [this](const EpochPair& epoch) { set_epoch(epoch); }, [this] { look_after(); });
}

}  // namespace rigor::livox
