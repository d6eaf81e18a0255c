#include "drivers/aravis/gige_emulator.h"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#include "rt-core/file_descriptor.h"
#include "rt-core/time_slice.h"

namespace rigor::gige {
namespace {

constexpr std::size_t kBatch = 32;           // packets of one sendmmsg
constexpr std::size_t kMaxQueuedBlocks = 4;  // more than that and the link is too slow for the rate
constexpr std::size_t kMaxQueuedResendPackets = 8192;
constexpr int kSendBuffer = 4 << 20;
constexpr int kEthernetOverhead = 38;  // preamble, header, CRC, gap around an IP packet
constexpr int kHeartbeatCheckMs = 50;
constexpr Duration kCatchUp = microseconds(1000);

sockaddr_in to_sockaddr(Endpoint e) {
  sockaddr_in a{};
  a.sin_family = AF_INET;
  a.sin_addr.s_addr = htonl(e.ip);
  a.sin_port = htons(e.port);
  return a;
}

Endpoint from_sockaddr(const sockaddr_in& a) { return {ntohl(a.sin_addr.s_addr), ntohs(a.sin_port)}; }

Result<FileDescriptor> udp_socket(Endpoint at, bool share) {
  FileDescriptor fd(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  const std::string where = ipv4_text(at.ip) + ":" + std::to_string(at.port);
  if (!fd)
    return fail(ErrorCode::io, where, std::string("cannot make a UDP socket: ") + std::strerror(errno));
  const int on = 1;
  if (share) {
    // Every camera of this machine hears a broadcast.
    setsockopt(fd.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    setsockopt(fd.get(), SOL_SOCKET, SO_BROADCAST, &on, sizeof on);
  }
  const auto a = to_sockaddr(at);
  if (bind(fd.get(), reinterpret_cast<const sockaddr*>(&a), sizeof a) != 0) {
    const int e = errno;
    const char* what = e == EADDRINUSE ? "another camera holds this address; give each its own (127.0.0.2, …)"
                       : e == EADDRNOTAVAIL ? "this machine has no such address"
                                            : std::strerror(e);
    return fail(ErrorCode::unavailable, where,
                std::string("cannot bind the GigE Vision control port: ") + what);
  }
  return fd;
}

/// Mask and broadcast address of the interface whose subnet holds `ip`.
struct Subnet {
  std::uint32_t mask = 0xFFFFFF00;
  std::optional<std::uint32_t> broadcast;
};
Subnet subnet_of(std::uint32_t ip) {
  Subnet out;
  ifaddrs* list = nullptr;
  if (getifaddrs(&list) != 0) return out;
  for (const auto* i = list; i != nullptr; i = i->ifa_next) {
    if (i->ifa_addr == nullptr || i->ifa_addr->sa_family != AF_INET || i->ifa_netmask == nullptr) continue;
    const auto own = from_sockaddr(*reinterpret_cast<const sockaddr_in*>(i->ifa_addr)).ip;
    const auto mask = from_sockaddr(*reinterpret_cast<const sockaddr_in*>(i->ifa_netmask)).ip;
    if (mask == 0 || (own & mask) != (ip & mask)) continue;
    out.mask = mask;
    out.broadcast = ip | ~mask;
    break;
  }
  freeifaddrs(list);
  return out;
}

DeviceTime now() { return DeviceTime(monotonic_now().ns()); }

std::chrono::steady_clock::time_point as_steady(DeviceTime t) {
  return std::chrono::steady_clock::time_point(std::chrono::nanoseconds(t.ns()));
}

}  // namespace

struct GigeEmulator::Impl {
  explicit Impl(GigeDeviceModel m) : model(std::move(m)) {}

  GigeDeviceModel model;
  FillFrame fill;
  double link_bits_per_s = 1e9;
  std::uint16_t port = 0;

  FileDescriptor control, stream, stop_event;
  std::vector<FileDescriptor> discovery;

  // `mutex` guards the model, the queues and, so that a block is let go under it, every shared_ptr to a
  // block.
  mutable std::mutex mutex;
  std::condition_variable frame_due, send_due;
  std::deque<OutgoingBlock> blocks;
  std::deque<ResendJob> resends;
  std::size_t queued_resend_packets = 0;
  bool stopping = false;
  std::uint64_t blocks_dropped = 0, resends_dropped = 0;

  std::atomic<std::uint64_t> frames_sent{0}, packets_sent{0}, bytes_sent{0}, send_errors{0},
      packets_resent{0}, pictures_late{0};
  std::thread control_thread, frame_thread, send_thread;

  // Send thread only.
  struct Batch {
    std::vector<std::uint8_t> bytes;
    std::array<iovec, kBatch> iov{};
    std::array<mmsghdr, kBatch> msg{};
    sockaddr_in to{};
    std::size_t count = 0, stride = 0;
  } batch;
  DeviceTime link_free;

  void control_loop();
  void drain(int fd);
  void answer(int fd, Endpoint from, Bytes datagram);
  void fire_test_packet(const TestPacket& t);
  void frame_loop();
  void send_loop();
  void send_block(const OutgoingBlock& out);
  void serve_resends();
  void queue_packet(std::size_t length, Endpoint to);
  std::size_t flush_batch();
  void pace(std::size_t packets, std::size_t bytes, Duration packet_delay);
  [[nodiscard]] MutableBytes slot() {
    return MutableBytes(batch.bytes).subspan(batch.count * batch.stride, batch.stride);
  }
};

// ---- Control thread
// --------------------------------------------------------------------------------------------

void GigeEmulator::Impl::control_loop() {
  std::vector<pollfd> fds{{stop_event.get(), POLLIN, 0}, {control.get(), POLLIN, 0}};
  for (const auto& d : discovery) fds.push_back({d.get(), POLLIN, 0});
  while (true) {
    const int n = poll(fds.data(), fds.size(), kHeartbeatCheckMs);
    if (n < 0 && errno != EINTR) return;
    if ((fds[0].revents & POLLIN) != 0) return;
    if (n > 0) {
      for (std::size_t i = 1; i < fds.size(); ++i) {
        if ((fds[i].revents & (POLLIN | POLLERR)) != 0) drain(fds[i].fd);
      }
    }
    const std::scoped_lock lock(mutex);
    if (model.expire_heartbeat(now())) frame_due.notify_one();
  }
}

void GigeEmulator::Impl::drain(int fd) {
  std::array<std::uint8_t, 2048> buffer;
  // Bounded, so that a flood on one socket starves neither the heartbeat nor the stop.
  for (int i = 0; i < 64; ++i) {
    sockaddr_in from{};
    socklen_t size = sizeof from;
    const auto got =
        recvfrom(fd, buffer.data(), buffer.size(), MSG_TRUNC, reinterpret_cast<sockaddr*>(&from), &size);
    if (got < 0) return;
    // One byte too many is enough for the length check to fail it.
    const auto length = std::min(static_cast<std::size_t>(got), buffer.size());
    answer(fd, from_sockaddr(from), Bytes(buffer).first(length));
  }
}

void GigeEmulator::Impl::answer(int fd, Endpoint from, Bytes datagram) {
  // On a broadcast address nothing but discovery and actions is for us.
  if (fd != control.get()) {
    if (datagram.size() < kGvcpHeaderSize) return;
    const auto command = static_cast<GvcpCommand>(load_be<std::uint16_t>(datagram, 2));
    if (command != GvcpCommand::discovery_cmd && command != GvcpCommand::action_cmd) return;
  }
  GvcpAnswer a;
  {
    const std::scoped_lock lock(mutex);
    a = model.handle_gvcp(from, datagram, now());
    if (a.schedule_changed) frame_due.notify_one();
    if (a.resend) {
      const std::size_t packets = a.resend->last - a.resend->first + 1;
      if (queued_resend_packets + packets > kMaxQueuedResendPackets) {
        resends_dropped += packets;
      } else {
        queued_resend_packets += packets;
        resends.push_back(std::move(*a.resend));
        send_due.notify_one();
      }
      a.resend.reset();
    }
  }
  if (a.test_packet) fire_test_packet(*a.test_packet);
  if (!a.ack.empty()) {
    const auto to = to_sockaddr(from);
    // A client that asks from an address which cannot be answered is its own problem.
    (void)sendto(control.get(), a.ack.data(), a.ack.size(), MSG_NOSIGNAL,
                 reinterpret_cast<const sockaddr*>(&to), sizeof to);
  }
}

void GigeEmulator::Impl::fire_test_packet(const TestPacket& t) {
  // Its content means nothing; its arrival in one piece does, so it must not be fragmented on the way.
  const std::vector<std::uint8_t> bytes(t.packet_size - kIpUdpHeaderSize);
  const int mode = t.do_not_fragment ? IP_PMTUDISC_DO : IP_PMTUDISC_DONT;
  setsockopt(stream.get(), IPPROTO_IP, IP_MTU_DISCOVER, &mode, sizeof mode);
  const auto to = to_sockaddr(t.to);
  (void)sendto(stream.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL, reinterpret_cast<const sockaddr*>(&to),
               sizeof to);
}

// ---- Frame thread
// ----------------------------------------------------------------------------------------------

void GigeEmulator::Impl::frame_loop() {
  ask_for_time_slice(kLongTimeSlice);
  std::unique_lock lock(mutex);
  while (!stopping) {
    const auto due = model.next_exposure();
    if (due == DeviceTime::never()) {
      frame_due.wait(lock);
      continue;
    }
    if (now() < due) {
      frame_due.wait_until(lock, as_steady(due));
      continue;
    }
    FrameJob job;
    if (!model.begin_frame(now(), job)) continue;
    lock.unlock();
    const bool filled = fill(job.request, job.picture());
    if (filled && now() > job.t_send) pictures_late.fetch_add(1, std::memory_order_relaxed);
    lock.lock();
    auto out = model.finish_frame(std::move(job), filled);
    if (!out) continue;
    if (blocks.size() >= kMaxQueuedBlocks) {
      ++blocks_dropped;  // it stays in memory for resends
      continue;
    }
    blocks.push_back(std::move(*out));
    send_due.notify_one();
  }
}

// ---- Send thread
// -----------------------------------------------------------------------------------------------

void GigeEmulator::Impl::send_loop() {
  std::unique_lock lock(mutex);
  while (!stopping) {
    if (!resends.empty()) {
      lock.unlock();
      serve_resends();
      lock.lock();
      continue;
    }
    if (blocks.empty()) {
      send_due.wait(lock);
      continue;
    }
    if (now() < blocks.front().t_send) {
      send_due.wait_until(lock, as_steady(blocks.front().t_send));
      continue;
    }
    auto out = std::move(blocks.front());
    blocks.pop_front();
    lock.unlock();
    send_block(out);
    frames_sent.fetch_add(1, std::memory_order_relaxed);
    lock.lock();
    out.block.reset();
  }
}

void GigeEmulator::Impl::queue_packet(std::size_t length, Endpoint to) {
  if (length == 0) return;
  batch.to = to_sockaddr(to);
  batch.iov[batch.count] = {batch.bytes.data() + batch.count * batch.stride, length};
  batch.msg[batch.count] = {};
  batch.msg[batch.count].msg_hdr.msg_name = &batch.to;
  batch.msg[batch.count].msg_hdr.msg_namelen = sizeof batch.to;
  batch.msg[batch.count].msg_hdr.msg_iov = &batch.iov[batch.count];
  batch.msg[batch.count].msg_hdr.msg_iovlen = 1;
  ++batch.count;
}

std::size_t GigeEmulator::Impl::flush_batch() {
  std::size_t bytes = 0;
  std::size_t at = 0;
  while (at < batch.count) {
    const int n =
        sendmmsg(stream.get(), batch.msg.data() + at, static_cast<unsigned>(batch.count - at), MSG_NOSIGNAL);
    if (n > 0) {
      for (int i = 0; i < n; ++i) bytes += batch.msg[at + static_cast<std::size_t>(i)].msg_len;
      at += static_cast<std::size_t>(n);
      continue;
    }
    if (errno == EAGAIN || errno == EWOULDBLOCK) {
      pollfd p{stream.get(), POLLOUT, 0};
      if (poll(&p, 1, 20) > 0) continue;
    } else if (errno == EINTR) {
      continue;
    }
    // This packet cannot leave (say, larger than the path allows with do-not-fragment): the next may.
    send_errors.fetch_add(1, std::memory_order_relaxed);
    ++at;
  }
  packets_sent.fetch_add(batch.count, std::memory_order_relaxed);
  bytes_sent.fetch_add(bytes, std::memory_order_relaxed);
  batch.count = 0;
  return bytes;
}

void GigeEmulator::Impl::pace(std::size_t packets, std::size_t bytes, Duration packet_delay) {
  const auto wire_bits = static_cast<double>(bytes + packets * (kIpUdpHeaderSize + kEthernetOverhead)) * 8.0;
  const Duration link = seconds_from(wire_bits / link_bits_per_s);
  const Duration asked = packet_delay * static_cast<std::int64_t>(packets);
  const auto t = now();
  // What a late wake-up lost may be made up, but no burst exceeds what the link carries in that time.
  const auto earliest = t - kCatchUp;
  link_free = (link_free < earliest ? earliest : link_free) + std::max(link, asked);
  // A sleep shorter than the timer's slack only costs; the debt stays on the account.
  if (link_free - t > microseconds(100)) std::this_thread::sleep_until(as_steady(link_free));
}

void GigeEmulator::Impl::send_block(const OutgoingBlock& out) {
  const std::uint32_t count = out.block->packet_count();
  batch.stride = out.block->packet_size;
  batch.bytes.resize(std::max(batch.bytes.size(), batch.stride * kBatch));
  // With a delay between packets asked for, bursts shrink to what the delay spreads over 0.2 ms.
  const auto delay_ns = static_cast<std::size_t>(std::max<std::int64_t>(out.packet_delay.ns(), 1));
  const std::size_t burst = std::clamp<std::size_t>(200'000 / delay_ns, 1, kBatch);
  for (std::uint32_t i = 0; i < count; ++i) {
    queue_packet(out.block->encode_packet(i, slot()), out.to);
    if (batch.count < burst && i + 1 < count) continue;
    const auto packets = batch.count;
    const auto bytes = flush_batch();
    pace(packets, bytes, out.packet_delay);
    serve_resends();
    {
      const std::scoped_lock lock(mutex);
      if (stopping) return;
    }
  }
}

void GigeEmulator::Impl::serve_resends() {
  const std::size_t stride = batch.stride;
  while (true) {
    ResendJob job;
    {
      const std::scoped_lock lock(mutex);
      if (resends.empty() || stopping) break;
      job = std::move(resends.front());
      resends.pop_front();
      queued_resend_packets -= job.last - job.first + 1;
    }
    batch.stride = job.block ? job.block->packet_size : kGvspExtendedHeaderSize;
    batch.bytes.resize(std::max(batch.bytes.size(), batch.stride * kBatch));
    if (!job.block) {
      queue_packet(encode_gvsp_status(GvStatus::packet_unavailable, job.block_id, job.first,
                                      GvspFormat::payload, job.extended_ids, slot()),
                   job.to);
      flush_batch();
      continue;
    }
    for (std::uint32_t i = job.first; i <= job.last; ++i) {
      queue_packet(job.block->encode_packet(i, slot()), job.to);
      if (batch.count < kBatch && i < job.last) continue;
      const auto packets = batch.count;
      packets_resent.fetch_add(packets, std::memory_order_relaxed);
      pace(packets, flush_batch(), Duration());
    }
    const std::scoped_lock lock(mutex);
    job.block.reset();
  }
  batch.stride = stride;
}

// ---- Life
// ------------------------------------------------------------------------------------------------------

GigeEmulator::GigeEmulator() = default;
GigeEmulator::~GigeEmulator() { stop(); }

Result<std::unique_ptr<GigeEmulator>> GigeEmulator::start(const GigeEmulatorOptions& options,
                                                          FillFrame fill) {
  const auto ip = parse_ipv4(options.address);
  if (!ip) {
    return fail(ErrorCode::bad_input, options.address, "expected an IPv4 address such as 127.0.0.1");
  }
  if (!(options.link_bits_per_s >= 1e6)) {
    return fail(ErrorCode::bad_input, options.address, "link_bits_per_s: expected at least 1e6");
  }
  if (!fill)
    return fail(ErrorCode::bad_input, options.address, "expected a function that fills pictures, got none");
  const auto subnet = subnet_of(*ip);
  auto config = options.camera;
  config.ip = *ip;
  config.mask = subnet.mask;
  auto model = GigeDeviceModel::create(config);
  if (!model) return tl::unexpected<Error>(model.error());

  auto impl = std::make_unique<Impl>(std::move(*model));
  impl->fill = std::move(fill);
  impl->link_bits_per_s = options.link_bits_per_s;
  auto control = udp_socket({*ip, options.port}, false);
  if (!control) return tl::unexpected<Error>(control.error());
  impl->control = std::move(*control);
  auto stream = udp_socket({*ip, 0}, false);
  if (!stream) return tl::unexpected<Error>(stream.error());
  impl->stream = std::move(*stream);
  setsockopt(impl->stream.get(), SOL_SOCKET, SO_SNDBUF, &kSendBuffer, sizeof kSendBuffer);
  const auto bound_port = [](const FileDescriptor& fd) {
    sockaddr_in a{};
    socklen_t size = sizeof a;
    getsockname(fd.get(), reinterpret_cast<sockaddr*>(&a), &size);
    return ntohs(a.sin_port);
  };
  impl->port = bound_port(impl->control);
  impl->model.set_stream_source_port(bound_port(impl->stream));
  if (options.answer_broadcasts && options.port != 0) {
    // Best effort: unicast discovery works without.
    for (const std::optional<std::uint32_t> at :
         {subnet.broadcast, std::optional<std::uint32_t>(0xFFFFFFFF)}) {
      if (!at) continue;
      if (auto fd = udp_socket({*at, options.port}, true)) impl->discovery.push_back(std::move(*fd));
    }
  }
  impl->stop_event = FileDescriptor(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!impl->stop_event) return fail(ErrorCode::io, options.address, "cannot make an eventfd");

  std::unique_ptr<GigeEmulator> self(new GigeEmulator);
  self->impl_ = std::move(impl);
  Impl* p = self->impl_.get();
  p->control_thread = std::thread([p] { p->control_loop(); });
  p->frame_thread = std::thread([p] { p->frame_loop(); });
  p->send_thread = std::thread([p] { p->send_loop(); });
  return self;
}

void GigeEmulator::stop() {
  if (!impl_ || !impl_->control_thread.joinable()) return;
  {
    const std::scoped_lock lock(impl_->mutex);
    impl_->stopping = true;
  }
  impl_->frame_due.notify_all();
  impl_->send_due.notify_all();
  const std::uint64_t one = 1;
  (void)!write(impl_->stop_event.get(), &one, sizeof one);
  impl_->control_thread.join();
  impl_->frame_thread.join();
  impl_->send_thread.join();
}

void GigeEmulator::pulse_line(Duration width) {
  const std::scoped_lock lock(impl_->mutex);
  const auto t = now();
  impl_->model.pulse_line(t, t + width);
  impl_->frame_due.notify_one();
}

std::uint16_t GigeEmulator::port() const { return impl_->port; }

GigeEmulatorHealth GigeEmulator::health() const {
  const auto get = [](const std::atomic<std::uint64_t>& a) { return a.load(std::memory_order_relaxed); };
  GigeEmulatorHealth h;
  h.frames_sent = get(impl_->frames_sent);
  h.packets_sent = get(impl_->packets_sent);
  h.bytes_sent = get(impl_->bytes_sent);
  h.send_errors = get(impl_->send_errors);
  h.packets_resent = get(impl_->packets_resent);
  h.pictures_late = get(impl_->pictures_late);
  const std::scoped_lock lock(impl_->mutex);
  const auto& c = impl_->model.counters();
  h.exposures_skipped = c.exposures_skipped;
  h.pictures_missing = c.pictures_missing;
  h.blocks_dropped = impl_->blocks_dropped;
  h.resend_requests = c.resend_requests;
  h.resends_unavailable = c.resend_unavailable;
  h.resends_dropped = impl_->resends_dropped;
  h.line_edges = c.line_edges;
  h.line_missed = c.line_missed;
  h.actions = c.actions, h.actions_late = c.actions_late;
  h.actions_refused = c.actions_refused, h.actions_missed = c.actions_missed;
  h.gvcp_requests = c.gvcp_requests;
  h.malformed = c.malformed;
  h.refused = c.refused;
  h.heartbeat_expired = c.heartbeat_expired;
  h.controlled = impl_->model.controlled();
  h.acquiring = impl_->model.acquiring();
  return h;
}

}  // namespace rigor::gige
