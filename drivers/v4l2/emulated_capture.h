// The emulated camera as a capturing device in process: the table that a driver would show for it, the same
// instants and frames, the same clock stamps; time is what it is told. Stands for the device in virtual runs.
#pragma once

#include <deque>

#include "drivers/v4l2/emulated_video.h"
#include "drivers/v4l2/frame_instant.h"

namespace rigor::v4l2 {

class EmulatedCapture final : public CaptureDevice {
 public:
  EmulatedCapture(const EmulatedVideoSettings& settings, EmulatedPictures pictures);

  [[nodiscard]] Result<DeviceTable> table() override;
  [[nodiscard]] Result<ActualFormat> set_format(const FormatChoice& choice) override;
  [[nodiscard]] Status set_control(std::uint32_t id, std::int64_t value) override;
  [[nodiscard]] Result<std::int64_t> get_control(std::uint32_t id) override;
  [[nodiscard]] Status start(std::uint32_t buffers) override;
  [[nodiscard]] FrameStatus next(RawFrame& out) override;
  bool release(const RawFrame& frame) override;
  void stop() override;

  /// The middle of the centre row's exposure of capture 0. Before start.
  void set_grid(BenchTime t0, const Period& period) noexcept;
  /// The next capture, if its last row is read by `now`; false when there is none. One that finds no free
  /// buffer is dropped, and the count goes on, as drivers do.
  bool advance(BenchTime now);
  [[nodiscard]] const EmulatedPictures& pictures() const noexcept { return pictures_; }
  [[nodiscard]] std::uint64_t dropped() const noexcept { return dropped_; }

 private:
  struct Buffer {
    std::vector<std::byte> memory;
    std::size_t used = 0;
    RawFrame frame;
    bool queued = false;  ///< the device may write to it
  };
  EmulatedVideoSettings settings_;
  EmulatedPictures pictures_;
  std::vector<Buffer> buffers_;
  std::deque<std::uint32_t> done_;
  std::uint64_t next_index_ = 0, dropped_ = 0;
  BenchTime t0_;
  Period period_;
  bool running_ = false;
};

}  // namespace rigor::v4l2
