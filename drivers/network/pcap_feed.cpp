#include "drivers/network/pcap_feed.h"

namespace rigor::network {

Result<PcapFeed> PcapFeed::open(const std::filesystem::path& file, Wanted wanted) {
  auto reader = PcapReader::open(file);
  if (!reader) return tl::unexpected<Error>(reader.error());
  while (true) {
    auto record = reader->next();
    if (!record || !*record)
      return fail(ErrorCode::bad_input, file.string(),
                  "expected packets of the device, found none; `rigor inspect` says what is in it");
    if (!(*record)->udp || !wanted(*(*record)->udp)) continue;
    const RealtimeTime first = (*record)->t;
    auto again = PcapReader::open(file);
    if (!again) return tl::unexpected<Error>(again.error());
    PcapFeed feed(std::move(*again), std::move(wanted));
    feed.first_ = first;
    return feed;
  }
}

std::optional<PcapFeed::Item> PcapFeed::next(BenchTime t0) {
  while (!ended_) {
    auto record = reader_.next();
    if (!record || !*record) {
      broken_ = !record;
      ended_ = true;
      break;
    }
    if ((*record)->udp && wanted_(*(*record)->udp))
      return Item{t0 + ((*record)->t - first_), *(*record)->udp};
  }
  return {};
}

bool PcapFeed::play(const RunOrigin& origin, Deadline& deadline, const Take& take) {
  const auto t0 = origin.wait(deadline);
  if (!t0) return false;
  while (const auto item = next(*t0)) {
    if (!deadline.wait_until(MonotonicTime(item->due.ns()))) return false;
    take(item->datagram.payload, item->due);
  }
  return true;
}

bool PcapFeed::play_while(const std::function<bool()>& more, BenchTime t0, const Take& take) {
  if (ended_) return false;
  while (more()) {
    const auto item = next(t0);
    if (!item) return true;
    take(item->datagram.payload, item->due);
  }
  return false;
}

}  // namespace rigor::network
