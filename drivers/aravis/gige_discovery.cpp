#include "drivers/aravis/gige_discovery.h"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstring>

#include "rt-core/file_descriptor.h"

namespace rigor::gige {
namespace {

constexpr std::uint16_t kRequestId = 0x5249;

FileDescriptor udp_socket() {
  return FileDescriptor(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
}

struct LocalInterface {
  std::string name, address;
  in_addr ip{}, broadcast{};
};

std::string text_of(in_addr a) {
  std::array<char, INET_ADDRSTRLEN> text{};
  inet_ntop(AF_INET, &a, text.data(), text.size());
  return text.data();
}

std::vector<LocalInterface> local_interfaces() {
  std::vector<LocalInterface> all;
  ifaddrs* list = nullptr;
  if (getifaddrs(&list) != 0) return all;
  for (const ifaddrs* i = list; i != nullptr; i = i->ifa_next) {
    if (i->ifa_addr == nullptr || i->ifa_addr->sa_family != AF_INET || (i->ifa_flags & IFF_UP) == 0) continue;
    LocalInterface l;
    l.name = i->ifa_name;
    sockaddr_in address{}, mask{};
    std::memcpy(&address, i->ifa_addr, sizeof(address));
    if (i->ifa_netmask != nullptr) std::memcpy(&mask, i->ifa_netmask, sizeof(mask));
    l.ip = address.sin_addr;
    l.broadcast.s_addr = address.sin_addr.s_addr | ~mask.sin_addr.s_addr;
    l.address = text_of(l.ip);
    all.push_back(std::move(l));
  }
  freeifaddrs(list);
  return all;
}

sockaddr_in endpoint(in_addr ip, std::uint16_t port) {
  sockaddr_in a{};
  a.sin_family = AF_INET;
  a.sin_addr = ip;
  a.sin_port = htons(port);
  return a;
}

void send_discovery(const FileDescriptor& s, in_addr to, bool broadcast) {
  const Datagram d = encode_discovery_cmd(kRequestId, broadcast);
  const sockaddr_in a = endpoint(to, kGvcpPort);
  // A lost or refused datagram shows as a camera that does not answer.
  (void)!sendto(s.get(), d.data(), d.size(), MSG_NOSIGNAL, reinterpret_cast<const sockaddr*>(&a), sizeof(a));
}

/// The next answer that waits on the socket.
std::optional<FoundCamera> receive_answer(const FileDescriptor& s, bool& more) {
  std::array<std::uint8_t, 1024> buffer;
  sockaddr_in from{};
  socklen_t length = sizeof(from);
  const ssize_t n =
      recvfrom(s.get(), buffer.data(), buffer.size(), 0, reinterpret_cast<sockaddr*>(&from), &length);
  more = n >= 0;
  if (n <= 0) return std::nullopt;
  GvcpAck ack;
  if (decode_gvcp_ack({buffer.data(), static_cast<std::size_t>(n)}, ack) != DecodeStatus::ok)
    return std::nullopt;
  const auto* identity = std::get_if<DiscoveryAck>(&ack.body);
  if (identity == nullptr || ack.ack_id != kRequestId) return std::nullopt;
  FoundCamera c;
  c.identity = *identity;
  c.address = text_of(from.sin_addr);
  return c;
}

/// The local address from which the kernel would reach `to`.
std::string local_address_towards(in_addr to) {
  const FileDescriptor s = udp_socket();
  const sockaddr_in a = endpoint(to, kGvcpPort);
  sockaddr_in local{};
  socklen_t length = sizeof(local);
  if (s.get() < 0 || connect(s.get(), reinterpret_cast<const sockaddr*>(&a), sizeof(a)) != 0 ||
      getsockname(s.get(), reinterpret_cast<sockaddr*>(&local), &length) != 0)
    return {};
  return text_of(local.sin_addr);
}

}  // namespace

std::string FoundCamera::mac() const {
  std::array<char, 18> text{};
  const auto& m = identity.mac;
  std::snprintf(text.data(), text.size(), "%02x:%02x:%02x:%02x:%02x:%02x", m[0], m[1], m[2], m[3], m[4],
                m[5]);
  return text.data();
}

bool FoundCamera::answers_to(const std::string& selector) const {
  if (selector.empty()) return false;
  std::string lower = selector;
  std::transform(lower.begin(), lower.end(), lower.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return selector == id() || selector == identity.serial || selector == identity.user_name ||
         lower == mac() || selector == address;
}

Result<std::vector<FoundCamera>> find_gige_cameras(const DiscoveryOptions& options) {
  std::vector<LocalInterface> interfaces;
  std::string names;
  for (LocalInterface& l : local_interfaces()) {
    names += (names.empty() ? "" : ", ") + l.name + " (" + l.address + ")";
    if (options.interface.empty() || options.interface == l.name || options.interface == l.address)
      interfaces.push_back(std::move(l));
  }
  if (interfaces.empty() && !options.interface.empty())
    return fail(ErrorCode::not_found, {},
                "expected an interface of this machine that is up, got \"" + options.interface +
                    "\"; there are " + (names.empty() ? "none" : names));

  std::vector<FileDescriptor> sockets;
  std::vector<pollfd> polls;
  for (const LocalInterface& l : interfaces) {
    FileDescriptor s = udp_socket();
    const int on = 1;
    const sockaddr_in local = endpoint(l.ip, 0);
    if (s.get() >= 0) {
      (void)setsockopt(s.get(), SOL_SOCKET, SO_BROADCAST, &on, sizeof(on));
      (void)!bind(s.get(), reinterpret_cast<const sockaddr*>(&local), sizeof(local));
    }
    polls.push_back({s.get(), POLLIN, 0});
    sockets.push_back(std::move(s));
  }
  in_addr everyone{};
  everyone.s_addr = INADDR_BROADCAST;
  const auto ask = [&] {
    for (std::size_t i = 0; i < interfaces.size(); ++i) {
      send_discovery(sockets[i], everyone, true);
      send_discovery(sockets[i], interfaces[i].broadcast, true);
      send_discovery(sockets[i], interfaces[i].ip, false);  // a camera that is emulated on this very address
    }
  };
  ask();
  std::vector<FoundCamera> found;
  const MonotonicTime begin = monotonic_now();
  bool asked_again = false;
  for (;;) {
    const Duration left = begin + options.wait - monotonic_now();
    if (left.ns() <= 0 || (options.cancelled && options.cancelled())) break;
    if (!asked_again && left < options.wait / 2) {
      ask();  // one datagram may get lost
      asked_again = true;
    }
    const auto slice = std::min<std::int64_t>(50, left.ns() / 1'000'000 + 1);
    if (poll(polls.data(), polls.size(), static_cast<int>(slice)) <= 0) continue;
    for (std::size_t i = 0; i < sockets.size(); ++i) {
      bool more = (polls[i].revents & (POLLIN | POLLERR)) != 0;
      while (more) {
        auto c = receive_answer(sockets[i], more);
        if (!c) continue;
        c->local_address = interfaces[i].address;
        c->local_interface = interfaces[i].name;
        const bool known = std::any_of(found.begin(), found.end(), [&](const FoundCamera& f) {
          return f.address == c->address && f.id() == c->id();
        });
        if (!known) found.push_back(std::move(*c));
      }
    }
  }
  std::sort(found.begin(), found.end(), [](const FoundCamera& a, const FoundCamera& b) {
    return std::pair(a.id(), a.address) < std::pair(b.id(), b.address);
  });
  return found;
}

std::optional<FoundCamera> ask_gige_camera(const std::string& address, Duration wait) {
  in_addr to{};
  if (inet_pton(AF_INET, address.c_str(), &to) != 1) return std::nullopt;
  const FileDescriptor s = udp_socket();
  if (s.get() < 0) return std::nullopt;
  send_discovery(s, to, false);
  const MonotonicTime end = monotonic_now() + wait;
  for (;;) {
    const Duration left = end - monotonic_now();
    if (left.ns() <= 0) return std::nullopt;
    pollfd p{s.get(), POLLIN, 0};
    if (poll(&p, 1, static_cast<int>(left.ns() / 1'000'000 + 1)) <= 0) continue;
    bool more = true;
    while (more) {
      auto c = receive_answer(s, more);
      if (!c) continue;
      c->local_address = local_address_towards(to);
      return c;
    }
  }
}

}  // namespace rigor::gige
