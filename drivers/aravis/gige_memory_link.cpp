#include "drivers/aravis/gige_memory_link.h"

#include <algorithm>
#include <utility>

namespace rigor::gige {
namespace {

std::size_t take(std::deque<Datagram>& queue, MutableBytes out, std::vector<Datagram>* spare) {
  while (!queue.empty()) {
    Datagram d = std::move(queue.front());
    queue.pop_front();
    const std::size_t size = d.size();
    const bool fits = size <= out.size() && size > 0;
    if (fits) std::copy(d.begin(), d.end(), out.begin());
    if (spare != nullptr) spare->push_back(std::move(d));
    if (fits) return size;
  }
  return 0;
}

}  // namespace

GigeMemoryLink::GigeMemoryLink(GigeDeviceModel& model, FillFrame fill, Endpoint client)
    : model_(&model),
      fill_(std::move(fill)),
      control_(client),
      stream_{client.ip, static_cast<std::uint16_t>(client.port + 1)},
      scratch_(kGvspMaxDatagram) {}

Endpoint GigeMemoryLink::stream_endpoint() const { return stream_; }

DeviceTime GigeMemoryLink::next_event() const {
  const auto exposure = model_->next_exposure();
  return blocks_.empty() ? exposure : std::min(exposure, blocks_.front().t_send);
}

void GigeMemoryLink::advance(DeviceTime now) {
  now_ = std::max(now_, now);
  model_->expire_heartbeat(now_);
  for (auto t = next_event(); t <= now_; t = next_event()) {
    if (!blocks_.empty() && blocks_.front().t_send <= t) {
      const auto out = std::move(blocks_.front());
      blocks_.pop_front();
      // To another destination than ours it goes nowhere.
      if (out.to == stream_) transmit(*out.block, 0, out.block->packet_count() - 1);
      continue;
    }
    FrameJob job;
    if (!model_->begin_frame(t, job)) break;
    const bool filled = fill_(job.request, job.picture());
    if (auto out = model_->finish_frame(std::move(job), filled)) blocks_.push_back(std::move(*out));
  }
}

void GigeMemoryLink::transmit(const GvspBlock& block, std::uint32_t first, std::uint32_t last) {
  for (std::uint32_t i = first; i <= last; ++i) deliver(block.encode_packet(i, scratch_));
}

void GigeMemoryLink::deliver(std::size_t length) {
  if (length == 0 || (lose && lose(Bytes(scratch_).first(length)))) return;
  Datagram d;
  if (!spare_.empty()) {
    d = std::move(spare_.back());
    spare_.pop_back();
  }
  d.assign(scratch_.begin(), scratch_.begin() + static_cast<std::ptrdiff_t>(length));
  to_stream_.push_back(std::move(d));
}

void GigeMemoryLink::handle(Endpoint from, Bytes datagram) {
  auto a = model_->handle_gvcp(from, datagram, now_);
  if (!a.ack.empty()) to_control_.push_back(std::move(a.ack));
  if (a.test_packet && a.test_packet->to == stream_) {
    std::fill_n(scratch_.begin(), a.test_packet->packet_size - kIpUdpHeaderSize, std::uint8_t{0});
    deliver(a.test_packet->packet_size - kIpUdpHeaderSize);
  }
  if (!a.resend || a.resend->to != stream_) return;
  const auto& r = *a.resend;
  if (r.block) {
    transmit(*r.block, r.first, r.last);
  } else {
    deliver(encode_gvsp_status(GvStatus::packet_unavailable, r.block_id, r.first, GvspFormat::payload,
                               r.extended_ids, scratch_));
  }
}

void GigeMemoryLink::send_control(Bytes datagram) { handle(control_, datagram); }
void GigeMemoryLink::send_from_stream(Bytes datagram) { handle(stream_, datagram); }
std::size_t GigeMemoryLink::receive_control(MutableBytes out) { return take(to_control_, out, nullptr); }
std::size_t GigeMemoryLink::receive_stream(MutableBytes out) { return take(to_stream_, out, &spare_); }

}  // namespace rigor::gige
