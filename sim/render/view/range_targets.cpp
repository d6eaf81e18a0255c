#include "sim/render/view/range_targets.h"

#include <algorithm>

#include "sim/render/view/view_pipelines.h"

namespace rigor::render {
namespace {
constexpr VkImageSubresourceRange kColour{VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
constexpr VkImageSubresourceRange kDepth{VK_IMAGE_ASPECT_DEPTH_BIT, 0, 1, 0, 1};
constexpr VkPipelineStageFlags2 kWrite = VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT;

}  // namespace

Status RangeTargets::prepare(int width_px, int height_px) {
  if (width_px <= width_ && height_px <= height_) return {};
  const int width = std::max(width_px, width_), height = std::max(height_px, height_);
  width_ = height_ = 0;
  const auto make = [&](vk::Image& image, VkFormat format, VkImageUsageFlags usage,
                        VkImageAspectFlags aspect) -> Status {
    image = vk::Image{};
    auto made = gpu_.make_image(format, static_cast<std::uint32_t>(width), static_cast<std::uint32_t>(height),
                                usage, aspect);
    if (!made) return tl::unexpected(made.error());
    image = std::move(*made);
    return {};
  };
  for (vk::Image& map : maps_)
    if (auto s = make(map, kRangeFormat, VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT | VK_IMAGE_USAGE_SAMPLED_BIT,
                      VK_IMAGE_ASPECT_COLOR_BIT);
        !s)
      return s;
  if (auto s = make(depth_, VK_FORMAT_D32_SFLOAT, VK_IMAGE_USAGE_DEPTH_STENCIL_ATTACHMENT_BIT,
                    VK_IMAGE_ASPECT_DEPTH_BIT);
      !s)
    return s;
  width_ = width;
  height_ = height;
  return {};
}

void RangeTargets::begin(VkCommandBuffer commands, int width_px, int height_px) const {
  std::array<VkImageMemoryBarrier2, 4> all{};
  // What the view before was sampled from may be overwritten.
  for (std::size_t i = 0; i < 3; ++i)
    all[i] = image_change(maps_[i].handle.get(), kColour, VK_IMAGE_LAYOUT_UNDEFINED,
                          VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL,
                          {VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT, VK_ACCESS_2_SHADER_READ_BIT, kWrite,
                           VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT});
  all[3] = image_change(depth_.handle.get(), kDepth, VK_IMAGE_LAYOUT_UNDEFINED,
                        VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL, kDepthAfterDepth);
  barrier(commands, all);
  std::array<VkRenderingAttachmentInfo, 3> colours{};
  for (std::size_t i = 0; i < 3; ++i)
    colours[i] = attachment(maps_[i].view.get(), VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL, true);
  const auto depth = attachment(depth_.view.get(), VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL, true,
                                VK_ATTACHMENT_STORE_OP_DONT_CARE);
  VkRenderingInfo info{};
  info.sType = VK_STRUCTURE_TYPE_RENDERING_INFO;
  info.renderArea.extent = {static_cast<std::uint32_t>(width_px), static_cast<std::uint32_t>(height_px)};
  info.layerCount = 1;
  info.colorAttachmentCount = colours.size();
  info.pColorAttachments = colours.data();
  info.pDepthAttachment = &depth;
  vkCmdBeginRendering(commands, &info);
  const VkViewport viewport{0, 0, static_cast<float>(width_px), static_cast<float>(height_px), 0, 1};
  vkCmdSetViewport(commands, 0, 1, &viewport);
  vkCmdSetScissor(commands, 0, 1, &info.renderArea);
}

void RangeTargets::end(VkCommandBuffer commands) const {
  vkCmdEndRendering(commands);
  std::array<VkImageMemoryBarrier2, 3> all{};
  for (std::size_t i = 0; i < 3; ++i)
    all[i] = image_change(maps_[i].handle.get(), kColour, VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL,
                          VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL,
                          {kWrite, VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT,
                           VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT, VK_ACCESS_2_SHADER_READ_BIT});
  barrier(commands, all);
}

}  // namespace rigor::render
