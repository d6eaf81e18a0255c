#include "drivers/velodyne/velodyne_source.h"

#include <arpa/inet.h>
#include <poll.h>
#include <pthread.h>

namespace rigor::velodyne {
namespace {

constexpr Duration kListen = seconds(2), kSilence = seconds(1);

}  // namespace

VelodyneSource::~VelodyneSource() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

VelodyneSource::Counters VelodyneSource::counters() const noexcept {
  const auto get = [](const auto& a) { return a.load(std::memory_order_relaxed); };
  return {get(packets_),   get(packets_lost_), get(kernel_drops_), get(foreign_),
          get(positions_), get(clock_steps_),  get(full_turns_),   static_cast<PpsStatus>(get(pps_))};
}

Status VelodyneSource::do_configure(const ChannelConfig& config) {
  if (auto s = CloudChannel::do_configure(config); !s) return s;
  in_addr from{};
  from_ipv4_ = !settings_.from.empty() && inet_pton(AF_INET, settings_.from.c_str(), &from) == 1
                   ? ntohl(from.s_addr)
                   : 0;
  return {};
}

Status VelodyneSource::do_arm(const ArmContext& context) {
  warnings_.clear();
  for (auto* c :
       {&packets_, &packets_lost_, &kernel_drops_, &foreign_, &positions_, &clock_steps_, &full_turns_})
    *c = 0;
  if (auto s = deadline_.open(); !s) return s;
  deadline_.reset();
  if (!settings_.file.empty()) return arm_file(context.virtual_time);
  auto s = arm_network();
  if (!s) data_.close(), position_.close();
  return s;
}

Status VelodyneSource::arm_network() {
  if (auto s = data_.open(settings_.address, settings_.port, settings_.socket_buffer_bytes); !s)
    return fail(s.error().code, config().name, s.error().text());
  if (data_.buffer_bytes() < settings_.socket_buffer_bytes)
    warnings_.push_back("the kernel grants " + std::to_string(data_.buffer_bytes() / 1024) + " KiB of the " +
                        std::to_string(settings_.socket_buffer_bytes / 1024) +
                        " KiB asked for: `rigor doctor` says how to have more");
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
      if (from_ipv4_ != 0 && d.source_ipv4 != from_ipv4_) continue;
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
  const auto model = decide_model(product, evidence);
  if (!model) return tl::unexpected<Error>(model.error());
  if (auto s = open_model(*model, Feed::live); !s) return s;
  stream_->clock().set_epoch(read_epoch());
  t_last_packet_ = bench_now();
  health_.connected = true;
  thread_ = std::thread([this] { run_network(); });
  return {};
}

Status VelodyneSource::arm_file(bool virtual_time) {
  const auto wanted = [](const network::UdpDatagram& d) { return d.payload.size() == kDataBytes; };
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
  const auto model = decide_model(product, evidence);
  if (!model) return tl::unexpected<Error>(model.error());
  auto feed = network::PcapFeed::open(settings_.file, wanted);
  if (!feed) return tl::unexpected<Error>(feed.error());
  feed_.emplace(std::move(*feed));
  if (auto s = open_model(*model, virtual_time ? Feed::virtual_time : Feed::recording); !s) return s;
  health_.connected = true;
  if (!virtual_time) thread_ = std::thread([this] { run_file(); });
  return {};
}

Status VelodyneSource::do_start(BenchTime t0) {
  t0_ = t0;
  // Of a recording; its thread waits for the origin, which is published after this.
  if (feed_) stream_->clock().set_epoch({t0, feed_->first_stamp(), Duration(0)});
  return {};
}

Status VelodyneSource::do_stop() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  data_.close();
  position_.close();
  feed_.reset();
  close_stream();
  health_.connected = false;
  return {};
}

void VelodyneSource::publish() {
  const CloudStream::Counters& c = stream_->counters();
  packets_.store(c.packets, std::memory_order_relaxed);
  packets_lost_.store(c.packets_lost, std::memory_order_relaxed);
  clock_steps_.store(c.clock_steps, std::memory_order_relaxed);
  full_turns_.store(c.full_turns, std::memory_order_relaxed);
  kernel_drops_.store(data_.dropped(), std::memory_order_relaxed);
}

void VelodyneSource::receive_data(std::span<const network::UdpReceiver::Datagram> batch) {
  for (const auto& d : batch) {
    if (from_ipv4_ != 0 && d.source_ipv4 != from_ipv4_) {
      foreign_.fetch_add(1, std::memory_order_relaxed);
      continue;
    }
    const std::uint64_t before = stream_->counters().packets;
    take(d.bytes, d.arrival);
    if (stream_->counters().packets == before) continue;
    t_last_packet_ = d.arrival;
    if (!health_.connected.load(std::memory_order_relaxed)) {
      health_.connected.store(true, std::memory_order_release);
      health_.reconnects.fetch_add(1, std::memory_order_relaxed);
    }
  }
  publish();
}

void VelodyneSource::receive_position(std::span<const network::UdpReceiver::Datagram> batch) {
  for (const auto& d : batch) {
    if (from_ipv4_ != 0 && d.source_ipv4 != from_ipv4_) continue;
    const auto p = parse_position(d.bytes);
    if (!p) {
      health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
      continue;
    }
    positions_.fetch_add(1, std::memory_order_relaxed);
    pps_.store(static_cast<std::uint8_t>(p->pps), std::memory_order_relaxed);
  }
}

void VelodyneSource::run_network() {
  pthread_setname_np(pthread_self(), "velodyne");
  std::vector<network::UdpPort> ports{{&data_, settings_.address, settings_.port,
                                       settings_.socket_buffer_bytes, network::kMtu,
                                       [this](auto batch) { receive_data(batch); }}};
  // A position port that could not be had at arm was warned of, and is left alone.
  if (position_.fd() >= 0)
    ports.push_back({&position_, settings_.address, settings_.position_port, 65536, network::kMtu,
                     [this](auto batch) { receive_position(batch); }});
  network::serve_ports(
      ports, deadline_, [this](const EpochPair& epoch) { stream_->clock().set_epoch(epoch); },
      [this] {
        if (bench_now() - t_last_packet_ > kSilence)
          health_.connected.store(false, std::memory_order_release);
      });
}

void VelodyneSource::run_file() {
  pthread_setname_np(pthread_self(), "velodyne-file");
  const auto take_one = [this](Bytes datagram, BenchTime due) {
    take(datagram, due);
    publish();
  };
  if (feed_->play(origin(), deadline_, take_one)) end_of_file();
}

void VelodyneSource::end_of_file() {
  if (feed_->broken()) health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
  health_.connected.store(false, std::memory_order_release);
}

void VelodyneSource::complete_until(BenchTime now) {
  if (!feed_) return;
  // On until a cloud is there that is not released yet: what is released later was captured later.
  if (feed_->play_while([&] { return !handed_beyond(now); }, t0_,
                        [this](Bytes d, BenchTime t) { take(d, t); }))
    end_of_file();
  publish();
}

}  // namespace rigor::velodyne
