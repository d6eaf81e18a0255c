// A CAN bus in virtual time, shared by all channels and emulated nodes of one interface.
//
// Whoever is on the bus is a participant: it acts at instants of its own (sends, samples), and is told of
// every frame of the others at the frame's end, which is when a controller raises its interrupt. Frames that
// wait while the bus is busy start together when it is free; the one with the smallest arbitration field
// wins, of equal ones the first that asked. A frame holds the bus for its bits at the bus's rates, stuff bits
// included. So what is seen depends on configuration and commands alone.
//
// At one instant: first a frame ends and is delivered, then commands act, then nodes, then what samples, and
// last the next frame starts. Participants of equal rank act in the order in which they joined.
//
// One thread.
#pragma once

#include <cstdint>
#include <vector>

#include "drivers/can/can_bits.h"
#include "rt-core/time.h"
#include "sensor-hal/types/sample.h"

namespace rigor::can {

class VirtualBus {
 public:
  enum class Rank : std::uint8_t { command, node, sample };
  class Participant {
   public:
    virtual ~Participant() = default;
    /// The instant of the next own action that may happen by `now`; never() when there is none.
    [[nodiscard]] virtual BenchTime next_action(BenchTime now) const noexcept = 0;
    virtual void act(BenchTime t) = 0;
    virtual void receive(const CanFrame& frame, BenchTime t) = 0;
  };

  explicit VirtualBus(const BitRates& rates) : rates_(rates) {}

  void join(Participant* p, Rank rank);
  void leave(const Participant* p);
  /// From `act`: puts a frame to the bus at the present instant. False when 4096 frames of all wait already.
  bool send(const Participant* from, const CanFrame& frame);
  /// Everything that happens by `now`, in order.
  void advance(BenchTime now);

  [[nodiscard]] const BitRates& rates() const noexcept { return rates_; }
  /// What has happened: frames delivered, and time that they took.
  [[nodiscard]] std::uint64_t frames() const noexcept { return frames_; }
  [[nodiscard]] Duration busy() const noexcept { return busy_; }

 private:
  struct Member {
    Participant* participant;
    Rank rank;
  };
  struct Waiting {
    const Participant* from;
    CanFrame frame;
    std::uint64_t order;
  };
  void start_next();
  void deliver();

  BitRates rates_;
  std::vector<Member> members_;  // by rank
  std::vector<Waiting> waiting_;
  Waiting on_bus_{};
  bool is_busy_ = false;
  BenchTime t_, end_;
  std::uint64_t order_ = 0, frames_ = 0;
  Duration busy_;
};

}  // namespace rigor::can
