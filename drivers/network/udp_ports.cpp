#include "drivers/network/udp_ports.h"

#include <poll.h>

#include <cerrno>
#include <vector>

#include "sensor-hal/channel/backoff.h"

namespace rigor::network {

void serve_ports(std::span<UdpPort> ports, Deadline& deadline,
                 const std::function<void(const EpochPair&)>& epoch, const std::function<void()>& turn) {
  constexpr Duration kEpochEvery = seconds(1);
  EpochPair pair = read_epoch();
  epoch(pair);
  BenchTime t_epoch = bench_now();
  Backoff backoff;
  std::vector<pollfd> fds;
  while (true) {
    if (const MonotonicTime now = monotonic_now(); backoff.due(now)) {
      bool all = true;
      for (UdpPort& p : ports)
        if (p.receiver->fd() < 0 && !p.open()) all = false;
      if (all)
        backoff.reset();
      else
        backoff.failed(now);
    }
    fds.assign(1, {deadline.cut_fd(), POLLIN, 0});
    for (const UdpPort& p : ports) fds.push_back({p.receiver->fd(), POLLIN, 0});
    (void)::poll(fds.data(), fds.size(), 100);  // a descriptor below 0 is passed over
    if (fds[0].revents != 0) return;
    if (bench_now() - t_epoch > kEpochEvery) {
      pair = read_epoch();
      epoch(pair);
      t_epoch = bench_now();
    }
    for (std::size_t i = 0; i < ports.size(); ++i) {
      UdpReceiver& r = *ports[i].receiver;
      const short events = fds[i + 1].revents;
      if ((events & (POLLERR | POLLNVAL)) != 0) {
        int error = 0;
        socklen_t length = sizeof error;
        (void)getsockopt(r.fd(), SOL_SOCKET, SO_ERROR, &error, &length);
        if (error != 0) r.close();
      } else if ((events & POLLIN) != 0) {
        // A stream that never pauses must not keep this thread from its end.
        for (int batches = 0; batches < 64; ++batches) {
          const auto batch = r.receive(pair);
          ports[i].take(batch);
          if (batch.size() < UdpReceiver::kBatch) break;
        }
      }
    }
    turn();
  }
}

}  // namespace rigor::network
