#include "drivers/can/can_socket.h"

#include <linux/can.h>
#include <linux/can/bcm.h>
#include <linux/can/error.h>
#include <linux/can/isotp.h>
#include <linux/can/raw.h>
#include <linux/errqueue.h>
#include <linux/net_tstamp.h>
#include <linux/sock_diag.h>
#include <net/if.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "drivers/can/can_interfaces.h"

namespace rigor::can {
namespace {

Status no_can(const std::string& interface, int error, const char* module) {
  if (error == EAFNOSUPPORT || error == EPROTONOSUPPORT || error == ESOCKTNOSUPPORT)
    return fail(ErrorCode::unavailable, interface,
                std::string("this kernel has no ") + (error == EAFNOSUPPORT ? "CAN" : module) + " (" +
                    std::strerror(error) + "): sudo modprobe " +
                    (error == EAFNOSUPPORT ? "can-raw" : module) + ", or use a kernel that has it");
  return fail(ErrorCode::io, interface, std::string("cannot make a CAN socket: ") + std::strerror(error));
}

Result<int> index_of(const std::string& interface) {
  if (const auto index = ::if_nametoindex(interface.c_str())) return static_cast<int>(index);
  auto found = find_interface(interface);  // for its message
  if (!found) return tl::unexpected<Error>(found.error());
  return fail(ErrorCode::not_found, interface, "expected a CAN interface, found none");
}

canid_t id_of(const CanFrame& f) noexcept {
  if (f.error) return (f.id & CAN_ERR_MASK) | CAN_ERR_FLAG;
  return (f.extended ? (f.id & CAN_EFF_MASK) | CAN_EFF_FLAG : f.id & CAN_SFF_MASK) |
         (f.remote ? CAN_RTR_FLAG : 0);
}

/// Bytes to write: the size tells the kernel which kind of frame it is.
std::size_t to_kernel(const CanFrame& f, canfd_frame& out) noexcept {
  out = {};
  out.can_id = id_of(f);
  out.len = static_cast<std::uint8_t>(std::min<int>(f.length, f.fd ? CANFD_MAX_DLEN : CAN_MAX_DLEN));
  if (f.fd) out.flags = f.bit_rate_switch ? CANFD_BRS : 0;
  if (!f.remote) std::memcpy(out.data, f.data.data(), out.len);
  return f.fd ? CANFD_MTU : CAN_MTU;
}

void from_kernel(const canfd_frame& in, bool fd, ReceivedFrame& out) noexcept {
  CanFrame& f = out.frame;
  f = {};
  f.error = (in.can_id & CAN_ERR_FLAG) != 0;
  f.extended = !f.error && (in.can_id & CAN_EFF_FLAG) != 0;
  f.remote = !f.error && (in.can_id & CAN_RTR_FLAG) != 0;
  f.id = in.can_id & (f.error || f.extended ? CAN_EFF_MASK : CAN_SFF_MASK);
  f.fd = fd;
  f.length = static_cast<std::uint8_t>(std::min<int>(in.len, fd ? CANFD_MAX_DLEN : CAN_MAX_DLEN));
  f.bit_rate_switch = fd && (in.flags & CANFD_BRS) != 0;
  out.fd_flags = fd ? in.flags : 0;
  if (!f.remote) std::memcpy(f.data.data(), in.data, f.length);
}

int error_of(int fd) noexcept {
  int error = 0;
  socklen_t size = sizeof error;
  if (::getsockopt(fd, SOL_SOCKET, SO_ERROR, &error, &size) != 0) return -errno;
  return -error;
}

Status cannot(const std::string& interface, const char* what) {
  return fail(ErrorCode::io, interface, std::string("cannot ") + what + ": " + std::strerror(errno));
}

}  // namespace

Status RawSocket::open(const std::string& interface, const RawOptions& o) {
  FileDescriptor h(::socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW));
  if (!h.is_open()) return no_can(interface, errno, "can-raw");
  const auto index = index_of(interface);
  if (!index) return tl::unexpected<Error>(index.error());
  const int on = 1;
  const auto set = [&](int level, int name, const void* value, std::size_t size) {
    return ::setsockopt(h.get(), level, name, value, static_cast<socklen_t>(size)) == 0;
  };
  if (!o.receive) {
    if (!set(SOL_CAN_RAW, CAN_RAW_FILTER, nullptr, 0)) return cannot(interface, "set the receive filters");
  } else if (!o.filters.empty()) {
    std::vector<can_filter> filters;
    for (const auto& f : o.filters) {
      // The mask holds the flag of the format, so that 0x100 of 11 bits is not 0x100 of 29; remote requests
      // pass.
      const canid_t format = f.extended ? CAN_EFF_FLAG : 0;
      filters.push_back({f.id | format, f.mask | CAN_EFF_FLAG});
    }
    if (!set(SOL_CAN_RAW, CAN_RAW_FILTER, filters.data(), filters.size() * sizeof(can_filter)))
      return cannot(interface, "set the receive filters");
  }
  if (o.errors) {
    const can_err_mask_t all = CAN_ERR_MASK;
    if (!set(SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &all, sizeof all))
      return cannot(interface, "ask for error frames");
  }
  if (o.fd && !set(SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on))
    return cannot(interface, "ask for CAN FD frames; without `fd: true` classic frames are received");
  if (o.receive) {
    // Alone: SO_TIMESTAMPNS would put the instant of reading in the place of a stamp that is missing.
    const int stamps = SOF_TIMESTAMPING_RX_SOFTWARE | SOF_TIMESTAMPING_SOFTWARE |
                       SOF_TIMESTAMPING_RX_HARDWARE | SOF_TIMESTAMPING_RAW_HARDWARE;
    if (!set(SOL_SOCKET, SO_TIMESTAMPING, &stamps, sizeof stamps))
      return cannot(interface, "ask for receive times");
    (void)set(SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on);
    // Beyond rmem_max takes CAP_NET_ADMIN; without it the system's limit holds.
    if (o.receive_buffer_bytes > 0 &&
        !set(SOL_SOCKET, SO_RCVBUFFORCE, &o.receive_buffer_bytes, sizeof o.receive_buffer_bytes))
      (void)set(SOL_SOCKET, SO_RCVBUF, &o.receive_buffer_bytes, sizeof o.receive_buffer_bytes);
  }
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = *index;
  if (::bind(h.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    return cannot(interface, "bind to the interface (is it a CAN interface?)");
  socket_ = std::move(h);
  return {};
}

int RawSocket::receive(std::span<ReceivedFrame> out) noexcept {
  canfd_frame frames[kBatch];
  iovec parts[kBatch];
  mmsghdr messages[kBatch];
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(scm_timestamping)) + CMSG_SPACE(sizeof(std::uint32_t))>
      control[kBatch];
  const auto count = static_cast<unsigned>(std::min(out.size(), kBatch));
  for (unsigned i = 0; i < count; ++i) {
    parts[i] = {&frames[i], sizeof(canfd_frame)};
    messages[i] = {};
    messages[i].msg_hdr.msg_iov = &parts[i];
    messages[i].msg_hdr.msg_iovlen = 1;
    messages[i].msg_hdr.msg_control = control[i].data();
    messages[i].msg_hdr.msg_controllen = control[i].size();
  }
  const int n = ::recvmmsg(socket_.get(), messages, count, MSG_DONTWAIT, nullptr);
  if (n < 0) return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR ? 0 : -errno;
  const BenchTime read(monotonic_now().ns());
  int good = 0;
  for (int i = 0; i < n; ++i) {
    if (messages[i].msg_len != CAN_MTU && messages[i].msg_len != CANFD_MTU) continue;
    auto& r = out[static_cast<std::size_t>(good++)];
    from_kernel(frames[i], messages[i].msg_len == CANFD_MTU, r);
    r.own = (messages[i].msg_hdr.msg_flags & MSG_DONTROUTE) != 0;
    r.stamps = stamps_of(messages[i].msg_hdr);
    r.read = read;
    r.t = r.stamps.kernel.value_or(realtime_now());
  }
  return good;
}

int RawSocket::send(const CanFrame& frame) noexcept {
  canfd_frame out;
  const std::size_t size = to_kernel(frame, out);
  if (::write(socket_.get(), &out, size) == static_cast<ssize_t>(size)) return 0;
  return -errno;
}

int RawSocket::pending_error() noexcept { return error_of(socket_.get()); }

std::uint64_t RawSocket::dropped() const noexcept {
  std::uint32_t info[SK_MEMINFO_VARS] = {};
  socklen_t size = sizeof info;
  if (::getsockopt(socket_.get(), SOL_SOCKET, SO_MEMINFO, info, &size) != 0) return 0;
  return size > SK_MEMINFO_DROPS * sizeof(std::uint32_t) ? info[SK_MEMINFO_DROPS] : 0;
}

// ------------------------------------------------------------------ broadcast manager

Status BroadcastManager::open(const std::string& interface) {
  FileDescriptor h(::socket(PF_CAN, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_BCM));
  if (!h.is_open()) return no_can(interface, errno, "can-bcm");
  const auto index = index_of(interface);
  if (!index) return tl::unexpected<Error>(index.error());
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = *index;
  if (::connect(h.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    return cannot(interface, "connect the broadcast manager");
  socket_ = std::move(h);
  return {};
}

int BroadcastManager::write(std::uint32_t opcode, std::uint32_t flags, Duration period,
                            const CanFrame& frame) noexcept {
  bcm_msg_head head{};
  head.opcode = opcode;
  head.flags = flags | (frame.fd ? static_cast<std::uint32_t>(CAN_FD_FRAME) : 0u);
  head.ival2.tv_sec = period.ns() / 1'000'000'000;
  head.ival2.tv_usec = period.ns() % 1'000'000'000 / 1000;
  head.can_id = id_of(frame);
  head.nframes = 1;
  canfd_frame out;
  iovec parts[2] = {{&head, sizeof head}, {&out, to_kernel(frame, out)}};
  msghdr message{};
  message.msg_iov = parts;
  message.msg_iovlen = 2;
  const auto all = static_cast<ssize_t>(parts[0].iov_len + parts[1].iov_len);
  if (::sendmsg(socket_.get(), &message, 0) == all) return 0;
  return -errno;
}

int BroadcastManager::start(const CanFrame& frame, Duration period) noexcept {
  // With STARTTIMER alone the first frame would leave a period later.
  return write(TX_SETUP, SETTIMER | STARTTIMER | TX_ANNOUNCE, period, frame);
}
int BroadcastManager::update(const CanFrame& frame, bool announce) noexcept {
  return write(TX_SETUP, announce ? TX_ANNOUNCE : 0, {}, frame);
}
int BroadcastManager::send_once(const CanFrame& frame) noexcept { return write(TX_SEND, 0, {}, frame); }

int BroadcastManager::pending_error() noexcept { return error_of(socket_.get()); }

// ------------------------------------------------------------------ ISO-TP

Status IsoTpSocket::open(const std::string& interface, const Options& o) {
  FileDescriptor h(::socket(PF_CAN, SOCK_DGRAM | SOCK_CLOEXEC, CAN_ISOTP));
  if (!h.is_open()) return no_can(interface, errno, "can-isotp");
  const auto index = index_of(interface);
  if (!index) return tl::unexpected<Error>(index.error());
  can_isotp_options options{};
  options.flags = CAN_ISOTP_WAIT_TX_DONE;
  if (o.padding) {
    options.flags |= CAN_ISOTP_TX_PADDING;
    options.txpad_content = *o.padding;
  }
  if (o.extended_address) {
    options.flags |= CAN_ISOTP_EXTEND_ADDR;
    options.ext_address = *o.extended_address;
  }
  can_isotp_fc_options flow{};
  flow.bs = o.block_size;
  flow.stmin = o.separation;
  can_isotp_ll_options link{};
  link.mtu = o.fd ? CANFD_MTU : CAN_MTU;
  link.tx_dl = o.fd ? CANFD_MAX_DLEN : CAN_MAX_DLEN;
  link.tx_flags = o.fd ? CANFD_BRS : 0;
  const auto set = [&](int name, const void* value, std::size_t size) {
    return ::setsockopt(h.get(), SOL_CAN_ISOTP, name, value, static_cast<socklen_t>(size)) == 0;
  };
  if (!set(CAN_ISOTP_OPTS, &options, sizeof options) || !set(CAN_ISOTP_RECV_FC, &flow, sizeof flow) ||
      !set(CAN_ISOTP_LL_OPTS, &link, sizeof link))
    return cannot(interface, "set the options of ISO-TP");
  const auto id = [&](std::uint32_t value) -> canid_t { return o.extended ? value | CAN_EFF_FLAG : value; };
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = *index;
  address.can_addr.tp.tx_id = id(o.tx_id);
  address.can_addr.tp.rx_id = id(o.rx_id);
  if (::bind(h.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    return cannot(interface, "bind ISO-TP to the interface");
  socket_ = std::move(h);
  interface_ = interface;
  return {};
}

namespace {

Error isotp_error(const std::string& interface, int error, const char* what) {
  const auto code = error == ETIMEDOUT || error == ECOMM                       ? ErrorCode::timeout
                    : error == EBADMSG || error == EILSEQ || error == EMSGSIZE ? ErrorCode::protocol
                                                                               : ErrorCode::io;
  return {code, interface, std::string(what) + ": " + std::strerror(error)};
}

}  // namespace

Status IsoTpSocket::send(std::span<const std::uint8_t> message) {
  const auto n = ::write(socket_.get(), message.data(), message.size());
  if (n == static_cast<ssize_t>(message.size())) return {};
  return tl::unexpected<Error>(
      isotp_error(interface_, n < 0 ? errno : EIO, "the ISO-TP message was not taken"));
}

Result<std::vector<std::uint8_t>> IsoTpSocket::receive(Duration timeout) {
  pollfd wait{socket_.get(), POLLIN, 0};
  const int ready = ::poll(&wait, 1, static_cast<int>(timeout.ns() / 1'000'000));
  if (ready == 0) return fail(ErrorCode::timeout, interface_, "no ISO-TP message came");
  std::vector<std::uint8_t> out(1u << 16);
  const auto n = ::recv(socket_.get(), out.data(), out.size(), MSG_DONTWAIT);
  if (n < 0) return tl::unexpected<Error>(isotp_error(interface_, errno, "the ISO-TP message broke off"));
  out.resize(static_cast<std::size_t>(n));
  return out;
}

Result<std::vector<std::uint8_t>> IsoTpSocket::request(std::span<const std::uint8_t> message,
                                                       Duration timeout) {
  if (auto s = send(message); !s) return tl::unexpected<Error>(s.error());
  return receive(timeout);
}

}  // namespace rigor::can
