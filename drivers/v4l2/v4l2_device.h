// A capturing /dev/videoN behind the interface that sources use. Single-planar API; streaming only.
#pragma once

#include <memory>

#include "drivers/v4l2/video_node.h"

namespace rigor::v4l2 {

class V4l2Device final : public CaptureDevice {
 public:
  [[nodiscard]] static Result<std::unique_ptr<V4l2Device>> open(const std::string& path, BufferMemory memory);
  ~V4l2Device() override;

  [[nodiscard]] Result<DeviceTable> table() override;
  [[nodiscard]] Result<ActualFormat> set_format(const FormatChoice& choice) override;
  [[nodiscard]] Status set_control(std::uint32_t id, std::int64_t value) override;
  [[nodiscard]] Result<std::int64_t> get_control(std::uint32_t id) override;
  [[nodiscard]] Status start(std::uint32_t buffers) override;
  [[nodiscard]] FrameStatus next(RawFrame& out) override;
  bool release(const RawFrame& frame) override;
  void stop() override;

  /// Takes the memory without beginning to capture; `start` does so where it was not done. Setup context.
  [[nodiscard]] Status allocate(std::uint32_t buffers);
  /// To wait for: readable when there is a frame, in error when there will be none.
  [[nodiscard]] int fd() const noexcept { return fd_.get(); }
  [[nodiscard]] const NodeBuffers& buffers() const noexcept { return buffers_; }
  [[nodiscard]] const std::string& path() const noexcept { return path_; }

 private:
  V4l2Device(FileDescriptor fd, std::string path, BufferMemory memory);
  [[nodiscard]] int queue(std::uint32_t index) noexcept;
  FileDescriptor fd_;
  std::string path_;
  BufferMemory memory_;
  NodeBuffers buffers_;
  std::uint32_t size_bytes_ = 0;
  bool streaming_ = false, sets_rate_ = false;
};

/// The capturing node (or, with `output`, the node that takes frames) that a person means by a path, a link's
/// name in /dev/v4l/by-id, or a card's name. not_found, with what there is. Setup context.
[[nodiscard]] Result<std::string> find_node(const std::string& selector, bool output);
/// All nodes, in order of their numbers. `enumerate`: with formats and controls.
[[nodiscard]] std::vector<DeviceTable> list_nodes(bool enumerate);

}  // namespace rigor::v4l2
