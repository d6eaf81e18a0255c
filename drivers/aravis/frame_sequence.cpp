#include "drivers/aravis/frame_sequence.h"

#include <algorithm>
#include <limits>

namespace rigor {

std::uint64_t FrameSequence::gap(std::uint64_t block_id) const noexcept {
  if (!ids_hold_ || block_id == 0) return 0;
  if (block_id > last_id_) {
    // A step over half the 16-bit circle is a frame from the past, which says that the ids began anew.
    const std::uint64_t forward = block_id - last_id_;
    return block_id <= 0xFFFF && forward > 0x8000 ? 0 : forward;
  }
  if (last_id_ > 0xFFFF) return 0;
  const std::uint64_t over_the_end = 0xFFFF - last_id_ + block_id;
  return over_the_end > 0x8000 ? 0 : over_the_end;
}

FrameSequence::Step FrameSequence::step(std::uint64_t block_id, BenchTime t_capture) noexcept {
  Step s;
  if (started_) {
    std::uint64_t forward = gap(block_id);
    if (forward == 0) {
      s.from_time = true;
      const std::int64_t periods =
          period_.ns() > 0 ? (t_capture - t_last_ + period_ / 2) / period_ : std::int64_t{1};
      forward = static_cast<std::uint64_t>(std::max<std::int64_t>(1, periods));
    }
    sequence_ += forward;
    s.lost_before = static_cast<std::uint32_t>(
        std::min<std::uint64_t>(forward - 1, std::numeric_limits<std::uint32_t>::max()));
  }
  started_ = ids_hold_ = true;
  last_id_ = block_id;
  t_last_ = t_capture;
  s.sequence = sequence_;
  return s;
}

}  // namespace rigor
