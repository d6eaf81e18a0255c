#include "drivers/ouster/ouster_source.h"

#include <netdb.h>
#include <netinet/in.h>
#include <pthread.h>

#include <cstring>

namespace rigor::ouster {
namespace {

constexpr Duration kListen = seconds(2), kSilence = seconds(1), kFetch = seconds(2);

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

OusterSource::Counters OusterSource::counters() const noexcept {
  const auto get = [](const auto& a) { return a.load(std::memory_order_relaxed); };
  return {get(packets_),     get(packets_lost_), get(columns_lost_), get(frames_lost_),  get(packets_late_),
          get(clock_steps_), get(kernel_drops_), get(foreign_),      get(reinitialized_)};
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

Status OusterSource::do_arm(const ArmContext& context) {
  warnings_.clear();
  for (auto* c : {&packets_, &packets_lost_, &columns_lost_, &frames_lost_, &packets_late_, &clock_steps_,
                  &kernel_drops_, &foreign_, &reinitialized_})
    *c = 0;
  other_seen_ = malformed_seen_ = 0;
  fetch_.reset();
  if (auto s = deadline_.open(); !s) return s;
  deadline_.reset();
  if (!settings_.file.empty()) return arm_file(context.virtual_time);
  auto s = arm_network();
  if (!s) leave_port();
  return s;
}

Status OusterSource::open_frames(const Metadata& m, Feed feed) {
  initialization_id_ = m.initialization_id;
  frames_.reset();
  imu_.reset();
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
      return fail(started.error().code, config().name, started.error().text());
  if (!settings_.metadata.empty()) {
    auto loaded = load_metadata(settings_.metadata);
    if (!loaded) return tl::unexpected<Error>(loaded.error());
    m = std::move(*loaded);
  } else if (!settings_.host.empty()) {
    auto fetched = wait_for_metadata(sensor(), ready);
    if (!fetched) return fail(fetched.error().code, config().name, fetched.error().text());
    m = std::move(*fetched);
  } else {
    return fail(
        ErrorCode::bad_input, config().name,
        "expected `host`, the sensor to ask for its metadata, or `metadata`, a file that has them: packets "
        "do not say where beams point");
  }
  sensor_ipv4_ = ipv4_of(settings_.host);
  if (auto s = open_frames(m, Feed::live); !s) return s;
  t_last_packet_ = t_last_datagram_ = bench_now();
  health_.connected = true;
  const std::uint64_t errors = health_.protocol_errors;
  const std::uint16_t number = port_of(m);
  auto port = SensorPort::join(settings_.address, number, settings_.socket_buffer_bytes, this);
  if (!port) return fail(port.error().code, config().name, port.error().text());
  port_ = std::move(*port);
  if (!is_imu() && port_->buffer_bytes() < settings_.socket_buffer_bytes)
    warnings_.push_back("the kernel grants " + std::to_string(port_->buffer_bytes() / 1024) + " KiB of the " +
                        std::to_string(settings_.socket_buffer_bytes / 1024) +
                        " KiB asked for: `rigor doctor` says how to have more");
  return await_packets(is_imu() ? kImuBytes : layout_of(m).packet_bytes, number, errors);
}

Status OusterSource::await_packets(std::size_t expected_bytes, std::uint16_t port, std::uint64_t errors) {
  for (const MonotonicTime limit = monotonic_now() + kListen; packets_ == 0 && monotonic_now() < limit;)
    if (!deadline_.wait_until(std::min(limit, monotonic_now() + milliseconds(1)))) break;
  if (packets_ > 0) return {};
  const std::uint64_t other = health_.protocol_errors - errors, foreign = foreign_;
  return fail(
      ErrorCode::unavailable, config().name,
      "expected packets of " + std::to_string(expected_bytes) + " bytes at " + settings_.address + ":" +
          std::to_string(port) + ", got " +
          (other > 0 ? std::to_string(other) + " of something else: do the metadata belong to this sensor?"
           : foreign > 0 ? std::to_string(foreign) + " of another sender than " + settings_.host
                         : "none in 2 s; the sensor sends to its `udp_dest`: `configure: { udp_dest: auto "
                           "}` makes that this machine"));
}

void OusterSource::leave_port() {
  health_.connected = false;
  if (!port_) return;
  deadline_.cut();  // a request to the sensor that is under way
  port_->leave(this);
  port_.reset();
}

Status OusterSource::arm_file(bool virtual_time) {
  auto m = load_metadata(settings_.metadata);
  if (!m) return tl::unexpected<Error>(m.error());
  const std::size_t size = is_imu() ? kImuBytes : layout_of(*m).packet_bytes;
  const std::uint16_t port = is_imu() ? settings_.imu_port : settings_.lidar_port;
  auto feed = network::PcapFeed::open(settings_.file, [size, port](const network::UdpDatagram& d) {
    return d.payload.size() == size && (port == 0 || d.destination_port == port);
  });
  if (!feed)
    return fail(feed.error().code, config().name,
                feed.error().text() + " (packets of " + std::to_string(size) + " bytes, by the metadata)");
  if (auto s = open_frames(*m, virtual_time ? Feed::virtual_time : Feed::recording); !s) return s;
  feed_.emplace(std::move(*feed));
  health_.connected = true;
  if (!virtual_time) thread_ = std::thread([this] { run_file(); });
  return {};
}

Status OusterSource::do_start(BenchTime t0) {
  t0_ = t0;
  // Of a recording; its thread waits for the origin, which is published after this.
  if (feed_) {
    const EpochPair epoch{t0, feed_->first_stamp(), Duration(0)};
    if (frames_) frames_->clock().set_epoch(epoch);
    if (imu_) imu_->clock().set_epoch(epoch);
  }
  return {};
}

Status OusterSource::do_stop() {
  deadline_.cut();
  leave_port();
  if (thread_.joinable()) thread_.join();
  feed_.reset();
  close_stream();
  health_.connected = false;
  return {};
}

std::uint64_t OusterSource::good_packets() const {
  return frames_ ? frames_->counters().packets : imu_->counters().packets;
}

void OusterSource::publish() {
  if (frames_) {
    const FrameStream::Counters& c = frames_->counters();
    packets_.store(c.packets, std::memory_order_relaxed);
    packets_lost_.store(c.packets_lost, std::memory_order_relaxed);
    columns_lost_.store(c.columns_lost, std::memory_order_relaxed);
    frames_lost_.store(c.frames_lost, std::memory_order_relaxed);
    packets_late_.store(c.packets_late, std::memory_order_relaxed);
    clock_steps_.store(c.clock_steps, std::memory_order_relaxed);
  } else if (imu_) {
    const ImuStream::Counters c = imu_->counters();
    packets_.store(c.packets, std::memory_order_relaxed);
    packets_lost_.store(c.packets_lost, std::memory_order_relaxed);
    clock_steps_.store(c.clock_steps, std::memory_order_relaxed);
  }
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

void OusterSource::on_epoch(const EpochPair& epoch) {
  if (frames_) frames_->clock().set_epoch(epoch);
  if (imu_) imu_->clock().set_epoch(epoch);
}

void OusterSource::on_packets(std::span<const network::UdpReceiver::Datagram> batch) {
  for (const auto& d : batch) {
    t_last_datagram_ = d.arrival;
    if (sensor_ipv4_ != 0 && d.source_ipv4 != sensor_ipv4_) {
      foreign_.fetch_add(1, std::memory_order_relaxed);
      continue;
    }
    const std::uint64_t before = good_packets();
    take(d.bytes, d.arrival);
    if (good_packets() == before) continue;
    t_last_packet_ = d.arrival;
    if (!health_.connected.load(std::memory_order_relaxed)) {
      fetch_.reset();
      health_.connected.store(true, std::memory_order_release);
      health_.reconnects.fetch_add(1, std::memory_order_relaxed);
    }
  }
  publish();
}

/// Whether the sensor is there, and still the one that it was.
void OusterSource::on_turn(SensorPort& port) {
  kernel_drops_.store(port.dropped(), std::memory_order_relaxed);
  const BenchTime now = bench_now();
  if (now - t_last_packet_ > kSilence) health_.connected.store(false, std::memory_order_release);
  if (settings_.host.empty()) return;
  const FrameStream::Counters c = frames_ ? frames_->counters() : FrameStream::Counters{};
  const bool anew = c.other_initialization != other_seen_ || c.malformed != malformed_seen_;
  // It may send to another port. A request holds up this thread: not while packets of others come here.
  const bool silent = now - t_last_datagram_ > kSilence;
  if ((!anew && !silent) || !fetch_.due(monotonic_now())) return;
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
  reinitialized_.fetch_add(1, std::memory_order_relaxed);
  port.move_to(port_of(*m));
}

void OusterSource::run_file() {
  pthread_setname_np(pthread_self(), "ouster-file");
  const auto take_one = [this](Bytes datagram, BenchTime due) {
    take(datagram, due);
    publish();
  };
  if (feed_->play(origin(), deadline_, take_one)) end_of_file();
}

void OusterSource::end_of_file() {
  if (frames_) frames_->finish(hand());
  if (feed_->broken()) health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
  health_.connected.store(false, std::memory_order_release);
  publish();
}

void OusterSource::complete_until(BenchTime now) {
  if (!feed_) return;
  // On until a sample is there that is not released yet: what is released later was captured later.
  const auto more = [&] { return !handed_past(now); };
  if (feed_->play_while(more, t0_, [this](Bytes d, BenchTime t) { take(d, t); })) end_of_file();
  publish();
}

}  // namespace rigor::ouster
