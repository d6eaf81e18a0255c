#include "sim/render/view/frame_targets.h"

#include <algorithm>
#include <array>
#include <vector>

namespace rigor::render {
namespace {

constexpr VkImageSubresourceRange kColour{VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
constexpr VkImageSubresourceRange kDepth{VK_IMAGE_ASPECT_DEPTH_BIT, 0, 1, 0, 1};
constexpr VkPipelineStageFlags2 kColourStage = VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT;
constexpr VkAccessFlags2 kColourAccess =
    VK_ACCESS_2_COLOR_ATTACHMENT_READ_BIT | VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT;
/// More than this many pixels are drawn a part at a time: four samples of them take a third of a gigabyte.
constexpr std::size_t kPixelsAtOnce = std::size_t{2304} * 1728;

}  // namespace

Status FrameTargets::prepare(int width_px, int height_px, int samples, VkFormat colour_format, bool normals) {
  if (width_px == width_ && height_px == height_ && samples == samples_ && normals == normals_) return {};
  width_ = height_ = 0;
  for (vk::Image* i :
       {&colour_, &identity_, &depth_, &normal_, &colour_one_, &identity_one_, &depth_one_, &normal_one_})
    *i = vk::Image{};
  const auto rows = static_cast<int>(std::clamp<std::size_t>(
      kPixelsAtOnce / static_cast<std::size_t>(width_px), 1, static_cast<std::size_t>(height_px)));
  struct Wanted {
    vk::Image* image;
    VkFormat format;
    VkImageAspectFlags aspect;
    bool multisampled;
  };
  const auto many = samples == 4 ? VK_SAMPLE_COUNT_4_BIT : VK_SAMPLE_COUNT_1_BIT;
  for (const Wanted& w : {Wanted{&colour_, colour_format, VK_IMAGE_ASPECT_COLOR_BIT, true},
                          Wanted{&identity_, VK_FORMAT_R32_UINT, VK_IMAGE_ASPECT_COLOR_BIT, true},
                          Wanted{&depth_, VK_FORMAT_D32_SFLOAT, VK_IMAGE_ASPECT_DEPTH_BIT, true},
                          Wanted{&normal_, VK_FORMAT_R32_UINT, VK_IMAGE_ASPECT_COLOR_BIT, true},
                          Wanted{&normal_one_, VK_FORMAT_R32_UINT, VK_IMAGE_ASPECT_COLOR_BIT, false},
                          Wanted{&colour_one_, colour_format, VK_IMAGE_ASPECT_COLOR_BIT, false},
                          Wanted{&identity_one_, VK_FORMAT_R32_UINT, VK_IMAGE_ASPECT_COLOR_BIT, false},
                          Wanted{&depth_one_, VK_FORMAT_D32_SFLOAT, VK_IMAGE_ASPECT_DEPTH_BIT, false}}) {
    if (!w.multisampled && samples == 1) continue;
    if (!normals && (w.image == &normal_ || w.image == &normal_one_)) continue;
    const bool depth = w.aspect == VK_IMAGE_ASPECT_DEPTH_BIT;
    const bool sampled = depth && w.multisampled, copied = !w.multisampled || samples == 1;
    auto made =
        gpu_.make_image({.format = w.format,
                         .width = static_cast<std::uint32_t>(width_px),
                         .height = static_cast<std::uint32_t>(rows),
                         .samples = w.multisampled ? many : VK_SAMPLE_COUNT_1_BIT,
                         .usage = (depth ? VkImageUsageFlags{VK_IMAGE_USAGE_DEPTH_STENCIL_ATTACHMENT_BIT}
                                         : VkImageUsageFlags{VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT}) |
                                  (sampled ? VkImageUsageFlags{VK_IMAGE_USAGE_SAMPLED_BIT} : 0) |
                                  (copied ? VkImageUsageFlags{VK_IMAGE_USAGE_TRANSFER_SRC_BIT} : 0),
                         .aspect = w.aspect});
    if (!made) return tl::unexpected(made.error());
    *w.image = std::move(*made);
  }
  const std::size_t pixels = static_cast<std::size_t>(width_px) * height_px;
  for (auto [buffer, bytes] :
       {std::pair{&radiance_back_, 16 * pixels}, std::pair{&identity_back_, 4 * pixels},
        std::pair{&depth_back_, 4 * pixels}, std::pair{&normal_back_, normals ? 4 * pixels : 0}})
    if (auto r = reserve(gpu_, *buffer, bytes, VK_BUFFER_USAGE_TRANSFER_DST_BIT, true); !r)
      return tl::unexpected(r.error());
  width_ = width_px;
  height_ = height_px;
  samples_ = samples;
  normals_ = normals;
  rows_ = rows;
  return {};
}

void FrameTargets::record_begin(VkCommandBuffer commands) const {
  std::vector<VkImageMemoryBarrier2> all;
  // What the part before wrote and copied is no longer needed.
  const Hazard colour{kColourStage | VK_PIPELINE_STAGE_2_COPY_BIT, 0, kColourStage, kColourAccess};
  const Hazard depth{kDepthStages | VK_PIPELINE_STAGE_2_COPY_BIT | kColourStage, 0,
                     kDepthStages | kColourStage, kDepthAccess | kColourAccess};
  for (const vk::Image* i : {&colour_, &identity_, &normal_, &colour_one_, &identity_one_, &normal_one_})
    if (i->handle)
      all.push_back(image_change(i->handle.get(), kColour, VK_IMAGE_LAYOUT_UNDEFINED,
                                 VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL, colour));
  for (const vk::Image* i : {&depth_, &depth_one_})
    if (i->handle)
      all.push_back(image_change(i->handle.get(), kDepth, VK_IMAGE_LAYOUT_UNDEFINED,
                                 VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL, depth));
  barrier(commands, all);
}

void FrameTargets::begin_pass(VkCommandBuffer commands, const Pass& pass, const Part& part) const {
  if (!pass.clears_depth)
    barrier(commands, Hazard{kColourStage | kDepthStages, kColourAccess | kDepthAccess,
                             kColourStage | kDepthStages, kColourAccess | kDepthAccess});
  constexpr VkImageLayout kDraw = VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL;
  std::array colours{attachment(colour_.view.get(), kDraw, pass.clears_colours),
                     attachment(identity_.view.get(), kDraw, pass.clears_colours),
                     attachment(normal_.view.get(), kDraw, pass.clears_colours)};
  auto depth = attachment(depth_.view.get(), VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL, pass.clears_depth);
  if (samples_ == 4 && pass.resolves) {
    colours[0].resolveMode = VK_RESOLVE_MODE_AVERAGE_BIT;
    colours[0].resolveImageView = colour_one_.view.get();
    colours[0].resolveImageLayout = VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL;
  }
  if (samples_ == 4 && pass.resolves_identity) {
    // Identity, normal and depth cannot be averaged: they are those of one and the same sample.
    for (std::size_t i = 1; i < (normals_ ? 3U : 2U); ++i) {
      colours[i].resolveMode = VK_RESOLVE_MODE_SAMPLE_ZERO_BIT;
      colours[i].resolveImageView = (i == 1 ? identity_one_ : normal_one_).view.get();
      colours[i].resolveImageLayout = VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL;
    }
    depth.resolveMode = VK_RESOLVE_MODE_SAMPLE_ZERO_BIT;
    depth.resolveImageView = depth_one_.view.get();
    depth.resolveImageLayout = VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL;
  }
  VkRenderingInfo info{};
  info.sType = VK_STRUCTURE_TYPE_RENDERING_INFO;
  info.renderArea = {{0, 0}, {static_cast<std::uint32_t>(width_), static_cast<std::uint32_t>(part.rows)}};
  info.layerCount = 1;
  info.colorAttachmentCount =
      pass.writes == Writes::picture ? (normals_ ? 3 : 2) : pass.writes == Writes::radiance;
  info.pColorAttachments = colours.data();
  info.pDepthAttachment = &depth;
  vkCmdBeginRendering(commands, &info);
  // The whole picture's square of directions; the part looks through a window of it.
  const VkViewport viewport{
      0, static_cast<float>(-part.first_row), static_cast<float>(width_), static_cast<float>(height_), 0, 1};
  vkCmdSetViewport(commands, 0, 1, &viewport);
  vkCmdSetScissor(commands, 0, 1, &info.renderArea);
}

void FrameTargets::record_readback(VkCommandBuffer commands, const Part& part) const {
  const bool many = samples_ == 4;
  const vk::Image& colour = many ? colour_one_ : colour_;
  const vk::Image& identity = many ? identity_one_ : identity_;
  const vk::Image& depth = many ? depth_one_ : depth_;
  const Hazard read{kColourStage | kDepthStages, kColourAccess | kDepthAccess, VK_PIPELINE_STAGE_2_COPY_BIT,
                    VK_ACCESS_2_TRANSFER_READ_BIT};
  const vk::Image& normal = many ? normal_one_ : normal_;
  std::vector<VkImageMemoryBarrier2> changes;
  for (const vk::Image* image : {&colour, &identity, &normal})
    if (image->handle)
      changes.push_back(image_change(image->handle.get(), kColour, VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL,
                                     VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, read));
  changes.push_back(image_change(depth.handle.get(), kDepth, VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL,
                                 VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, read));
  barrier(commands, changes);
  const auto copy = [&](const vk::Image& image, const vk::Buffer& buffer, VkImageAspectFlags aspect,
                        std::size_t bytes) {
    VkBufferImageCopy c{};
    c.bufferOffset = bytes * static_cast<std::size_t>(width_) * static_cast<std::size_t>(part.first_row);
    c.imageSubresource = {aspect, 0, 0, 1};
    c.imageExtent = {static_cast<std::uint32_t>(width_), static_cast<std::uint32_t>(part.rows), 1};
    vkCmdCopyImageToBuffer(commands, image.handle.get(), VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL,
                           buffer.handle.get(), 1, &c);
  };
  copy(colour, radiance_back_, VK_IMAGE_ASPECT_COLOR_BIT, 16);
  copy(identity, identity_back_, VK_IMAGE_ASPECT_COLOR_BIT, 4);
  copy(depth, depth_back_, VK_IMAGE_ASPECT_DEPTH_BIT, 4);
  if (normals_) copy(normal, normal_back_, VK_IMAGE_ASPECT_COLOR_BIT, 4);
  barrier(commands, Hazard{VK_PIPELINE_STAGE_2_COPY_BIT, VK_ACCESS_2_TRANSFER_WRITE_BIT,
                           VK_PIPELINE_STAGE_2_HOST_BIT, VK_ACCESS_2_HOST_READ_BIT});
}

void FrameTargets::record_depth_for_reading(VkCommandBuffer commands) const {
  const std::array change{image_change(
      depth_.handle.get(), kDepth, VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL,
      VK_IMAGE_LAYOUT_DEPTH_STENCIL_READ_ONLY_OPTIMAL,
      {kDepthStages, kDepthAccess, VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT, VK_ACCESS_2_SHADER_READ_BIT})};
  barrier(commands, change);
}
void FrameTargets::record_depth_for_drawing(VkCommandBuffer commands) const {
  const std::array change{image_change(
      depth_.handle.get(), kDepth, VK_IMAGE_LAYOUT_DEPTH_STENCIL_READ_ONLY_OPTIMAL,
      VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL,
      {VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT, VK_ACCESS_2_SHADER_READ_BIT, kDepthStages, kDepthAccess})};
  barrier(commands, change);
}

}  // namespace rigor::render
