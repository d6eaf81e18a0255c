#include "drivers/ouster/ouster_source.h"

#include <netdb.h>
#include <netinet/in.h>

#include <cstring>

namespace rigor::ouster {
namespace {

constexpr Duration kListen = seconds(2), kFetch = seconds(2);

/// Of a host name or address, in host order; 0: not known, or IPv6 alone.
std::uint32_t ipv4_of(const std::string& host) {
  addrinfo hints{};
  hints.ai_family = AF_INET;
  addrinfo* found = nullptr;
  if (host.empty() || getaddrinfo(host.c_str(), nullptr, &hints, &found) != 0) return 0;
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> owned(found, &freeaddrinfo);
  sockaddr_in a{};
  std::memcpy(&a, found->ai_addr, sizeof a);
  return ntohl(a.sin_addr.s_addr);
}

}  // namespace

OusterSource::~OusterSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status OusterSource::do_configure(const ChannelConfig& config) {
  settings_ = read_source_settings(config);
  description_.kind = config.kind;
  description_.frame_id = settings_.frame_id;
  return {};
}

SensorAddress OusterSource::sensor() const {
  return {settings_.host, settings_.http_port, settings_.tcp_port, deadline_.cut_fd()};
}

std::uint16_t OusterSource::port_of(const Metadata& m) const {
  if (is_imu()) return settings_.imu_port != 0 ? settings_.imu_port : m.imu_port != 0 ? m.imu_port : kImuPort;
  return settings_.lidar_port != 0 ? settings_.lidar_port : m.lidar_port != 0 ? m.lidar_port : kLidarPort;
}

Status OusterSource::open_frames(const Metadata& m, Feed feed) {
  initialization_id_ = m.initialization_id;
  frames_.reset();
  imu_.reset();
  fetch_.reset();
  other_seen_ = malformed_seen_ = kernel_drops_ = reinitialized_ = 0;
  counters_.store({});
  const Duration utc_offset = settings_.utc_offset.value_or(
      m.timestamp_mode == "TIME_FROM_PTP_1588" && feed == Feed::live ? seconds(-37) : Duration(0));
  if (is_imu()) {
    ImuStream::Options o;
    o.time = settings_.stream.time;
    o.utc_offset = utc_offset;
    if (config().period.ns() > 0) o.period = config().period;
    imu_.emplace(o);
    open_readings(settings_.buffers, feed);
    return {};
  }
  FrameStreamOptions o = settings_.stream;
  if (o.image)
    if (auto s = check_field(m.profile, o.image->field); !s)
      return tl::unexpected<Error>(config().params.error("field", s.error().message).error());
  o.utc_offset = utc_offset;
  o.this_initialization_only = !settings_.host.empty();
  frames_.emplace(m, o);
  if (const FrameImage* image = frames_->image())
    open_images(settings_.buffers, image->info(), image->bytes().size(), feed);
  else
    open_clouds(settings_.buffers, FrameStream::max_points(m), feed);
  return {};
}

Status OusterSource::arm_network() {
  Metadata m;
  const MonotonicTime ready = monotonic_now() + settings_.ready;
  if (!settings_.configure.empty())
    if (auto started = configure_sensor(sensor(), settings_.configure, ready); !started)
      return tl::unexpected<Error>(started.error());
  if (!settings_.metadata.empty()) {
    auto loaded = load_metadata(settings_.metadata);
    if (!loaded) return tl::unexpected<Error>(loaded.error());
    m = std::move(*loaded);
  } else if (!settings_.host.empty()) {
    auto fetched = wait_for_metadata(sensor(), ready);
    if (!fetched) return tl::unexpected<Error>(fetched.error());
    m = std::move(*fetched);
  } else {
    return fail(
        ErrorCode::bad_input, config().name,
        "expected `host`, the sensor to ask for its metadata, or `metadata`, a file that has them: packets "
        "do not say where beams point");
  }
  device_ipv4_ = ipv4_of(settings_.host);
  if (auto s = open_frames(m, Feed::live); !s) return s;
  begin_listening();
  const std::uint64_t errors = health_.protocol_errors;
  const std::uint16_t number = port_of(m);
  auto port = SensorPort::join(settings_.address, number, settings_.socket_buffer_bytes, this);
  if (!port) return tl::unexpected<Error>(port.error());
  port_ = std::move(*port);
  if (!is_imu()) warn_of_small_buffer(port_->buffer_bytes(), settings_.socket_buffer_bytes);
  return await_packets(is_imu() ? kImuBytes : layout_of(m).packet_bytes, number, errors);
}

Status OusterSource::await_packets(std::size_t expected_bytes, std::uint16_t port, std::uint64_t errors) {
  for (const MonotonicTime limit = monotonic_now() + kListen;
       counters().packets == 0 && monotonic_now() < limit;)
    if (!deadline_.wait_until(std::min(limit, monotonic_now() + milliseconds(1)))) break;
  const Counters seen = counters();
  if (seen.packets > 0) return {};
  const std::uint64_t other = health_.protocol_errors - errors;
  return fail(
      ErrorCode::unavailable, config().name,
      "expected packets of " + std::to_string(expected_bytes) + " bytes at " + settings_.address + ":" +
          std::to_string(port) + ", got " +
          (other > 0 ? std::to_string(other) + " of something else: do the metadata belong to this sensor?"
           : seen.foreign > 0
               ? std::to_string(seen.foreign) + " of another sender than " + settings_.host
               : "none in 2 s; the sensor sends to its `udp_dest`: `configure: { udp_dest: auto "
                 "}` makes that this machine"));
}

void OusterSource::leave_network() {
  if (!port_) return;
  deadline_.cut();  // a request to the sensor that is under way
  port_->leave(this);
  port_.reset();
}

Status OusterSource::arm_file(Feed feed) {
  auto m = load_metadata(settings_.metadata);
  if (!m) return tl::unexpected<Error>(m.error());
  const std::size_t size = is_imu() ? kImuBytes : layout_of(*m).packet_bytes;
  const std::uint16_t port = is_imu() ? settings_.imu_port : settings_.lidar_port;
  auto opened = open_recording(settings_.file, [size, port](const network::UdpDatagram& d) {
    return d.payload.size() == size && (port == 0 || d.destination_port == port);
  });
  if (!opened) {
    opened.error().message += " (packets of " + std::to_string(size) + " bytes, by the metadata)";
    return opened;
  }
  return open_frames(*m, feed);
}

void OusterSource::set_epoch(const EpochPair& epoch) {
  if (frames_) frames_->clock().set_epoch(epoch);
  if (imu_) imu_->clock().set_epoch(epoch);
}

std::uint64_t OusterSource::good_packets() const {
  return frames_ ? frames_->counters().packets : imu_->counters().packets;
}

void OusterSource::publish() {
  Counters c;
  if (frames_) {
    const FrameStream::Counters& of = frames_->counters();
    c.packets = of.packets, c.packets_lost = of.packets_lost, c.clock_steps = of.clock_steps;
    c.columns_lost = of.columns_lost, c.frames_lost = of.frames_lost, c.packets_late = of.packets_late;
  } else if (imu_) {
    const ImuStream::Counters of = imu_->counters();
    c.packets = of.packets, c.packets_lost = of.packets_lost, c.clock_steps = of.clock_steps;
  }
  c.kernel_drops = kernel_drops_;
  c.foreign = foreign();
  c.reinitialized = reinitialized_;
  counters_.store(c);
}

void OusterSource::take(Bytes datagram, BenchTime arrival) {
  if (is_imu()) {
    if (const auto reading = imu_->take(datagram, arrival)) hand_reading(*reading);
    count_malformed(imu_->counters().malformed);
    return;
  }
  frames_->take(datagram, arrival, hand());
  count_malformed(frames_->counters().malformed);
}

/// Whether the sensor is there, and still the one that it was.
void OusterSource::on_turn(SensorPort& port) {
  if (const auto dropped = port.dropped(); dropped != kernel_drops_) kernel_drops_ = dropped, publish();
  (void)watch_silence();
  if (settings_.host.empty()) return;
  const FrameStream::Counters c = frames_ ? frames_->counters() : FrameStream::Counters{};
  const bool anew = c.other_initialization != other_seen_ || c.malformed != malformed_seen_;
  // It may send to another port. A request holds up this thread: not while packets of others come here.
  if ((!anew && !hears_nobody()) || !fetch_.due(monotonic_now())) return;
  auto m = fetch_metadata(sensor(), monotonic_now() + kFetch);
  if (!m || m->status != "RUNNING") {
    fetch_.failed(monotonic_now());
    return;
  }
  other_seen_ = c.other_initialization, malformed_seen_ = c.malformed;
  if (m->initialization_id == initialization_id_) {
    fetch_.failed(monotonic_now());  // packets of something else, or none: no reason to ask all the time
    return;
  }
  if (frames_ && !frames_->adopt(*m)) {
    health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
    fetch_.failed(monotonic_now());
    return;
  }
  initialization_id_ = m->initialization_id;
  fetch_.reset();
  ++reinitialized_;
  publish();
  port.move_to(port_of(*m));
}

}  // namespace rigor::ouster
