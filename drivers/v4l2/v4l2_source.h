// A video device as a channel. Keys: v4l2_settings.h.
//
//   I/O thread   waits for a frame, converts it into a slot of the pool, gives its memory back to the kernel
//
// The device streams from arm on; frames of before the run go back to the kernel unread.
//
// Times. Kernel timestamps of CLOCK_MONOTONIC are bench time; t_capture is the middle of the centre row's
// exposure, by the event that the stamp is of (frame_instant.h).
//
// Loss. Gaps in the driver's count are captures lost; a buffer that the driver marks as wrong is handed on as
// kIncomplete. A device that goes away (ENODEV, an error of its queue, or silence for `silence_ms`) is looked
// for under the same name, at once and then after growing pauses; when it is back it is set as before, and
// the sequence goes on by the time that went by.
#pragma once

#include <memory>
#include <thread>

#include "drivers/v4l2/v4l2_device.h"
#include "drivers/v4l2/video_source.h"
#include "rt-core/deadline.h"
#include "sensor-hal/channel/backoff.h"

namespace rigor::v4l2 {

class V4l2Source final : public VideoSource {
 public:
  ~V4l2Source() override;

 protected:
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return true; }
  Status do_arm(const ArmContext& context) override;
  Status do_stop() override;

 private:
  [[nodiscard]] Result<Plan> open_device();
  void run();
  void take_frames();
  void lose();
  void try_again();

  std::unique_ptr<V4l2Device> device_;
  Deadline deadline_;
  Backoff backoff_;
  std::thread thread_;
  MonotonicTime t_heard_;  ///< when the last frame came
  bool stopping_ = false;
};

}  // namespace rigor::v4l2
