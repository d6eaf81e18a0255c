// The inside of a Device. Internal to sim/render.
#pragma once

#include <cstdint>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "sim/render/device.h"
#include "sim/render/vulkan_handles.h"

namespace rigor::render {

/// A picture in the device's memory.
struct ImageWanted {
  VkFormat format = VK_FORMAT_R32G32B32A32_SFLOAT;
  std::uint32_t width = 1, height = 1, mip_levels = 1, layers = 1;
  VkSampleCountFlagBits samples = VK_SAMPLE_COUNT_1_BIT;
  VkImageUsageFlags usage = 0;
  VkImageAspectFlags aspect = VK_IMAGE_ASPECT_COLOR_BIT;
  bool array_view = false;  ///< the view is of a 2D array, even of one layer
};

struct Device::Impl {
  Impl() = default;
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  VkInstance instance = VK_NULL_HANDLE;
  VkDebugUtilsMessengerEXT messenger = VK_NULL_HANDLE;
  VkPhysicalDevice physical = VK_NULL_HANDLE;
  VkDevice device = VK_NULL_HANDLE;
  VkQueue queue = VK_NULL_HANDLE;
  std::uint32_t queue_family = 0;
  VkPhysicalDeviceMemoryProperties memory{};
  VkPhysicalDeviceLimits limits{};
  std::string name;
  bool validation = false;
  bool dual_source_blend = false;  ///< a fragment may give a second colour to blend with

  mutable std::mutex queue_mutex;  ///< vkQueueSubmit wants its queue for itself
  mutable std::mutex message_mutex;
  std::vector<std::string> messages;

  [[nodiscard]] Result<vk::Buffer> make_buffer(std::size_t size_bytes, VkBufferUsageFlags usage) const {
    return make_buffer(size_bytes, usage, VK_MEMORY_PROPERTY_HOST_CACHED_BIT);
  }
  /// `also_good`: kinds of memory that are taken where they are mapped and coherent too.
  [[nodiscard]] Result<vk::Buffer> make_buffer(std::size_t size_bytes, VkBufferUsageFlags usage,
                                               VkMemoryPropertyFlags also_good) const;
  [[nodiscard]] Result<vk::Image> make_image(const ImageWanted& wanted) const;
  [[nodiscard]] Result<vk::Image> make_image(VkFormat format, std::uint32_t width, std::uint32_t height,
                                             VkImageUsageFlags usage, VkImageAspectFlags aspect) const;
  [[nodiscard]] Result<vk::ShaderModule> make_shader(std::span<const std::uint32_t> words) const;
  /// Submits and waits until the work is done. Any thread.
  [[nodiscard]] Status run(VkCommandBuffer commands, VkFence fence) const;

 private:
  [[nodiscard]] Result<vk::Memory> allocate(const VkMemoryRequirements& needs, VkMemoryPropertyFlags wanted,
                                            VkMemoryPropertyFlags also_good) const;
};

}  // namespace rigor::render
