#include "drivers/velodyne/velodyne_source.h"

#include <arpa/inet.h>
#include <poll.h>
#include <pthread.h>

#include <cerrno>

namespace rigor::velodyne {
namespace {

constexpr Duration kListen = seconds(2), kSilence = seconds(1), kEpochEvery = seconds(1);

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
  stop_ = false;
  if (!settings_.file.empty()) return arm_file(context.virtual_time);
  if (context.virtual_time)
    return fail(
        ErrorCode::wrong_state, config().name,
        "a Velodyne on the network knows no virtual time: give the rig an emulator for it (`emulated_by`), "
        "or run with --clock wall");
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
  if (auto s = open_clouds(*model, Feed::live); !s) return s;
  stream_->set_epoch(read_epoch());
  t_last_packet_ = bench_now();
  health_.connected = true;
  thread_ = std::thread([this] { run_network(); });
  return {};
}

Status VelodyneSource::arm_file(bool virtual_time) {
  const auto open = [&]() -> Status {
    auto reader = PcapReader::open(settings_.file);
    if (!reader) return tl::unexpected<Error>(reader.error());
    reader_.emplace(std::move(*reader));
    return {};
  };
  if (auto s = open(); !s) return s;
  ModelEvidence evidence;
  std::uint8_t product = 0;
  std::uint64_t packets = 0;
  while (packets < 1000) {
    auto record = reader_->next();
    if (!record || !*record) break;
    PacketFault fault{};
    if (!(*record)->udp) continue;
    if (const auto packet = DataPacket::parse((*record)->udp->payload, fault)) {
      if (packets++ == 0) first_stamp_ = (*record)->t;
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
  if (auto s = open(); !s) return s;
  if (auto s = open_clouds(*model, virtual_time ? Feed::virtual_time : Feed::recording); !s) return s;
  file_ended_ = false;
  health_.connected = true;
  if (!virtual_time) thread_ = std::thread([this] { run_file(); });
  return {};
}

Status VelodyneSource::do_start(BenchTime t0) {
  t0_ = t0;
  // Of a recording; its thread waits for the origin, which is published after this.
  if (!settings_.file.empty()) stream_->set_epoch({t0, first_stamp_, Duration(0)});
  return {};
}

Status VelodyneSource::do_stop() {
  stop_ = true;
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
  data_.close();
  position_.close();
  reader_.reset();
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

void VelodyneSource::receive_data(const EpochPair& epoch) {
  while (true) {
    const auto batch = data_.receive(epoch);
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
    if (batch.size() < UdpReceiver::kBatch || stop_.load(std::memory_order_relaxed)) return;
  }
}

void VelodyneSource::receive_position(const EpochPair& epoch) {
  for (const auto& d : position_.receive(epoch)) {
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
  EpochPair epoch = read_epoch();
  BenchTime t_epoch = bench_now();
  Backoff backoff;
  while (!stop_.load(std::memory_order_acquire)) {
    if (data_.fd() < 0) {
      const MonotonicTime now = monotonic_now();
      if (backoff.due(now)) {
        if (data_.open(settings_.address, settings_.port, settings_.socket_buffer_bytes))
          backoff.reset();
        else
          backoff.failed(now);
      }
      if (data_.fd() < 0) {
        if (!deadline_.wait_until(monotonic_now() + milliseconds(20))) return;
        continue;
      }
    }
    pollfd p[3] = {{data_.fd(), POLLIN, 0}, {deadline_.cut_fd(), POLLIN, 0}, {position_.fd(), POLLIN, 0}};
    (void)::poll(p, 3, 100);  // a descriptor below 0 is passed over
    if (stop_.load(std::memory_order_acquire)) return;
    const BenchTime now = bench_now();
    if (now - t_epoch > kEpochEvery) {
      epoch = read_epoch();
      stream_->set_epoch(epoch);
      t_epoch = now;
    }
    if ((p[0].revents & (POLLERR | POLLNVAL)) != 0) {
      int error = 0;
      socklen_t length = sizeof error;
      (void)getsockopt(data_.fd(), SOL_SOCKET, SO_ERROR, &error, &length);
      if (error != 0) data_.close();
    } else if ((p[0].revents & POLLIN) != 0) {
      receive_data(epoch);
    }
    if ((p[2].revents & POLLIN) != 0) receive_position(epoch);
    if (bench_now() - t_last_packet_ > kSilence) health_.connected.store(false, std::memory_order_release);
  }
}

/// The next datagram of the recording and when it is due.
bool VelodyneSource::next_of_file(BenchTime t0, BenchTime& due, Bytes& payload) {
  while (!file_ended_) {
    auto record = reader_->next();
    if (!record || !*record) {
      if (!record) health_.protocol_errors.fetch_add(1, std::memory_order_relaxed);
      file_ended_ = true;
      break;
    }
    const auto& udp = (*record)->udp;
    if (!udp || udp->payload.size() != kDataBytes) continue;
    due = t0 + ((*record)->t - first_stamp_);
    payload = udp->payload;
    return true;
  }
  return false;
}

void VelodyneSource::run_file() {
  pthread_setname_np(pthread_self(), "velodyne-file");
  const auto t0 = origin().wait(deadline_);
  if (!t0) return;
  BenchTime due;
  Bytes payload;
  while (next_of_file(*t0, due, payload)) {
    if (!deadline_.wait_until(MonotonicTime(due.ns()))) return;
    take(payload, due);
    publish();
  }
  health_.connected.store(false, std::memory_order_release);
}

void VelodyneSource::complete_until(BenchTime now) {
  if (settings_.file.empty() || !reader_) return;
  // On until a cloud is there that is not released yet: what is released later was captured later.
  while (!file_ended_ && (!any_handed_ || last_release_ <= now)) {
    BenchTime due;
    Bytes payload;
    if (!next_of_file(t0_, due, payload)) {
      health_.connected.store(false, std::memory_order_release);
      break;
    }
    take(payload, due);
  }
  publish();
}

}  // namespace rigor::velodyne
