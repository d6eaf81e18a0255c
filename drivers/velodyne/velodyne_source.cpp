#include "drivers/velodyne/velodyne_source.h"

#include <poll.h>
#include <pthread.h>

#include "drivers/network/udp_ports.h"

namespace rigor::velodyne {
namespace {

constexpr Duration kListen = seconds(2);

}  // namespace

VelodyneSource::~VelodyneSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

Status VelodyneSource::do_configure(const ChannelConfig& config) {
  settings_ = read_source_settings(config);
  describe_clouds(settings_, description_);
  device_ipv4_ = packet_lidar::ipv4_of(settings_.from);
  return {};
}

Status VelodyneSource::open_clouds_of(std::uint8_t product, const ModelEvidence& evidence, Feed feed) {
  const auto model = decide_model(settings_, product, evidence, warnings_);
  if (!model) return fail(model.error().code, config().name, model.error().message);
  auto stream = open_model(settings_, *model);
  if (!stream) return tl::unexpected<Error>(stream.error());
  stream_ = std::move(*stream);
  counted_ = {};
  counters_.store({});
  open_clouds(settings_.buffers, settings_.stream.max_points, feed);
  return {};
}

Status VelodyneSource::arm_network() {
  if (auto s = data_.open(settings_.address, settings_.port, settings_.socket_buffer_bytes); !s) return s;
  warn_of_small_buffer(data_.buffer_bytes(), settings_.socket_buffer_bytes);
  if (settings_.position_port != 0)
    if (auto s = position_.open(settings_.address, settings_.position_port, 65536); !s)
      warnings_.push_back("position packets are not listened to: " + s.error().text());
  // Which model it is, and that it is there.
  const BenchTime until = bench_now() + kListen;
  ModelEvidence evidence;
  std::uint64_t packets = 0, broken = 0;
  std::uint8_t product = 0;
  PacketFault last_fault = PacketFault::none;
  while (bench_now() < until && !evidence.model() && packets < 100) {
    pollfd p{data_.fd(), POLLIN, 0};
    (void)::poll(&p, 1, 50);
    for (const auto& d : data_.receive(read_epoch())) {
      if (device_ipv4_ != 0 && d.source_ipv4 != device_ipv4_) continue;
      PacketFault fault{};
      if (const auto packet = DataPacket::parse(d.bytes, fault)) {
        evidence.add(*packet);
        product = packet->product();
        ++packets;
      } else {
        ++broken;
        last_fault = fault;
      }
    }
  }
  if (packets == 0)
    return fail(
        ErrorCode::unavailable, config().name,
        "expected packets of a Velodyne at " + settings_.address + ":" + std::to_string(settings_.port) +
            (settings_.from.empty() ? "" : " from " + settings_.from) + ", got " +
            (broken > 0
                 ? std::to_string(broken) + " of something else (" + std::string(text_of(last_fault)) + ")"
                 : "none in 2 s; check the cable and the device's destination address, and that "
                   "`address` is this machine's (0.0.0.0 takes broadcasts)"));
  if (auto s = open_clouds_of(product, evidence, Feed::live); !s) return s;
  set_epoch(read_epoch());
  begin_listening();
  thread_ = std::thread([this] { run_network(); });
  return {};
}

Status VelodyneSource::arm_file(Feed feed) {
  auto reader = network::PcapReader::open(settings_.file);
  if (!reader) return tl::unexpected<Error>(reader.error());
  ModelEvidence evidence;
  std::uint8_t product = 0;
  std::uint64_t packets = 0;
  while (packets < 1000) {
    auto record = reader->next();
    if (!record || !*record) break;
    PacketFault fault{};
    if (!(*record)->udp) continue;
    if (const auto packet = DataPacket::parse((*record)->udp->payload, fault)) {
      ++packets;
      evidence.add(*packet);
      product = packet->product();
    }
  }
  if (packets == 0)
    return fail(ErrorCode::bad_input, config().name,
                settings_.file.string() +
                    ": expected packets of a Velodyne, found none; `rigor inspect` says what is in it");
  const auto wanted = [](const network::UdpDatagram& d) { return d.payload.size() == kDataBytes; };
  if (auto s = open_recording(settings_.file, wanted); !s) return s;
  return open_clouds_of(product, evidence, feed);
}

void VelodyneSource::take(Bytes datagram, BenchTime arrival) {
  stream_->take(datagram, arrival, hand());
  count_malformed(stream_->counters().malformed);
}

void VelodyneSource::publish() {
  Counters c = counted_;
  const CloudStream::Counters& of = stream_->counters();
  c.packets = of.packets, c.packets_lost = of.packets_lost, c.clock_steps = of.clock_steps;
  c.full_turns = of.full_turns;
  c.kernel_drops = data_.dropped();
  c.foreign = foreign();
  counters_.store(c);
}

void VelodyneSource::receive_position(std::span<const network::UdpReceiver::Datagram> batch) {
  for (const auto& d : batch) {
    if (device_ipv4_ != 0 && d.source_ipv4 != device_ipv4_) continue;
    const auto p = parse_position(d.bytes);
    if (!p) {
      health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
      continue;
    }
    ++counted_.position_packets;
    counted_.pps = p->pps;
  }
  publish();
}

void VelodyneSource::run_network() {
  pthread_setname_np(pthread_self(), "velodyne");
  std::vector<network::UdpPort> ports{{&data_, settings_.address, settings_.port,
                                       settings_.socket_buffer_bytes, network::kMtu,
                                       [this](auto batch) { receive(batch); }}};
  // A position port that could not be had at arm was warned of, and is left alone.
  if (position_.fd() >= 0)
    ports.push_back({&position_, settings_.address, settings_.position_port, 65536, network::kMtu,
                     [this](auto batch) { receive_position(batch); }});
  network::serve_ports(
      ports, deadline_, [this](const EpochPair& epoch) { set_epoch(epoch); },
      [this] { (void)watch_silence(); });
}

}  // namespace rigor::velodyne
