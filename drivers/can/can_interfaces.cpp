#include "drivers/can/can_interfaces.h"

#include <net/if.h>  // in front of what the kernel has under the same names

#include <linux/can.h>
#include <linux/can/netlink.h>
#include <linux/ethtool.h>
#include <linux/if_arp.h>
#include <linux/if_link.h>
#include <linux/net_tstamp.h>
#include <linux/rtnetlink.h>
#include <linux/sockios.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <span>

#include "rt-core/file_descriptor.h"

namespace rigor::can {
namespace {

/// A netlink request that grows attribute by attribute.
class Request {
 public:
  Request(std::uint16_t type, std::uint16_t flags) : bytes_(NLMSG_LENGTH(sizeof(ifinfomsg)), 0) {
    head().nlmsg_type = type;
    head().nlmsg_flags = static_cast<std::uint16_t>(NLM_F_REQUEST | flags);
    info().ifi_family = AF_UNSPEC;
  }
  [[nodiscard]] ifinfomsg& info() { return *reinterpret_cast<ifinfomsg*>(bytes_.data() + NLMSG_HDRLEN); }
  std::size_t put(std::uint16_t type, const void* data, std::size_t size) {
    const std::size_t at = bytes_.size();
    bytes_.resize(at + RTA_ALIGN(RTA_LENGTH(size)), 0);
    rtattr a{static_cast<std::uint16_t>(RTA_LENGTH(size)), type};
    std::memcpy(bytes_.data() + at, &a, sizeof a);
    if (size != 0) std::memcpy(bytes_.data() + at + RTA_LENGTH(0), data, size);
    return at;
  }
  std::size_t begin(std::uint16_t type) { return put(type, nullptr, 0); }
  void end(std::size_t at) {
    const auto length = static_cast<std::uint16_t>(bytes_.size() - at);
    std::memcpy(bytes_.data() + at, &length, sizeof length);
  }
  [[nodiscard]] std::span<const std::uint8_t> bytes() {
    head().nlmsg_len = static_cast<std::uint32_t>(bytes_.size());
    return bytes_;
  }

 private:
  nlmsghdr& head() { return *reinterpret_cast<nlmsghdr*>(bytes_.data()); }
  std::vector<std::uint8_t> bytes_;
};

/// Calls `see(type, data)` for each attribute of a block.
template <class See>
void attributes(std::span<const std::uint8_t> block, See&& see) {
  while (block.size() >= sizeof(rtattr)) {
    rtattr a;
    std::memcpy(&a, block.data(), sizeof a);
    if (a.rta_len < RTA_LENGTH(0) || a.rta_len > block.size()) return;
    see(static_cast<std::uint16_t>(a.rta_type & 0x3fff),
        block.subspan(RTA_LENGTH(0), a.rta_len - RTA_LENGTH(0)));
    block = block.subspan(std::min<std::size_t>(RTA_ALIGN(a.rta_len), block.size()));
  }
}

std::uint32_t as_u32(std::span<const std::uint8_t> data) {
  std::uint32_t value = 0;
  std::memcpy(&value, data.data(), std::min(data.size(), sizeof value));
  return value;
}
std::string as_text(std::span<const std::uint8_t> data) {
  return {reinterpret_cast<const char*>(data.data()),
          ::strnlen(reinterpret_cast<const char*>(data.data()), data.size())};
}

BusState state_of(std::uint32_t s) {
  switch (s) {
    case CAN_STATE_ERROR_ACTIVE:
      return BusState::error_active;
    case CAN_STATE_ERROR_WARNING:
      return BusState::error_warning;
    case CAN_STATE_ERROR_PASSIVE:
      return BusState::error_passive;
    case CAN_STATE_BUS_OFF:
      return BusState::bus_off;
    case CAN_STATE_STOPPED:
    case CAN_STATE_SLEEPING:
      return BusState::stopped;
    default:
      return BusState::unknown;
  }
}

void read_can(Interface& i, std::span<const std::uint8_t> data) {
  attributes(data, [&](std::uint16_t type, std::span<const std::uint8_t> value) {
    if (type == IFLA_CAN_STATE) i.state = state_of(as_u32(value));
    if (type == IFLA_CAN_RESTART_MS) i.restart_ms = as_u32(value);
    if (type == IFLA_CAN_BITTIMING) i.bitrate = as_u32(value);  // the first member of can_bittiming
    if (type == IFLA_CAN_DATA_BITTIMING) i.data_bitrate = as_u32(value);
  });
}

Error io_error(const std::string& where, int error, const std::string& what) {
  const auto code = error == EPERM || error == EACCES || error == EOPNOTSUPP ? ErrorCode::unavailable
                    : error == ENODEV                                        ? ErrorCode::not_found
                                                                             : ErrorCode::io;
  return {code, where, what + ": " + std::strerror(error)};
}

/// Sends a request and gives every answer but the acknowledgement to `see`.
template <class See>
Status ask(Request& request, const std::string& where, const std::string& what, See&& see) {
  const FileDescriptor fd(::socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC, NETLINK_ROUTE));
  if (!fd) return tl::unexpected<Error>(io_error(where, errno, what));
  const timeval timeout{2, 0};
  (void)::setsockopt(fd.get(), SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof timeout);
  const auto bytes = request.bytes();
  if (::send(fd.get(), bytes.data(), bytes.size(), 0) < 0)
    return tl::unexpected<Error>(io_error(where, errno, what));
  std::vector<std::uint8_t> buffer(1u << 16);
  while (true) {
    const ssize_t n = ::recv(fd.get(), buffer.data(), buffer.size(), 0);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return tl::unexpected<Error>(io_error(where, n < 0 ? errno : EIO, what));
    std::span<const std::uint8_t> left(buffer.data(), static_cast<std::size_t>(n));
    while (left.size() >= NLMSG_HDRLEN) {
      nlmsghdr head;
      std::memcpy(&head, left.data(), sizeof head);
      if (head.nlmsg_len < NLMSG_HDRLEN || head.nlmsg_len > left.size()) break;
      const auto body = left.subspan(NLMSG_HDRLEN, head.nlmsg_len - NLMSG_HDRLEN);
      if (head.nlmsg_type == NLMSG_DONE) return {};
      if (head.nlmsg_type == NLMSG_ERROR) {
        nlmsgerr e{};
        std::memcpy(&e, body.data(), std::min(body.size(), sizeof e));
        if (e.error == 0) return {};
        return tl::unexpected<Error>(io_error(where, -e.error, what));
      }
      see(head.nlmsg_type, body);
      left = left.subspan(std::min<std::size_t>(NLMSG_ALIGN(head.nlmsg_len), left.size()));
    }
  }
}

Status change(Request& request, const std::string& name, const std::string& what) {
  return ask(request, name, what, [](auto, auto) {});
}

/// Whether the driver gives hardware stamps, and they are switched on. CAN drivers have them always on; one
/// that has a switch (SIOCGHWTSTAMP) is left as it is set up.
bool stamps_by_hardware(const std::string& name) {
  const FileDescriptor socket(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  if (!socket || name.size() >= IFNAMSIZ) return false;
  ethtool_ts_info info{};
  info.cmd = ETHTOOL_GET_TS_INFO;
  ifreq r{};
  std::copy(name.begin(), name.end(), r.ifr_name);
  r.ifr_data = reinterpret_cast<char*>(&info);
  constexpr std::uint32_t kNeeded = SOF_TIMESTAMPING_RX_HARDWARE | SOF_TIMESTAMPING_RAW_HARDWARE;
  if (::ioctl(socket.get(), SIOCETHTOOL, &r) != 0 || (info.so_timestamping & kNeeded) != kNeeded)
    return false;
  hwtstamp_config set_up{};
  r.ifr_data = reinterpret_cast<char*>(&set_up);
  return ::ioctl(socket.get(), SIOCGHWTSTAMP, &r) != 0 || set_up.rx_filter != HWTSTAMP_FILTER_NONE;
}

int index_or_none(const std::string& name) { return static_cast<int>(::if_nametoindex(name.c_str())); }

}  // namespace

std::string can_missing() {
  const FileDescriptor socket(::socket(PF_CAN, SOCK_RAW | SOCK_CLOEXEC, CAN_RAW));
  return socket ? std::string() : std::strerror(errno);
}

std::string protocol_missing(int type, int protocol) {
  const FileDescriptor socket(::socket(PF_CAN, type | SOCK_CLOEXEC, protocol));
  return socket ? std::string() : std::strerror(errno);
}

Result<std::vector<Interface>> list_interfaces() {
  std::vector<Interface> out;
  Request request(RTM_GETLINK, NLM_F_DUMP);
  auto status = ask(request, "CAN interfaces", "cannot list the network interfaces",
                    [&](std::uint16_t type, std::span<const std::uint8_t> body) {
                      if (type != RTM_NEWLINK || body.size() < sizeof(ifinfomsg)) return;
                      ifinfomsg info;
                      std::memcpy(&info, body.data(), sizeof info);
                      if (info.ifi_type != ARPHRD_CAN) return;
                      Interface i;
                      i.up = (info.ifi_flags & IFF_UP) != 0;
                      attributes(body.subspan(NLMSG_ALIGN(sizeof info)), [&](std::uint16_t a, auto value) {
                        if (a == IFLA_IFNAME) i.name = as_text(value);
                        if (a == IFLA_MTU) i.fd = as_u32(value) >= CANFD_MTU;
                        if (a != IFLA_LINKINFO) return;
                        std::span<const std::uint8_t> data;
                        attributes(value, [&](std::uint16_t b, auto v) {
                          if (b == IFLA_INFO_KIND) i.kind = as_text(v);
                          if (b == IFLA_INFO_DATA) data = v;
                        });
                        if (i.kind == "can") read_can(i, data);
                      });
                      i.hardware_stamps = stamps_by_hardware(i.name);
                      out.push_back(std::move(i));
                    });
  if (!status) return tl::unexpected<Error>(status.error());
  return out;
}

Result<Interface> find_interface(const std::string& name) {
  auto all = list_interfaces();
  if (!all) return tl::unexpected<Error>(all.error());
  std::string names;
  for (auto& i : *all) {
    if (i.name == name) return std::move(i);
    names += (names.empty() ? "" : ", ") + i.name;
  }
  const bool is_virtual = name.rfind("vcan", 0) == 0;
  return fail(
      ErrorCode::not_found, name,
      "expected a CAN interface, found " + (names.empty() ? std::string("none") : "only " + names) + "; " +
          (is_virtual
               ? "sudo ip link add " + name + " type vcan && sudo ip link set " + name + " up"
               : "check that the adapter is plugged in and its driver loaded, `rigor devices` lists what is "
                 "there; for a bus without hardware: sudo ip link add " +
                     name + " type vcan && sudo ip link set " + name + " up"));
}

Status create_vcan(const std::string& name) {
  Request r(RTM_NEWLINK, NLM_F_CREATE | NLM_F_EXCL | NLM_F_ACK);
  r.put(IFLA_IFNAME, name.c_str(), name.size() + 1);
  const auto info = r.begin(IFLA_LINKINFO);
  r.put(IFLA_INFO_KIND, "vcan", 4);
  r.end(info);
  if (auto s = change(r, name, "cannot make a vcan interface (sudo modprobe vcan; it takes CAP_NET_ADMIN)");
      !s)
    return s;
  return set_up(name, true);
}

Status remove_interface(const std::string& name) {
  Request r(RTM_DELLINK, NLM_F_ACK);
  r.info().ifi_index = index_or_none(name);
  if (r.info().ifi_index == 0)
    return fail(ErrorCode::not_found, name, "expected a network interface, found none");
  return change(r, name, "cannot remove the interface");
}

Status set_up(const std::string& name, bool up) {
  Request r(RTM_NEWLINK, NLM_F_ACK);
  r.info().ifi_index = index_or_none(name);
  if (r.info().ifi_index == 0)
    return fail(ErrorCode::not_found, name, "expected a network interface, found none");
  r.info().ifi_change = IFF_UP;
  r.info().ifi_flags = up ? IFF_UP : 0;
  return change(r, name, up ? "cannot set the interface up" : "cannot set the interface down");
}

Status restart_controller(const std::string& name) {
  Request r(RTM_NEWLINK, NLM_F_ACK);
  r.info().ifi_index = index_or_none(name);
  if (r.info().ifi_index == 0)
    return fail(ErrorCode::not_found, name, "expected a network interface, found none");
  const auto info = r.begin(IFLA_LINKINFO);
  r.put(IFLA_INFO_KIND, "can", 3);
  const auto data = r.begin(IFLA_INFO_DATA);
  const std::uint32_t one = 1;
  r.put(IFLA_CAN_RESTART, &one, sizeof one);
  r.end(data);
  r.end(info);
  return change(r, name, "cannot restart the controller (it takes CAP_NET_ADMIN)");
}

}  // namespace rigor::can
