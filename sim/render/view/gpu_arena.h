// Buffers on the device that many small things share. Internal to sim/render/view.
#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <vector>

#include "sim/render/device_impl.h"

namespace rigor::render {

/// A part of a buffer; stays mapped.
struct Slice {
  int block = -1;
  VkBuffer buffer = VK_NULL_HANDLE;
  std::size_t offset = 0, size_bytes = 0;
  std::byte* data = nullptr;
  explicit operator bool() const { return block >= 0; }
};

/// Blocks of one size, from which slices are taken where they first fit. What is larger than a block gets one
/// of its own.
class GpuArena {
 public:
  struct Options {
    std::size_t block_bytes = 16u << 20;
    VkBufferUsageFlags usage = 0;
    std::size_t alignment = 64;
    bool may_exceed_block = true;
  };
  GpuArena(const Device::Impl& gpu, const Options& options) : gpu_(gpu), options_(options) {}

  /// Errors: unavailable (out of memory, or larger than a block may be).
  [[nodiscard]] Result<Slice> take(std::size_t size_bytes);
  void give(Slice& slice);
  /// Null for a block that has been given back.
  [[nodiscard]] VkBuffer block(std::size_t i) const {
    return blocks_[i] ? blocks_[i]->buffer.handle.get() : VK_NULL_HANDLE;
  }

 private:
  struct Block {
    vk::Buffer buffer;
    std::size_t size_bytes = 0, used_bytes = 0;
    std::map<std::size_t, std::size_t> free;  ///< offset to size
  };
  const Device::Impl& gpu_;
  Options options_;
  std::vector<std::unique_ptr<Block>> blocks_;
};

/// Makes the buffer larger where it is too small; what it held is lost then. True where it was replaced.
[[nodiscard]] Result<bool> reserve(const Device::Impl& gpu, vk::Buffer& buffer, std::size_t size_bytes,
                                   VkBufferUsageFlags usage, bool host_reads = false);

}  // namespace rigor::render
