// Vulkan objects that destroy themselves: move-only, one owner. Internal to sim/render.
#pragma once

#include <vulkan/vulkan.h>

#include <cstddef>
#include <string>
#include <utility>

#include "rt-core/result.h"

namespace rigor::render::vk {

/// A device-level handle and the function that destroys it.
template <class T, auto Destroy>
class Handle {
 public:
  Handle() = default;
  Handle(VkDevice device, T handle) : device_(device), handle_(handle) {}
  Handle(Handle&& other) noexcept
      : device_(other.device_), handle_(std::exchange(other.handle_, static_cast<T>(VK_NULL_HANDLE))) {}
  Handle& operator=(Handle&& other) noexcept {
    if (this != &other) {
      reset();
      device_ = other.device_;
      handle_ = std::exchange(other.handle_, static_cast<T>(VK_NULL_HANDLE));
    }
    return *this;
  }
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;
  ~Handle() { reset(); }
  [[nodiscard]] T get() const { return handle_; }
  explicit operator bool() const { return handle_ != VK_NULL_HANDLE; }

 private:
  void reset() {
    if (handle_ != VK_NULL_HANDLE) Destroy(device_, handle_, nullptr);
    handle_ = VK_NULL_HANDLE;
  }
  VkDevice device_ = VK_NULL_HANDLE;
  T handle_ = VK_NULL_HANDLE;
};

using BufferHandle = Handle<VkBuffer, vkDestroyBuffer>;
using Memory = Handle<VkDeviceMemory, vkFreeMemory>;
using ImageHandle = Handle<VkImage, vkDestroyImage>;
using ImageView = Handle<VkImageView, vkDestroyImageView>;
using ShaderModule = Handle<VkShaderModule, vkDestroyShaderModule>;
using DescriptorSetLayout = Handle<VkDescriptorSetLayout, vkDestroyDescriptorSetLayout>;
using DescriptorPool = Handle<VkDescriptorPool, vkDestroyDescriptorPool>;
using PipelineLayout = Handle<VkPipelineLayout, vkDestroyPipelineLayout>;
using Pipeline = Handle<VkPipeline, vkDestroyPipeline>;
using CommandPool = Handle<VkCommandPool, vkDestroyCommandPool>;
using Sampler = Handle<VkSampler, vkDestroySampler>;
using Fence = Handle<VkFence, vkDestroyFence>;

/// A failed Vulkan call as an error: what was attempted and the result's number.
[[nodiscard]] inline tl::unexpected<Error> failed(const std::string& what, VkResult result) {
  const bool memory = result == VK_ERROR_OUT_OF_HOST_MEMORY || result == VK_ERROR_OUT_OF_DEVICE_MEMORY;
  return fail(ErrorCode::unavailable, "vulkan",
              what + " failed with VkResult " + std::to_string(result) +
                  (memory ? " (out of memory: choose a smaller picture or less supersampling)" : ""));
}

/// Memory of the host's own kind that stays mapped.
struct Buffer {
  BufferHandle handle;
  Memory memory;
  std::byte* data = nullptr;
  std::size_t size_bytes = 0;
};

struct Image {
  ImageHandle handle;
  Memory memory;
  ImageView view;
};

}  // namespace rigor::render::vk
