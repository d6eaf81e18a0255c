// The instant of a CAN frame, from the stamps that the kernel gives with it (SO_TIMESTAMPING;
// Documentation/networking/timestamping.rst).
//
//   hardware  the controller's own clock, when the frame ended on the bus. A ClockMap ties that clock to the
//             bench by the kernel's stamps of the same frames, never by the instants at which they were read
//   kernel    CLOCK_REALTIME in the driver's interrupt
//   arrival   when this program read the frame
//
//   FrameClock clock(StampKind::hardware);
//   const auto placed = clock.place(stamps_of(message), epoch, bench_now());
//   placed.kind                        // what it really is: a frame may lack the stamp that is wanted
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <optional>

#include "rt-core/clock_map.h"
#include "rt-core/epoch.h"

struct msghdr;

namespace rigor::can {

/// The best one first.
enum class StampKind : std::uint8_t { hardware, kernel, arrival };
[[nodiscard]] const char* stamp_name(StampKind kind) noexcept;

/// The stamps of one frame; absent where the kernel gave none.
struct FrameStamps {
  std::optional<RealtimeTime> kernel;
  std::optional<DeviceTime> hardware;  ///< of the interface's clock
};
/// Any thread, no allocation.
[[nodiscard]] FrameStamps stamps_of(const msghdr& message) noexcept;

/// One thread, but for `count`. No allocation.
class FrameClock {
 public:
  explicit FrameClock(StampKind wanted = StampKind::kernel) noexcept;
  FrameClock(const FrameClock&) = delete;
  FrameClock& operator=(const FrameClock&) = delete;

  struct Placed {
    BenchTime t;
    Duration sigma;
    StampKind kind = StampKind::arrival;
  };
  /// The instant of a frame that was read at `read`, by the wanted kind of stamp or, where the frame has none
  /// that can be believed, by the next best one.
  [[nodiscard]] Placed place(const FrameStamps& stamps, const EpochPair& epoch, BenchTime read) noexcept;
  /// Forgets the interface's clock, as after a reconnection.
  void reset() noexcept { hardware_.reset(); }
  /// Wants another kind, and forgets.
  void want(StampKind kind) noexcept;
  [[nodiscard]] StampKind wanted() const noexcept { return wanted_; }
  /// Frames that were placed by stamps of this kind. Any thread.
  [[nodiscard]] std::uint64_t count(StampKind kind) const noexcept {
    return counts_[static_cast<std::size_t>(kind)].load(std::memory_order_relaxed);
  }

 private:
  [[nodiscard]] Placed best_of(const FrameStamps& stamps, const EpochPair& epoch, BenchTime read) noexcept;
  StampKind wanted_;
  ClockMap hardware_;
  std::array<std::atomic<std::uint64_t>, 3> counts_{};
};

}  // namespace rigor::can
