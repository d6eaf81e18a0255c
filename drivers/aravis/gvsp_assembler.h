// From GVSP packets back to frames, on the client's side, with the arrival order, loss, repetition and lies
// that a network has.
//
//   assembler.push(datagram, now);                    // any order
//   for (r : assembler.resends(now)) send(r);         // what is missing and due
//   while (auto* f = assembler.take(now)) use(*f);    // in order of block ids, complete or marked incomplete
//
// Memory is bounded by the options: a leader that announces more than `max_payload_bytes`, or a block beyond
// `max_blocks` in flight, costs a counter and nothing else. A frame is `complete` only when every byte of it
// came from a packet of its own block; an incomplete one says which packets are missing.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <vector>

#include "drivers/aravis/gvsp_codec.h"
#include "rt-core/time.h"

namespace rigor::gige {

struct GvspAssemblerOptions {
  std::uint32_t packet_size = 1400;  ///< as negotiated in SCPS
  std::uint64_t payload_bytes = 0;   ///< PayloadSize at the start of acquisition: sets the packets of a block
  std::size_t max_blocks = 8;        ///< frames in flight
  Duration first_resend_after = milliseconds(1);
  Duration resend_again_after = milliseconds(20);
  Duration give_up_after = milliseconds(200);  ///< without a packet of the block
  std::uint32_t max_resend_packets_per_block = 0xFFFFFFFF;
  bool extended_ids = false;
  /// Of multi-part frames: the bytes of each part, `payload_bytes` in all. Empty: frames are single pictures.
  std::vector<std::uint64_t> part_bytes;
};

struct PacketRange {
  std::uint32_t first = 0, last = 0;  ///< inclusive
  bool operator==(const PacketRange&) const = default;
};

struct AssembledFrame {
  std::uint64_t block_id = 0;
  GvspLeader leader;  ///< zeros where the leader was lost
  bool complete = false;
  std::vector<PacketRange> missing;
  std::vector<std::uint8_t> data;
  DeviceTime t_first_packet, t_last_packet;  ///< arrival, on the clock of `now`
};

struct GvspAssemblerCounters {
  std::uint64_t packets = 0, malformed = 0, duplicates = 0, late = 0, overflow = 0, wrong_packet = 0,
                errors = 0;
  std::uint64_t frames_complete = 0, frames_incomplete = 0, resends_asked = 0;
  std::uint64_t frames_lost = 0;  ///< gaps in the block ids: not one packet came
};

class GvspAssembler {
 public:
  explicit GvspAssembler(const GvspAssemblerOptions& options);

  /// Takes one datagram of the stream. One thread.
  void push(Bytes datagram, DeviceTime now);
  /// Ranges that are missing and due; asks for each again after `resend_again_after`.
  [[nodiscard]] std::vector<PacketResendCmd> resends(DeviceTime now);
  /// The next frame that is complete or given up, oldest block first, or false. Swaps buffers with `out`, so
  /// that a caller that hands the same object in again makes no new allocation.
  [[nodiscard]] bool take(DeviceTime now, AssembledFrame& out);
  /// Gives up what is in flight: those frames come out of take() as incomplete.
  void flush();
  [[nodiscard]] const GvspAssemblerCounters& counters() const { return counters_; }

 private:
  struct Block {
    AssembledFrame frame;
    std::vector<std::uint8_t> received;  // per packet, 0 or 1
    std::vector<DeviceTime> ask_at;
    std::uint32_t count = 0;  // packets that the block has
    std::uint32_t have = 0;
    std::uint32_t highest = 0;
    std::uint32_t asked = 0;
    bool refused = false;  // the device no longer has it
    bool given_up = false;
  };
  [[nodiscard]] Block* find_or_open(std::uint64_t id, DeviceTime now);
  [[nodiscard]] bool has_expected_size(const GvspLeader& leader) const;
  [[nodiscard]] bool take_slice(Block& b, const GvspPacket& p) const;
  void accept(Block& b, const GvspPacket& p, DeviceTime now);
  void finish(Block& b);
  [[nodiscard]] std::uint64_t next_id(std::uint64_t id) const;
  /// Signed distance from b to a in block ids, over the roll from 65535 to 1.
  [[nodiscard]] std::int64_t distance(std::uint64_t a, std::uint64_t b) const;

  GvspAssemblerOptions options_;
  std::size_t slice_ = 0;
  std::deque<Block> blocks_;  // by age
  std::vector<Block> spare_;
  std::uint64_t last_taken_ = 0;  // 0: none yet
  GvspAssemblerCounters counters_;
};

}  // namespace rigor::gige
