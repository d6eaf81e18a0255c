#include "drivers/livox/command_client.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include "drivers/network/udp_frame.h"
#include "rt-core/byte_order.h"

namespace rigor::livox {
namespace {

constexpr Duration kAgain = milliseconds(200);

std::string hex(Key key) {
  constexpr char kDigits[] = "0123456789ABCDEF";
  const auto v = static_cast<std::uint16_t>(key);
  std::string s = "0x";
  for (int shift = 12; shift >= 0; shift -= 4) s += kDigits[v >> shift & 15];
  return s;
}

}  // namespace

Status CommandClient::open(const std::string& host, std::uint16_t port, const std::string& local_address) {
  where_ = host + ":" + std::to_string(port);
  sockaddr_in to{}, local{};
  to.sin_family = local.sin_family = AF_INET;
  to.sin_port = htons(port);
  if (inet_pton(AF_INET, host.c_str(), &to.sin_addr) != 1 ||
      inet_pton(AF_INET, local_address.c_str(), &local.sin_addr) != 1)
    return fail(ErrorCode::bad_input, where_, "expected IPv4 addresses");
  socket_.reset(socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  if (!socket_ || bind(socket_.get(), reinterpret_cast<const sockaddr*>(&local), sizeof local) != 0 ||
      connect(socket_.get(), reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0) {
    const int why = errno;
    close();
    return fail(
        ErrorCode::unavailable, where_,
        std::string("expected a way to this device: ") + std::strerror(why) + "; `ip route` lists them");
  }
  socklen_t length = sizeof local;
  if (getsockname(socket_.get(), reinterpret_cast<sockaddr*>(&local), &length) == 0)
    local_ipv4_ = ntohl(local.sin_addr.s_addr);
  return {};
}

Result<std::vector<std::uint8_t>> CommandClient::ask(CommandId id, Bytes data, MonotonicTime deadline,
                                                     int cut_fd) {
  const auto request = compose_command({++sequence_, id, false, false, data});
  std::array<std::uint8_t, kMaxCommandBytes + 1> buffer{};
  MonotonicTime send_at = monotonic_now();
  while (monotonic_now() < deadline) {
    if (monotonic_now() >= send_at) {
      // A refusal (ICMP) is of the one before.
      (void)send(socket_.get(), request.data(), request.size(), 0);
      send_at = monotonic_now() + kAgain;
    }
    const Duration wait = std::min(send_at, deadline) - monotonic_now();
    std::array<pollfd, 2> fds{{{socket_.get(), POLLIN, 0}, {cut_fd, POLLIN, 0}}};
    (void)poll(fds.data(), fds.size(),
               static_cast<int>(std::clamp<std::int64_t>(wait.ns() / 1'000'000 + 1, 0, 200)));
    if (fds[1].revents != 0) break;
    for (ssize_t n = 0; (n = recv(socket_.get(), buffer.data(), buffer.size(), 0)) >= 0;) {
      const auto c = parse_command(Bytes(buffer).first(static_cast<std::size_t>(n)));
      if (c && c->answer && c->from_lidar && c->id == id && c->sequence == sequence_)
        return std::vector<std::uint8_t>(c->data.begin(), c->data.end());
    }
  }
  return fail(ErrorCode::not_found, where_,
              "expected a Livox that answers to commands, got no answer; is it switched on, and in the same "
              "network (its own address is in 192.168.1.0/24 unless it was changed)?");
}

Status CommandClient::set(std::span<const Parameter> parameters, MonotonicTime deadline, int cut_fd) {
  const auto answer = ask(CommandId::configure, parameter_data(parameters), deadline, cut_fd);
  if (!answer) return tl::unexpected<Error>(answer.error());
  if (answer->size() != 3)
    return fail(ErrorCode::protocol, where_,
                "expected 3 bytes of an answer to parameters, got " + std::to_string(answer->size()));
  const auto code = static_cast<ReturnCode>((*answer)[0]);
  if (code == ReturnCode::success || code == ReturnCode::reboot_needed) return {};
  return fail(ErrorCode::bad_input, where_,
              "expected the device to take its parameters, it refuses " + hex(load_le<Key>(*answer, 1)) +
                  ": " + std::string(text_of(code)));
}

Result<WorkState> CommandClient::state(MonotonicTime deadline, int cut_fd) {
  std::vector<std::uint8_t> data;
  append_le(data, std::uint16_t{1});
  append_le(data, std::uint16_t{0});
  append_le(data, Key::state);
  const auto answer = ask(CommandId::inquire, data, deadline, cut_fd);
  if (!answer) return tl::unexpected<Error>(answer.error());
  if (answer->size() >= 3 && (*answer)[0] == 0)
    if (const auto list = parse_parameters(Bytes(*answer).subspan(3), load_le<std::uint16_t>(*answer, 1));
        list && list->size() == 1 && (*list)[0].key == Key::state && (*list)[0].value.size() == 1)
      return static_cast<WorkState>((*list)[0].value[0]);
  return fail(ErrorCode::protocol, where_, "expected the device's working state, got another answer");
}

std::vector<FoundLidar> search_lidars(const std::string& to, std::uint16_t port, Duration time) {
  std::vector<FoundLidar> found;
  const FileDescriptor fd(socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  const int on = 1;
  if (!fd || inet_pton(AF_INET, to.c_str(), &address.sin_addr) != 1 ||
      setsockopt(fd.get(), SOL_SOCKET, SO_BROADCAST, &on, sizeof on) != 0)
    return found;
  const auto request = compose_command({1, CommandId::search, false, false, {}});
  if (sendto(fd.get(), request.data(), request.size(), 0, reinterpret_cast<const sockaddr*>(&address),
             sizeof address) < 0)
    return found;
  std::array<std::uint8_t, kMaxCommandBytes + 1> buffer{};
  for (const MonotonicTime until = monotonic_now() + time; monotonic_now() < until && found.size() < 256;) {
    pollfd p{fd.get(), POLLIN, 0};
    (void)poll(&p, 1, 20);
    for (ssize_t n = 0; (n = recv(fd.get(), buffer.data(), buffer.size(), 0)) >= 0;) {
      const auto c = parse_command(Bytes(buffer).first(static_cast<std::size_t>(n)));
      if (!c || !c->answer || c->id != CommandId::search) continue;
      const auto a = parse_search(c->data);
      if (!a || a->code != ReturnCode::success) continue;
      const FoundLidar one{std::string(a->serial), network::text_of_ipv4(a->ipv4), a->device_type,
                           a->command_port};
      // The answer may come twice: to this host, and broadcast.
      if (std::none_of(found.begin(), found.end(),
                       [&](const FoundLidar& f) { return f.serial == one.serial; }))
        found.push_back(one);
    }
  }
  return found;
}

}  // namespace rigor::livox
