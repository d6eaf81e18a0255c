// ISO-TP (ISO 15765-2:2016) without sockets: messages of up to 4095 bytes over classic frames, or 4 GiB in
// the protocol and `most_bytes` here, over classic and FD frames.
//
//   single frame        0L data…            L ≤ 7; of FD frames also 00 LL data…
//   first frame         1L LL data…         L from 8 to 4095; longer ones 10 00 LL LL LL LL data…
//   consecutive frame   2N data…            N = 1, 2, … 15, 0, …
//   flow control        3S BS ST            S: 0 continue, 1 wait, 2 overflow; BS frames to the next flow
//                                           control (0: all), ST: 0–127 ms or F1–F9: 100–900 µs between
//                                           frames
//
// Sender and receiver are state machines that are told of frames and time and say what goes out; the driver's
// IsoTpSocket is the kernel's own (wall clock), these two do for virtual time and for emulated nodes.
// Not done: mixed and extended addressing, the functional kind, changes of the limits by the receiver midway.
//
// One thread. `next`, `receive`: no allocation but the message's own memory.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "rt-core/time.h"
#include "sensor-hal/types/sample.h"

namespace rigor::can {

struct IsoTpOptions {
  std::uint32_t tx_id = 0, rx_id = 0;
  bool extended = false;                ///< identifiers of 29 bits
  bool fd = false;                      ///< frames of up to 64 bytes
  std::uint8_t block_size = 0;          ///< that we ask of the other side
  std::uint8_t separation = 0;          ///< ST that we ask of the other side, as in a flow control
  std::optional<std::uint8_t> padding;  ///< frames are filled up to 8 bytes with it
  Duration timeout = seconds(1);        ///< N_Bs, N_Cr
  unsigned most_waits = 16;             ///< flow controls that ask to wait in a row
  std::size_t most_bytes = 1u << 20;    ///< longer messages are refused with an overflow
};

/// ST of a flow control as a time; reserved values stand for 127 ms (ISO 15765-2, 9.6.5.5).
[[nodiscard]] Duration separation_time(std::uint8_t st) noexcept;

enum class IsoTpState : std::uint8_t {
  idle,
  busy,
  done,
  timed_out,
  overflow,    ///< the receiver has no room
  wrong_frame  ///< out of sequence, or against the format
};

class IsoTpSender {
 public:
  explicit IsoTpSender(const IsoTpOptions& options) : options_(options) {}
  /// Begins a message at `now`. False while one is under way, or when it is empty or too long.
  [[nodiscard]] bool start(std::span<const std::uint8_t> message, BenchTime now);
  /// The frame that is to leave by `now`; empty when it is not yet time, or a flow control is awaited.
  [[nodiscard]] std::optional<CanFrame> next(BenchTime now);
  /// A frame of the receiver's.
  void receive(const CanFrame& frame, BenchTime now);
  /// When `next` has to be asked again; never() when it waits for nothing.
  [[nodiscard]] BenchTime next_event() const noexcept;
  [[nodiscard]] IsoTpState state() const noexcept { return state_; }

 private:
  enum class Phase : std::uint8_t { idle, first, await_flow, consecutive };
  IsoTpOptions options_;
  std::vector<std::uint8_t> message_;
  std::size_t sent_ = 0;
  Phase phase_ = Phase::idle;
  IsoTpState state_ = IsoTpState::idle;
  BenchTime due_, deadline_;
  Duration separation_;
  unsigned block_left_ = 0, waits_ = 0;
  bool block_limited_ = false;
  std::uint8_t number_ = 0;
};

class IsoTpReceiver {
 public:
  explicit IsoTpReceiver(const IsoTpOptions& options) : options_(options) {}
  /// The flow control to send in answer, if any. A single or first frame begins anew, whatever came before.
  [[nodiscard]] std::optional<CanFrame> receive(const CanFrame& frame, BenchTime now);
  /// Ends a message whose next frame did not come.
  void check(BenchTime now) noexcept;
  [[nodiscard]] BenchTime next_event() const noexcept;
  [[nodiscard]] IsoTpState state() const noexcept { return state_; }
  /// Of state done; until the next begins.
  [[nodiscard]] std::span<const std::uint8_t> message() const noexcept { return message_; }

 private:
  std::optional<CanFrame> flow(std::uint8_t status);
  IsoTpOptions options_;
  std::vector<std::uint8_t> message_;
  std::size_t length_ = 0;
  unsigned in_block_ = 0;
  std::uint8_t number_ = 0;
  IsoTpState state_ = IsoTpState::idle;
  BenchTime deadline_;
};

}  // namespace rigor::can
