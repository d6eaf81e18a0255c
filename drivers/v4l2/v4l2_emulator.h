// A simulated camera that leaves as a video device. Keys: emulated_video.h, and these:
//
//   as: video     device: /dev/video2 | card's name      a v4l2loopback node, or the output of vivid
//   as: usb       controller: dummy_udc.0                the USB device controller; without it the first free
//   one
//                 vendor: 0x1d6b, product: 0x0102        ids of the USB camera
//
// Pictures are taken on the grid of the bench's clock (start + k / rate_hz) and handed over when their last
// row is read; a capture that cannot be handed over, because the kernel holds every buffer or the picture
// came too late, is counted as lost, and the next instant of the grid is taken. As usb, pictures are only
// taken while a host streams. Wall clock only.
#pragma once

#include <atomic>
#include <thread>

#include "drivers/v4l2/emulated_video.h"
#include "drivers/v4l2/frame_instant.h"
#include "drivers/v4l2/uvc_gadget.h"
#include "drivers/v4l2/video_output.h"
#include "rt-core/deadline.h"
#include "sensor-hal/channel/backoff.h"

namespace rigor::v4l2 {

/// `health()`: received counts frames that were handed over; connected says that a host streams (usb), or
/// that the node takes frames (video: who reads there is not known).
class V4l2Emulator final : public Emulator {
 public:
  ~V4l2Emulator() override;
  void attach(DeviceParts parts) override { parts_ = std::move(parts); }
  [[nodiscard]] std::string endpoint() const override;
  /// The node that is written to, once armed: "/dev/video2". As usb, of the gadget's own side.
  [[nodiscard]] const std::string& node() const noexcept { return node_; }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  struct Grid {
    BenchTime t0;
    Period period;
    std::uint64_t next = 0;
    [[nodiscard]] BenchTime at(std::uint64_t k) const { return t0 + period * static_cast<std::int64_t>(k); }
  };
  [[nodiscard]] Result<VideoOutput> open_output();
  [[nodiscard]] Status arm_usb();
  void run_video();
  void run_usb();
  /// Takes the picture of the grid's next instant and hands it over. False: stopped, or the node refuses it.
  [[nodiscard]] bool hand_over_one(bool& refused);
  void skip_to_now();
  /// Waits, and answers the host on the way (usb). False: stopped.
  [[nodiscard]] bool wait_until(BenchTime t);
  void answer_host();
  void host_starts();
  void host_stops();
  void lose(std::uint64_t captures) { health_.lost.fetch_add(captures, std::memory_order_relaxed); }

  EmulatedVideoSettings settings_;
  DeviceParts parts_;
  bool usb_ = false;
  OutputWay way_ = OutputWay::mmap;
  std::string device_, controller_, node_;
  std::uint16_t vendor_ = 0, product_ = 0;
  std::optional<EmulatedPictures> pictures_;
  VideoOutput output_;
  bool output_open_ = false;
  Grid grid_;
  Shutter shutter_;
  Deadline deadline_;
  std::thread thread_;
  // usb
  UvcGadget gadget_;
  FileDescriptor gadget_fd_;
  std::optional<uvc::ControlPipe> pipe_;
  bool streaming_ = false;
};

}  // namespace rigor::v4l2
