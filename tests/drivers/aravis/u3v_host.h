// A client of USB3 Vision for tests, on a USB/IP host: registers, and frames from the stream's endpoint as
// Aravis asks for them.
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "drivers/aravis/u3v_codec.h"
#include "drivers/aravis/u3v_registers.h"
#include "drivers/aravis/u3v_usb_device.h"
#include "rt-core/byte_order.h"
#include "tests/drivers/network/usbip_host.h"

namespace rigor::u3v::testing {

inline std::string text_of(const std::vector<std::uint8_t>& bytes) { return {bytes.begin(), bytes.end()}; }
inline std::vector<std::uint8_t> bytes_of(const std::string& text) { return {text.begin(), text.end()}; }

struct TakenFrame {
  Leader leader;
  std::string payload;
  Trailer trailer;
};

class U3vHost {
 public:
  explicit U3vHost(usbip::testing::Host& host) : bus(host) {}

  /// A command's acknowledge, with those before it (PENDING_ACK).
  [[nodiscard]] std::vector<Ack> command(const std::vector<std::uint8_t>& bytes) {
    std::vector<Ack> all;
    const auto out = bus.transfer(kControlOut, static_cast<std::uint32_t>(bytes.size()), text_of(bytes));
    if (!out || out->status != 0) return all;
    do {
      const auto in = bus.transfer(kControlIn, 65536);
      if (!in) return all;
      const auto data = bytes_of(in->data);
      auto ack = decode_ack(data);
      if (!ack) return all;
      all.push_back(std::move(*ack));
    } while (all.back().command == static_cast<std::uint16_t>(Command::pending_ack));
    return all;
  }
  [[nodiscard]] Status status_of(const std::vector<std::uint8_t>& bytes) {
    const auto acks = command(bytes);
    return acks.empty() ? Status::not_implemented : acks.back().status;
  }
  [[nodiscard]] std::vector<std::uint8_t> read_bytes(std::uint64_t address, std::uint16_t count) {
    const auto acks = command(encode_read(++id, address, count));
    return acks.empty() || acks.back().request_id != id ? std::vector<std::uint8_t>() : acks.back().data;
  }
  template <class T = std::uint32_t>
  [[nodiscard]] T read(std::uint64_t address) {
    const auto b = read_bytes(address, sizeof(T));
    return b.size() == sizeof(T) ? load_le<T>(b, 0) : T{};
  }
  template <class T>
  [[nodiscard]] Status write(std::uint64_t address, T value) {
    std::vector<std::uint8_t> b;
    append_le(b, value);
    return status_of(encode_write(++id, address, b));
  }
  [[nodiscard]] Status write(std::uint64_t address, std::uint32_t value) {
    return write<std::uint32_t>(address, value);
  }
  /// Sizes as Aravis sets them: transfers of `size`, the rest rounded up to the alignment.
  [[nodiscard]] Status open_stream(std::uint32_t size = 1 << 20) {
    const auto payload = read<std::uint64_t>(reg::kRequiredPayload);
    const auto up = [](std::uint64_t v) {
      return static_cast<std::uint32_t>((v + reg::kAlignment - 1) / reg::kAlignment * reg::kAlignment);
    };
    for (const auto& [address, value] : std::vector<std::pair<std::uint64_t, std::uint32_t>>{
             {reg::kMaxLeader, reg::kAlignment},
             {reg::kMaxTrailer, reg::kAlignment},
             {reg::kTransferSize, size},
             {reg::kTransferCount, static_cast<std::uint32_t>(payload / size)},
             {reg::kFinalTransfer1, up(payload % size)},
             {reg::kFinalTransfer2, 0}})
      if (const Status s = write(address, value); s != Status::success) return s;
    payload_bytes = payload;
    transfer_bytes = size;
    return write(reg::kStreamControl, reg::kStreamEnable);
  }
  /// Asks for the next frame: leader, payload in transfers, trailer.
  [[nodiscard]] std::optional<TakenFrame> take_frame(Duration wait = seconds(5)) {
    TakenFrame f;
    auto r = bus.take(bus.submit(kStreamIn, reg::kAlignment), wait);
    const auto leader = r ? decode_leader(bytes_of(r->data)) : std::nullopt;
    if (!leader) return std::nullopt;
    f.leader = *leader;
    while (f.payload.size() < payload_bytes) {
      const auto room = std::min<std::uint64_t>(transfer_bytes, payload_bytes - f.payload.size());
      r = bus.take(bus.submit(kStreamIn, static_cast<std::uint32_t>(room)), wait);
      if (!r || r->status != 0) return std::nullopt;
      if (const auto early = decode_trailer(bytes_of(r->data))) {  // the device discarded the rest
        f.trailer = *early;
        return f;
      }
      f.payload += r->data;
    }
    r = bus.take(bus.submit(kStreamIn, reg::kAlignment), wait);
    const auto trailer = r ? decode_trailer(bytes_of(r->data)) : std::nullopt;
    if (!trailer) return std::nullopt;
    f.trailer = *trailer;
    return f;
  }

  usbip::testing::Host& bus;
  std::uint16_t id = 0;
  std::uint64_t payload_bytes = 0;
  std::uint32_t transfer_bytes = 1 << 20;
};

}  // namespace rigor::u3v::testing
