// The output side of a video node: frames that a program gives to the kernel, for a loop-back device, an
// output of vivid, or the UVC gadget.
#pragma once

#include "drivers/v4l2/frame_conversion.h"
#include "drivers/v4l2/v4l2_device.h"

namespace rigor::v4l2 {

enum class OutputWay : std::uint8_t { mmap, write };

/// One thread.
class VideoOutput {
 public:
  VideoOutput() = default;
  /// Opens the node and sets format and rate.
  [[nodiscard]] static Result<VideoOutput> open(const std::string& path, const FormatChoice& choice,
                                                OutputWay way);
  /// For a node that is open already (the UVC gadget's); the format is set.
  [[nodiscard]] static Result<VideoOutput> use(int fd, const std::string& path, const FormatChoice& choice);

  /// Takes `count` buffers (mmap) or one (write).
  [[nodiscard]] Status allocate(std::uint32_t count);
  /// Memory for the next frame; empty while the kernel holds all.
  [[nodiscard]] std::span<std::byte> next() noexcept;
  /// Gives what next() gave to the kernel. `t` (CLOCK_MONOTONIC) goes with it where the node carries stamps.
  /// False: the node refuses it.
  [[nodiscard]] bool send(std::size_t bytes, MonotonicTime t, std::uint32_t sequence) noexcept;
  void stop() noexcept;
  [[nodiscard]] const ActualFormat& format() const noexcept { return format_; }
  [[nodiscard]] int fd() const noexcept { return fd_; }

 private:
  FileDescriptor own_;
  int fd_ = -1;
  std::string path_;
  ActualFormat format_;
  OutputWay way_ = OutputWay::mmap;
  NodeBuffers buffers_;
  std::vector<std::byte> frame_;
  std::uint32_t fresh_ = 0, current_ = 0;
  bool streaming_ = false, holds_ = false;
};

}  // namespace rigor::v4l2
