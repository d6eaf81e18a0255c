#include "drivers/sick/scan_receiver.h"

#include <algorithm>

namespace rigor::sick {

ScanSequence::Step ScanSequence::step(std::uint16_t scan_counter, std::uint16_t interval, BenchTime t_capture,
                                      Duration period) noexcept {
  Step s;
  if (any_) {
    std::int64_t ahead = 1;
    const auto scans = static_cast<std::uint16_t>(scan_counter - counter_);
    if (by_time_ && period.ns() > 0) {
      ahead = ((t_capture - last_).ns() + period.ns() / 2) / period.ns();
    } else {
      ahead = scans / std::max<std::uint16_t>(interval, 1);
    }
    ahead = std::max<std::int64_t>(ahead, 1);
    sequence_ += static_cast<std::uint64_t>(ahead);
    s.lost = static_cast<std::uint64_t>(ahead - 1);
  }
  any_ = true;
  by_time_ = false;
  counter_ = scan_counter;
  last_ = t_capture;
  s.sequence = sequence_;
  return s;
}

}  // namespace rigor::sick
