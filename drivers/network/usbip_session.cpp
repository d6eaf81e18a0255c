#include "drivers/network/usbip_session.h"

#include <algorithm>
#include <cerrno>

#include "rt-core/byte_order.h"

namespace rigor::usbip {
namespace {

Bytes as_bytes(const std::string& text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

}  // namespace

bool Session::receive(std::string& in, std::string& out) {
  const Bytes all = as_bytes(in);
  std::size_t at = 0;
  Taken taken = Taken::more;
  do {
    std::size_t used = 0;
    taken = take(all.subspan(at), used, out);
    at += used;
  } while (taken == Taken::whole);
  in.erase(0, at);
  if (taken == Taken::close) return false;
  pump(out);
  return true;
}

Session::Taken Session::take(Bytes in, std::size_t& used, std::string& out) {
  if (!attached_) return take_operation(in, used, out);
  if (in.size() < kHeaderBytes) return Taken::more;
  const auto h = decode_header(in);
  if (h && h->command == Command::submit) return submit(*h, in, used, out);
  if (!h || h->command != Command::unlink) {
    ++counters_.malformed;
    return Taken::close;
  }
  used = kHeaderBytes;
  unlink(*h, out);
  return Taken::whole;
}

Session::Taken Session::take_operation(Bytes in, std::size_t& used, std::string& out) {
  if (in.size() < kOperationBytes) return Taken::more;
  const Operation o = decode_operation(in);
  if (o.version != kVersion || (o.code != kListRequest && o.code != kImportRequest)) {
    ++counters_.malformed;
    return Taken::close;
  }
  if (o.code == kListRequest) {
    used = kOperationBytes;
    append_operation(out, {kVersion, kListReply, kOk});
    const bool there = device_->plugged();
    append_be(out, std::uint32_t{there ? 1u : 0u});
    if (there) append_device(out, device_->descriptors().exported, true);
    return Taken::whole;
  }
  if (in.size() < kOperationBytes + kBusIdBytes) return Taken::more;
  used = kOperationBytes + kBusIdBytes;
  const ExportedDevice& d = device_->descriptors().exported;
  const bool known =
      decode_bus_id(in.subspan(kOperationBytes, kBusIdBytes)) == d.bus_id && device_->plugged();
  const std::uint32_t status = !known ? kNoDevice : device_->imported() ? kUnavailable : kOk;
  append_operation(out, {kVersion, kImportReply, status});
  if (status != kOk) return Taken::close;
  append_device(out, d, false);
  attached_ = true;
  device_->attach();
  return Taken::whole;
}

Session::Taken Session::submit(const Header& h, Bytes in, std::size_t& used, std::string& out) {
  const std::size_t data = h.in ? 0 : h.length;
  if (data > kMaxOutBytes || h.endpoint > 15 || h.packets != 0) {  // there is no isochronous endpoint
    ++counters_.malformed;
    return Taken::close;
  }
  if (in.size() < kHeaderBytes + data) return Taken::more;
  used = kHeaderBytes + data;
  ++counters_.submits;
  const Bytes payload = in.subspan(kHeaderBytes, data);
  if (h.endpoint == 0) {
    control(h, payload, out);
    return Taken::whole;
  }
  const auto endpoint = static_cast<std::uint8_t>(h.endpoint | (h.in ? 0x80u : 0u));
  if (!h.in) {
    const bool taken = device_->write(endpoint, payload);
    if (!taken) ++counters_.stalls;
    reply(h.sequence, taken ? 0 : -EPIPE, taken ? h.length : 0, out);
    return Taken::whole;
  }
  if (in_flight_ >= kMaxTransfers) {
    ++counters_.malformed;
    return Taken::close;
  }
  waiting_[endpoint].push_back({h.sequence, h.length});
  ++in_flight_;
  return Taken::whole;
}

void Session::control(const Header& h, Bytes data, std::string& out) {
  const SetupPacket setup = decode_setup(h.setup);
  std::string answer;
  const bool done = ((setup.request_type & 0x80) != 0) == h.in && device_->control(setup, data, answer);
  if (!done) {
    ++counters_.stalls;
    return reply(h.sequence, -EPIPE, 0, out);
  }
  if (!h.in) return reply(h.sequence, 0, h.length, out);
  answer.resize(std::min<std::size_t>({answer.size(), setup.length, h.length}));
  reply(h.sequence, 0, static_cast<std::uint32_t>(answer.size()), out);
  out += answer;
}

void Session::unlink(const Header& h, std::string& out) {
  ++counters_.unlinks;
  // A transfer that is not here any more has been answered: its return is on its way, and counts.
  std::int32_t status = 0;
  for (auto& [endpoint, queue] : waiting_) {
    const auto at =
        std::find_if(queue.begin(), queue.end(), [&](const Waiting& w) { return w.sequence == h.unlink; });
    if (at == queue.end()) continue;
    queue.erase(at);
    --in_flight_;
    ++counters_.unlinked;
    status = -ECONNRESET;
    break;
  }
  Header r;
  r.command = Command::unlinked;
  r.sequence = h.sequence;
  r.status = status;
  append_header(out, r);
}

void Session::reply(std::uint32_t sequence, std::int32_t status, std::uint32_t length, std::string& out) {
  Header r;
  r.command = Command::submitted;
  r.sequence = sequence;
  r.status = status;
  r.length = length;
  append_header(out, r);
}

void Session::pump(std::string& out) {
  if (!attached_) return;
  for (auto& [endpoint, queue] : waiting_) {
    while (!queue.empty()) {
      const Waiting w = queue.front();
      const std::size_t at = out.size();
      reply(w.sequence, 0, 0, out);
      const auto read = device_->read(endpoint, std::min<std::size_t>(w.length, kMaxInBytes), out);
      if (read == Device::Read::wait) {
        out.resize(at);
        break;
      }
      if (read == Device::Read::stall) {
        out.resize(at);
        ++counters_.stalls;
        reply(w.sequence, -EPIPE, 0, out);
      } else {
        store_be(out, at + 24, static_cast<std::uint32_t>(out.size() - at - kHeaderBytes));
      }
      queue.pop_front();
      --in_flight_;
    }
  }
}

void Session::end() {
  if (!std::exchange(attached_, false)) return;
  waiting_.clear();
  in_flight_ = 0;
  device_->detach();
}

}  // namespace rigor::usbip
