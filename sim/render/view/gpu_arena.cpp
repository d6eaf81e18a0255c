#include "sim/render/view/gpu_arena.h"

#include <algorithm>

namespace rigor::render {

Result<Slice> GpuArena::take(std::size_t size_bytes) {
  const std::size_t size = (std::max<std::size_t>(size_bytes, 1) + options_.alignment - 1) /
                           options_.alignment * options_.alignment;
  for (std::size_t b = 0; b < blocks_.size(); ++b) {
    if (!blocks_[b]) continue;
    Block& block = *blocks_[b];
    for (auto it = block.free.begin(); it != block.free.end(); ++it) {
      if (it->second < size) continue;
      const std::size_t offset = it->first, left = it->second - size;
      block.free.erase(it);
      if (left > 0) block.free.emplace(offset + size, left);
      block.used_bytes += size;
      return Slice{static_cast<int>(b), block.buffer.handle.get(), offset, size, block.buffer.data + offset};
    }
  }
  if (size > options_.block_bytes && !options_.may_exceed_block)
    return fail(ErrorCode::unavailable, "vulkan",
                "expected at most " + std::to_string(options_.block_bytes) + " bytes in one piece, got " +
                    std::to_string(size));
  auto block = std::make_unique<Block>();
  block->size_bytes = std::max(size, options_.block_bytes);
  auto made = gpu_.make_buffer(block->size_bytes, options_.usage, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT);
  if (!made) return tl::unexpected(made.error());
  block->buffer = std::move(*made);
  block->used_bytes = size;
  if (size < block->size_bytes) block->free.emplace(size, block->size_bytes - size);
  auto place = std::find(blocks_.begin(), blocks_.end(), nullptr);
  if (place == blocks_.end()) place = blocks_.insert(blocks_.end(), nullptr);
  *place = std::move(block);
  return Slice{static_cast<int>(place - blocks_.begin()), (*place)->buffer.handle.get(), 0, size,
               (*place)->buffer.data};
}

void GpuArena::give(Slice& slice) {
  if (!slice) return;
  auto& owner = blocks_[static_cast<std::size_t>(slice.block)];
  Block& block = *owner;
  auto at = block.free.emplace(slice.offset, slice.size_bytes).first;
  if (auto next = std::next(at); next != block.free.end() && at->first + at->second == next->first) {
    at->second += next->second;
    block.free.erase(next);
  }
  if (at != block.free.begin())
    if (auto before = std::prev(at); before->first + before->second == at->first) {
      before->second += at->second;
      block.free.erase(at);
    }
  block.used_bytes -= slice.size_bytes;
  if (block.used_bytes == 0) owner.reset();
  slice = {};
}

Result<bool> reserve(const Device::Impl& gpu, vk::Buffer& buffer, std::size_t size_bytes,
                     VkBufferUsageFlags usage, bool host_reads) {
  if (buffer.handle && buffer.size_bytes >= size_bytes) return false;
  std::size_t size = std::max<std::size_t>(size_bytes + size_bytes / 4, 256);
  if ((usage & VK_BUFFER_USAGE_STORAGE_BUFFER_BIT) != 0 && size_bytes <= gpu.limits.maxStorageBufferRange)
    size = std::min<std::size_t>(size, gpu.limits.maxStorageBufferRange);
  auto made = gpu.make_buffer(
      size, usage, host_reads ? VK_MEMORY_PROPERTY_HOST_CACHED_BIT : VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT);
  if (!made) return tl::unexpected(made.error());
  buffer = std::move(*made);
  return true;
}

}  // namespace rigor::render
