#include "sim/render/view/gpu_commands.h"

#include <algorithm>
#include <array>

namespace rigor::render {
namespace {
Result<vk::ImageView> make_view(const Device::Impl& gpu, VkImage image, VkFormat format,
                                const VkImageSubresourceRange& range) {
  VkImageViewCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO;
  info.image = image;
  info.viewType = VK_IMAGE_VIEW_TYPE_2D;
  info.format = format;
  info.subresourceRange = range;
  VkImageView handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateImageView(gpu.device, &info, nullptr, &handle); r != VK_SUCCESS)
    return vk::failed("making a view of a picture", r);
  return vk::ImageView(gpu.device, handle);
}
}  // namespace

VkImageMemoryBarrier2 image_change(VkImage image, const VkImageSubresourceRange& range, VkImageLayout from,
                                   VkImageLayout to, const Hazard& hazard) {
  VkImageMemoryBarrier2 b{};
  b.sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER_2;
  b.srcStageMask = hazard.from;
  b.srcAccessMask = hazard.from_access;
  b.dstStageMask = hazard.to;
  b.dstAccessMask = hazard.to_access;
  b.oldLayout = from;
  b.newLayout = to;
  b.srcQueueFamilyIndex = b.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
  b.image = image;
  b.subresourceRange = range;
  return b;
}

VkRenderingAttachmentInfo attachment(VkImageView view, VkImageLayout layout, bool clears,
                                     VkAttachmentStoreOp store) {
  VkRenderingAttachmentInfo a{};
  a.sType = VK_STRUCTURE_TYPE_RENDERING_ATTACHMENT_INFO;
  a.imageView = view;
  a.imageLayout = layout;
  a.loadOp = clears ? VK_ATTACHMENT_LOAD_OP_CLEAR : VK_ATTACHMENT_LOAD_OP_LOAD;
  a.storeOp = store;
  return a;
}

void barrier(VkCommandBuffer commands, std::span<const VkImageMemoryBarrier2> images) {
  VkDependencyInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO;
  info.imageMemoryBarrierCount = static_cast<std::uint32_t>(images.size());
  info.pImageMemoryBarriers = images.data();
  vkCmdPipelineBarrier2(commands, &info);
}

void barrier(VkCommandBuffer commands, const Hazard& hazard) {
  VkMemoryBarrier2 b{};
  b.sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER_2;
  b.srcStageMask = hazard.from;
  b.srcAccessMask = hazard.from_access;
  b.dstStageMask = hazard.to;
  b.dstAccessMask = hazard.to_access;
  VkDependencyInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO;
  info.memoryBarrierCount = 1;
  info.pMemoryBarriers = &b;
  vkCmdPipelineBarrier2(commands, &info);
}

Result<VkDescriptorSet> make_descriptor_set(const Device::Impl& gpu, VkDescriptorSetLayout layout,
                                            std::span<const VkDescriptorPoolSize> sizes,
                                            vk::DescriptorPool& pool) {
  VkDescriptorPoolCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO;
  info.maxSets = 1;
  info.poolSizeCount = static_cast<std::uint32_t>(sizes.size());
  info.pPoolSizes = sizes.data();
  VkDescriptorPool handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateDescriptorPool(gpu.device, &info, nullptr, &handle); r != VK_SUCCESS)
    return vk::failed("making a descriptor pool", r);
  pool = vk::DescriptorPool(gpu.device, handle);
  VkDescriptorSetAllocateInfo allocate{};
  allocate.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO;
  allocate.descriptorPool = handle;
  allocate.descriptorSetCount = 1;
  allocate.pSetLayouts = &layout;
  VkDescriptorSet set = VK_NULL_HANDLE;
  if (const VkResult r = vkAllocateDescriptorSets(gpu.device, &allocate, &set); r != VK_SUCCESS)
    return vk::failed("making a descriptor set", r);
  return set;
}

Result<vk::ImageView> make_level_view(const Device::Impl& gpu, VkImage image, VkFormat format,
                                      std::uint32_t level) {
  return make_view(gpu, image, format, {VK_IMAGE_ASPECT_COLOR_BIT, level, 1, 0, 1});
}
Result<vk::ImageView> make_layer_view(const Device::Impl& gpu, VkImage image, VkFormat format,
                                      VkImageAspectFlags aspect, std::uint32_t layer) {
  return make_view(gpu, image, format, {aspect, 0, 1, layer, 1});
}

void make_mips_on_device(VkCommandBuffer commands, VkImage image, std::uint32_t width, std::uint32_t height,
                         std::uint32_t levels) {
  constexpr VkPipelineStageFlags2 kBlit = VK_PIPELINE_STAGE_2_BLIT_BIT;
  for (std::uint32_t level = 0; level < levels; ++level) {
    const VkImageSubresourceRange range{VK_IMAGE_ASPECT_COLOR_BIT, level, 1, 0, 1};
    if (level > 0) {
      std::array change{image_change(image, range, VK_IMAGE_LAYOUT_UNDEFINED,
                                     VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL,
                                     {VK_PIPELINE_STAGE_2_NONE, 0, kBlit, VK_ACCESS_2_TRANSFER_WRITE_BIT})};
      barrier(commands, change);
      const auto side = [](std::uint32_t full, std::uint32_t l) {
        return static_cast<std::int32_t>(std::max(full >> l, 1U));
      };
      VkImageBlit blit{};
      blit.srcSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, level - 1, 0, 1};
      blit.dstSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, level, 0, 1};
      blit.srcOffsets[1] = {side(width, level - 1), side(height, level - 1), 1};
      blit.dstOffsets[1] = {side(width, level), side(height, level), 1};
      vkCmdBlitImage(commands, image, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, image,
                     VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, 1, &blit, VK_FILTER_LINEAR);
    }
    const std::array change{image_change(
        image, range,
        level == 0 ? VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL : VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL,
        VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL,
        {level == 0 ? VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT : kBlit,
         level == 0 ? VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT : VK_ACCESS_2_TRANSFER_WRITE_BIT, kBlit,
         VK_ACCESS_2_TRANSFER_READ_BIT})};
    barrier(commands, change);
  }
  const std::array change{
      image_change(image, {VK_IMAGE_ASPECT_COLOR_BIT, 0, levels, 0, 1}, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL,
                   VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL,
                   {kBlit, VK_ACCESS_2_TRANSFER_READ_BIT, VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT,
                    VK_ACCESS_2_SHADER_READ_BIT})};
  barrier(commands, change);
}

}  // namespace rigor::render
