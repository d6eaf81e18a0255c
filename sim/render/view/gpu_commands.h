// Short ways to say common things to a command buffer. Internal to sim/render/view.
#pragma once

#include <cstdint>
#include <span>

#include "sim/render/device_impl.h"

namespace rigor::render {

inline constexpr VkShaderStageFlags kDrawStages = VK_SHADER_STAGE_VERTEX_BIT | VK_SHADER_STAGE_FRAGMENT_BIT;
inline constexpr std::uint32_t kDrawPushBytes = 80;

/// The hazard that a barrier prevents: what was done, and what must wait for it.
struct Hazard {
  VkPipelineStageFlags2 from = 0;
  VkAccessFlags2 from_access = 0;
  VkPipelineStageFlags2 to = 0;
  VkAccessFlags2 to_access = 0;
};
inline constexpr VkPipelineStageFlags2 kDepthStages =
    VK_PIPELINE_STAGE_2_EARLY_FRAGMENT_TESTS_BIT | VK_PIPELINE_STAGE_2_LATE_FRAGMENT_TESTS_BIT;
inline constexpr VkAccessFlags2 kDepthAccess =
    VK_ACCESS_2_DEPTH_STENCIL_ATTACHMENT_READ_BIT | VK_ACCESS_2_DEPTH_STENCIL_ATTACHMENT_WRITE_BIT;
inline constexpr Hazard kDepthAfterDepth{kDepthStages, kDepthAccess, kDepthStages, kDepthAccess};

[[nodiscard]] VkImageMemoryBarrier2 image_change(VkImage image, const VkImageSubresourceRange& range,
                                                 VkImageLayout from, VkImageLayout to, const Hazard& hazard);
void barrier(VkCommandBuffer commands, std::span<const VkImageMemoryBarrier2> images);
void barrier(VkCommandBuffer commands, const Hazard& hazard);

/// A picture that is drawn into, and kept after that unless `store` says otherwise.
[[nodiscard]] VkRenderingAttachmentInfo attachment(VkImageView view, VkImageLayout layout, bool clears,
                                                   VkAttachmentStoreOp store = VK_ATTACHMENT_STORE_OP_STORE);

/// A pool with one set in it.
[[nodiscard]] Result<VkDescriptorSet> make_descriptor_set(const Device::Impl& gpu,
                                                          VkDescriptorSetLayout layout,
                                                          std::span<const VkDescriptorPoolSize> sizes,
                                                          vk::DescriptorPool& pool);
[[nodiscard]] Result<vk::ImageView> make_level_view(const Device::Impl& gpu, VkImage image, VkFormat format,
                                                    std::uint32_t level);
[[nodiscard]] Result<vk::ImageView> make_layer_view(const Device::Impl& gpu, VkImage image, VkFormat format,
                                                    VkImageAspectFlags aspect, std::uint32_t layer);
/// Halves level 0, which was just drawn to, down to the last; leaves all ready to be sampled.
void make_mips_on_device(VkCommandBuffer commands, VkImage image, std::uint32_t width, std::uint32_t height,
                         std::uint32_t levels);

}  // namespace rigor::render
