// An open /dev/videoN: the system calls that capture and output share, and memory that the kernel and we see
// both. The thinnest layer over the kernel's API (linux/videodev2.h); no decisions are made here.
#pragma once

#include <span>
#include <vector>

#include "drivers/v4l2/capture_device.h"
#include "rt-core/file_descriptor.h"

struct v4l2_buffer;

namespace rigor::v4l2 {

/// ioctl that is repeated when a signal interrupts it. The result is 0, or the negative errno.
[[nodiscard]] int call(int fd, unsigned long request, void* argument) noexcept;

/// Opens a node for reading and writing, without blocking. not_found, or unavailable with what to do about
/// rights.
[[nodiscard]] Result<FileDescriptor> open_node(const std::string& path);
/// What the node says of itself; `enumerate`: with formats and controls (slower).
[[nodiscard]] Result<DeviceTable> read_table(int fd, const std::string& path, bool output,
                                             bool enumerate = true);
/// VIDIOC_S_FMT and S_PARM; what was really set. `output`: of the output side.
[[nodiscard]] Result<ActualFormat> set_node_format(int fd, const std::string& path,
                                                   const FormatChoice& choice, bool output, bool set_rate);

/// Memory of a node's frames.
enum class BufferMemory : std::uint8_t { mmap, dmabuf };
/// Buffers of one queue, mapped here. With `dmabuf` they are made by udmabuf or a heap of /dev/dma_heap and
/// imported by the device (V4L2_MEMORY_DMABUF); where the machine has neither, they are the device's own,
/// exported (VIDIOC_EXPBUF) and mapped through their dma-buf.
class NodeBuffers {
 public:
  NodeBuffers() = default;
  NodeBuffers(NodeBuffers&&) noexcept = default;
  NodeBuffers& operator=(NodeBuffers&& o) noexcept;
  ~NodeBuffers();

  [[nodiscard]] static Result<NodeBuffers> create(int fd, const std::string& path, bool output,
                                                  BufferMemory memory, std::uint32_t count,
                                                  std::uint32_t size_bytes);
  [[nodiscard]] std::size_t count() const noexcept { return buffers_.size(); }
  [[nodiscard]] std::span<std::byte> memory(std::uint32_t index) const noexcept;
  /// Where they are from: "mmap", "dmabuf imported from /dev/udmabuf", "dmabuf exported by the device".
  [[nodiscard]] const std::string& origin() const noexcept { return origin_; }
  /// Fills type, memory and, for an imported one, its descriptor.
  void describe(v4l2_buffer& buffer, std::uint32_t index) const noexcept;
  /// Before and after the CPU touches it; nothing to do for mmap.
  void begin_access(std::uint32_t index, bool write) const noexcept;
  void end_access(std::uint32_t index, bool write) const noexcept;
  /// A descriptor of the buffer as a dma-buf, for other devices; -1 for mmap.
  [[nodiscard]] int dmabuf_fd(std::uint32_t index) const noexcept;

 private:
  struct Buffer {
    std::byte* at = nullptr;
    std::size_t size = 0;
    FileDescriptor dmabuf;
  };
  void clear() noexcept;
  std::vector<Buffer> buffers_;
  std::string origin_;
  bool output_ = false, imported_ = false;
};

}  // namespace rigor::v4l2
