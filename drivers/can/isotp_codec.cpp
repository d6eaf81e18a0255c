#include "drivers/can/isotp_codec.h"

#include <algorithm>

#include "drivers/can/can_bits.h"
#include "rt-core/byte_order.h"

namespace rigor::can {
namespace {

std::size_t frame_bytes(const IsoTpOptions& o) noexcept { return o.fd ? 64 : 8; }

/// Bytes that a single frame can carry: its head is one byte up to 7, two beyond.
std::size_t single_bytes(const IsoTpOptions& o) noexcept { return o.fd ? 62 : 7; }

CanFrame make_frame(const IsoTpOptions& o, std::span<const std::uint8_t> head,
                    std::span<const std::uint8_t> data) {
  CanFrame f;
  f.id = o.tx_id;
  f.extended = o.extended;
  f.fd = o.fd;
  const std::size_t used = head.size() + data.size();
  std::copy(head.begin(), head.end(), f.data.begin());
  std::copy(data.begin(), data.end(), f.data.begin() + static_cast<std::ptrdiff_t>(head.size()));
  std::size_t length = o.fd ? fd_length(used) : used;
  if (o.padding) length = std::max<std::size_t>(length, 8);
  // FD frames longer than 8 bytes are filled up to a length that exists; 0xCC is the usual filling.
  std::fill(f.data.begin() + static_cast<std::ptrdiff_t>(used),
            f.data.begin() + static_cast<std::ptrdiff_t>(length), o.padding.value_or(0xcc));
  f.length = static_cast<std::uint8_t>(length);
  return f;
}

bool is_for(const IsoTpOptions& o, const CanFrame& f) noexcept {
  return !f.error && !f.remote && f.id == o.rx_id && f.extended == o.extended && f.length > 0 &&
         f.length <= 64;
}

}  // namespace

Duration separation_time(std::uint8_t st) noexcept {
  if (st <= 0x7f) return milliseconds(st);
  if (st >= 0xf1 && st <= 0xf9) return microseconds(100 * (st - 0xf0));
  return milliseconds(127);
}

bool IsoTpSender::start(std::span<const std::uint8_t> message, BenchTime now) {
  if (phase_ != Phase::idle || message.empty() || message.size() > options_.most_bytes ||
      message.size() > 0xffffffffu)
    return false;
  message_.assign(message.begin(), message.end());
  sent_ = 0;
  waits_ = 0;
  number_ = 1;
  phase_ = Phase::first;
  state_ = IsoTpState::busy;
  due_ = now;
  return true;
}

std::optional<CanFrame> IsoTpSender::next(BenchTime now) {
  const std::span<const std::uint8_t> all(message_);
  if (phase_ == Phase::await_flow && now >= deadline_) {
    phase_ = Phase::idle;
    state_ = IsoTpState::timed_out;
    return {};
  }
  if (now < due_ || (phase_ != Phase::first && phase_ != Phase::consecutive)) return {};
  if (phase_ == Phase::first) {
    const std::size_t n = all.size();
    if (n <= single_bytes(options_)) {
      phase_ = Phase::idle;
      state_ = IsoTpState::done;
      const auto low = static_cast<std::uint8_t>(n);
      if (n <= 7) return make_frame(options_, std::array{low}, all);
      return make_frame(options_, std::array<std::uint8_t, 2>{0, low}, all);
    }
    phase_ = Phase::await_flow;
    deadline_ = now + options_.timeout;
    if (n <= 4095) {
      std::array<std::uint8_t, 2> head{};
      store_be(head, 0, static_cast<std::uint16_t>(0x1000 | n));
      sent_ = frame_bytes(options_) - 2;
      return make_frame(options_, head, all.first(sent_));
    }
    sent_ = frame_bytes(options_) - 6;
    std::array<std::uint8_t, 6> head{0x10, 0};
    store_be(head, 2, static_cast<std::uint32_t>(n));
    return make_frame(options_, head, all.first(sent_));
  }
  const std::size_t part = std::min(all.size() - sent_, frame_bytes(options_) - 1);
  const auto frame =
      make_frame(options_, std::array{static_cast<std::uint8_t>(0x20 | number_)}, all.subspan(sent_, part));
  number_ = static_cast<std::uint8_t>((number_ + 1) & 0xf);
  sent_ += part;
  due_ = now + separation_;
  if (sent_ == all.size()) {
    phase_ = Phase::idle;
    state_ = IsoTpState::done;
  } else if (block_limited_ && --block_left_ == 0) {
    phase_ = Phase::await_flow;
    deadline_ = now + options_.timeout;
  }
  return frame;
}

void IsoTpSender::receive(const CanFrame& f, BenchTime now) {
  if (phase_ != Phase::await_flow || !is_for(options_, f) || f.data[0] >> 4 != 3) return;
  const auto stop = [&](IsoTpState why) {
    phase_ = Phase::idle;
    state_ = why;
  };
  if (f.length < 3) return stop(IsoTpState::wrong_frame);
  switch (f.data[0] & 0xf) {
    case 0:
      block_limited_ = f.data[1] != 0;
      block_left_ = f.data[1];
      separation_ = separation_time(f.data[2]);
      waits_ = 0;
      phase_ = Phase::consecutive;
      due_ = now;
      return;
    case 1:
      if (++waits_ > options_.most_waits) return stop(IsoTpState::timed_out);
      deadline_ = now + options_.timeout;
      return;
    case 2:
      return stop(IsoTpState::overflow);
    default:
      return stop(IsoTpState::wrong_frame);
  }
}

BenchTime IsoTpSender::next_event() const noexcept {
  switch (phase_) {
    case Phase::idle:
      return BenchTime::never();
    case Phase::await_flow:
      return deadline_;
    case Phase::first:
    case Phase::consecutive:
      return due_;
  }
  return BenchTime::never();
}

std::optional<CanFrame> IsoTpReceiver::flow(std::uint8_t status) {
  return make_frame(
      options_,
      std::array{static_cast<std::uint8_t>(0x30 | status), options_.block_size, options_.separation}, {});
}

std::optional<CanFrame> IsoTpReceiver::receive(const CanFrame& f, BenchTime now) {
  if (!is_for(options_, f)) return {};
  const std::span<const std::uint8_t> data(f.data.data(), f.length);
  switch (data[0] >> 4) {
    case 0: {
      std::size_t head = 1, length = data[0] & 0xfu;
      if (length == 0 && data.size() > 8) {  // only frames longer than 8 bytes have the second head
        head = 2;
        length = data[1];
      }
      if (length == 0 || head + length > data.size()) {
        state_ = IsoTpState::wrong_frame;
        return {};
      }
      const auto body = data.subspan(head, length);
      message_.assign(body.begin(), body.end());
      state_ = IsoTpState::done;
      return {};
    }
    case 1: {
      if (data.size() < 8) {
        state_ = IsoTpState::wrong_frame;
        return {};
      }
      std::size_t head = 2;
      length_ = load_be<std::uint16_t>(data) & 0xfffu;
      if (length_ == 0) {
        head = 6;
        length_ = load_be<std::uint32_t>(data, 2);
      }
      if (length_ <= data.size() - head) {  // it would have fitted into a single frame
        state_ = IsoTpState::wrong_frame;
        return {};
      }
      if (length_ > options_.most_bytes) {
        state_ = IsoTpState::overflow;
        return flow(2);
      }
      // Memory grows with what comes: a first frame alone cannot ask for much.
      const auto body = data.subspan(head);
      message_.assign(body.begin(), body.end());
      number_ = 1;
      in_block_ = 0;
      state_ = IsoTpState::busy;
      deadline_ = now + options_.timeout;
      return flow(0);
    }
    case 2: {
      if (state_ != IsoTpState::busy) return {};
      const std::size_t part = std::min(length_ - message_.size(), data.size() - 1);
      if ((data[0] & 0xf) != number_ || part == 0) {
        state_ = IsoTpState::wrong_frame;
        return {};
      }
      const auto body = data.subspan(1, part);
      message_.insert(message_.end(), body.begin(), body.end());
      number_ = static_cast<std::uint8_t>((number_ + 1) & 0xf);
      deadline_ = now + options_.timeout;
      if (message_.size() == length_) {
        state_ = IsoTpState::done;
        return {};
      }
      if (options_.block_size != 0 && ++in_block_ == options_.block_size) {
        in_block_ = 0;
        return flow(0);
      }
      return {};
    }
    default:
      return {};  // flow controls are the sender's
  }
}

void IsoTpReceiver::check(BenchTime now) noexcept {
  if (state_ == IsoTpState::busy && now >= deadline_) state_ = IsoTpState::timed_out;
}

BenchTime IsoTpReceiver::next_event() const noexcept {
  return state_ == IsoTpState::busy ? deadline_ : BenchTime::never();
}

}  // namespace rigor::can
