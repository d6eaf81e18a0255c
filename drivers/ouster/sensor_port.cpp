#include "drivers/ouster/sensor_port.h"

#include <pthread.h>

#include <algorithm>

namespace rigor::ouster {
namespace {

/// Of a datagram: profiles differ in length, and a sensor that is configured anew may send another one.
constexpr std::size_t kMaxDatagram = 65'507;

std::mutex& registry_mutex() {
  static std::mutex mutex;
  return mutex;
}
std::vector<std::weak_ptr<SensorPort>>& registry() {
  static std::vector<std::weak_ptr<SensorPort>> all;
  return all;
}

}  // namespace

SensorPort::SensorPort(std::string address, std::uint16_t port, std::int64_t buffer_bytes) : port_(port) {
  udp_.receiver = &receiver_;
  udp_.address = std::move(address), udp_.port = port, udp_.buffer_bytes = buffer_bytes;
  udp_.max_bytes = kMaxDatagram;
  udp_.take = [this](std::span<const network::UdpReceiver::Datagram> batch) {
    for_clients([&](PortClient& c) { c.on_packets(batch); });
  };
}

template <class F>
void SensorPort::for_clients(F&& f) {
  const std::lock_guard lock(clients_mutex_);
  for (PortClient* c : clients_) f(*c);
}

Result<std::shared_ptr<SensorPort>> SensorPort::join(const std::string& address, std::uint16_t port,
                                                     std::int64_t buffer_bytes, PortClient* client) {
  const std::lock_guard lock(registry_mutex());
  std::shared_ptr<SensorPort> found;
  std::erase_if(registry(), [&](const std::weak_ptr<SensorPort>& known) {
    const auto p = known.lock();
    if (p && p->udp_.address == address && p->port_ == port) found = p;
    return !p;
  });
  if (!found) {
    found.reset(new SensorPort(address, port, buffer_bytes));
    if (auto s = found->open(); !s) return tl::unexpected<Error>(s.error());
    registry().push_back(found);
  }
  client->on_epoch(read_epoch());
  const std::lock_guard clients(found->clients_mutex_);
  found->clients_.push_back(client);
  return found;
}

void SensorPort::leave(PortClient* client) {
  const std::lock_guard lock(clients_mutex_);
  std::erase(clients_, client);
}

Status SensorPort::open() {
  if (auto s = deadline_.open(); !s) return s;
  deadline_.reset();
  if (auto s = udp_.open(); !s) return s;
  port_ = receiver_.port();
  buffer_bytes_ = receiver_.buffer_bytes();
  thread_ = std::thread([this] { run(); });
  return {};
}

SensorPort::~SensorPort() {
  deadline_.cut();
  if (thread_.joinable()) thread_.join();
}

void SensorPort::move_to(std::uint16_t port) {
  if (port == port_) return;
  port_ = port;
  udp_.port = port;
  receiver_.close();  // and is opened again by serve_ports
}

void SensorPort::run() {
  pthread_setname_np(pthread_self(), "ouster");
  network::serve_ports(
      {&udp_, 1}, deadline_,
      [this](const EpochPair& epoch) { for_clients([&](PortClient& c) { c.on_epoch(epoch); }); },
      [this] { for_clients([this](PortClient& c) { c.on_turn(*this); }); });
}

}  // namespace rigor::ouster
