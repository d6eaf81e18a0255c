#include "sim/render/view/shadow_map.h"

#include <array>
#include <bit>

#include "sim/render/view/gpu_commands.h"

namespace rigor::render {
namespace {

constexpr VkFormat kFormat = VK_FORMAT_D32_SFLOAT;
constexpr VkImageLayout kReadable = VK_IMAGE_LAYOUT_DEPTH_STENCIL_READ_ONLY_OPTIMAL,
                        kDrawable = VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL,
                        kCopied = VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL;
constexpr VkPipelineStageFlags2 kShading = VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT,
                                kCopying = VK_PIPELINE_STAGE_2_COPY_BIT;

void change(VkCommandBuffer commands, VkImage image, std::uint32_t layer, VkImageLayout from,
            VkImageLayout to, const Hazard& hazard) {
  const std::array one{image_change(image, {VK_IMAGE_ASPECT_DEPTH_BIT, 0, 1, layer, 1}, from, to, hazard)};
  barrier(commands, one);
}

}  // namespace

Result<ShadowMap::Depths> ShadowMap::make(int side_px, VkImageUsageFlags usage) const {
  const auto side = static_cast<std::uint32_t>(side_px);
  auto made = gpu_.make_image({.format = kFormat,
                               .width = side,
                               .height = side,
                               .layers = layers_,
                               .usage = VK_IMAGE_USAGE_DEPTH_STENCIL_ATTACHMENT_BIT | usage,
                               .aspect = VK_IMAGE_ASPECT_DEPTH_BIT,
                               .array_view = array_});
  if (!made) return tl::unexpected(made.error());
  Depths out{std::move(*made), {}};
  for (std::uint32_t i = 0; i < layers_; ++i) {
    auto view = make_layer_view(gpu_, out.image.handle.get(), kFormat, VK_IMAGE_ASPECT_DEPTH_BIT, i);
    if (!view) return tl::unexpected(view.error());
    out.layers.push_back(std::move(*view));
  }
  return out;
}

Result<bool> ShadowMap::set_side(int side_px) {
  if (side_px == side_px_) return false;
  kept_ = {};
  for (KeptShadow& k : keeps_) k.forget();
  auto made = make(side_px, VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT);
  if (!made) return tl::unexpected(made.error());
  shown_ = std::move(*made);
  side_px_ = side_px;
  fresh_ = true;
  no_room_ = false;
  keeps_.assign(layers_, {});
  as_kept_.assign(layers_, 0);
  return true;
}

bool ShadowMap::forget() {
  const bool kept = static_cast<bool>(kept_.image.handle);
  for (KeptShadow& k : keeps_) k.forget();
  kept_ = {};
  // Layers that were not drawn may not be readable yet.
  fresh_ = true;
  as_kept_.assign(as_kept_.size(), 0);
  return kept;
}

ShadowLayer ShadowMap::plan(std::size_t layer, const ShadowCascade& cascade,
                            std::span<const ResidentBatch* const> batches, const CullOptions& options,
                            double smallest_m) {
  ShadowLayer out;
  out.cascade = cascade;
  if (!no_room_) out.use = keeps_[layer].next(cascade, batches, options);
  if (out.use == KeptShadow::Use::fill && !kept_.image.handle) {
    if (auto made = make(side_px_, VK_IMAGE_USAGE_TRANSFER_SRC_BIT); made)
      kept_ = std::move(*made);
    else
      no_room_ = true;
  }
  if (no_room_) {
    out.use = KeptShadow::Use::none;
    keeps_[layer].forget();
  }
  if (out.use == KeptShadow::Use::fill)
    out.still = cull_casters(cascade, batches, Casters::still_in_square, options, smallest_m);
  out.others =
      cull_casters(cascade, batches, out.use == KeptShadow::Use::none ? Casters::all : Casters::moving,
                   options, smallest_m);
  return out;
}

void ShadowMap::record_begin(VkCommandBuffer commands) {
  if (!fresh_) return;
  fresh_ = false;
  const std::array readable{
      image_change(shown_.image.handle.get(), {VK_IMAGE_ASPECT_DEPTH_BIT, 0, 1, 0, VK_REMAINING_ARRAY_LAYERS},
                   VK_IMAGE_LAYOUT_UNDEFINED, kReadable,
                   {VK_PIPELINE_STAGE_2_NONE, 0, kShading, VK_ACCESS_2_SHADER_READ_BIT})};
  barrier(commands, readable);
}

void ShadowMap::draw(VkCommandBuffer commands, VkDescriptorSet frame_set, const DrawLists& lists,
                     VkImageView into, bool clears, std::size_t layer, const ShadowCascade& cascade,
                     std::span<const DrawCall> calls, bool instancing) const {
  const auto side = static_cast<std::uint32_t>(side_px_);
  auto depth = attachment(into, kDrawable, clears);
  depth.clearValue.depthStencil.depth = 1.0F;
  VkRenderingInfo info{};
  info.sType = VK_STRUCTURE_TYPE_RENDERING_INFO;
  info.renderArea.extent = {side, side};
  info.layerCount = 1;
  info.pDepthAttachment = &depth;
  vkCmdBeginRendering(commands, &info);
  const VkViewport viewport{0, 0, static_cast<float>(side_px_), static_cast<float>(side_px_), 0, 1};
  vkCmdSetViewport(commands, 0, 1, &viewport);
  vkCmdSetScissor(commands, 0, 1, &info.renderArea);
  vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipelines_.draw(), 0, 1, &frame_set, 0,
                          nullptr);
  const auto near_share = static_cast<float>(-cascade.near_m / (cascade.far_m - cascade.near_m));
  const view_gpu::uvec4 push{first_cascade_ + static_cast<std::uint32_t>(layer),
                             std::bit_cast<std::uint32_t>(near_share), 0, 0};
  vkCmdPushConstants(commands, pipelines_.draw(), kDrawStages, 0, sizeof push, &push);
  lists.record(commands, calls, instancing);
  vkCmdEndRendering(commands);
}

void ShadowMap::record(VkCommandBuffer commands, VkDescriptorSet frame_set, const DrawLists& lists,
                       std::span<const ShadowLayer> layers, bool instancing) {
  const VkImage shown = shown_.image.handle.get(), kept = kept_.image.handle.get();
  for (std::size_t i = 0; i < layers.size(); ++i) {
    const ShadowLayer& l = layers[i];
    const auto layer = static_cast<std::uint32_t>(i);
    const Hazard read_then_drawn{kShading, VK_ACCESS_2_SHADER_READ_BIT, kDepthStages, kDepthAccess},
        drawn_then_read{kDepthStages, kDepthAccess, kShading, VK_ACCESS_2_SHADER_READ_BIT};
    if (l.use == KeptShadow::Use::none) {
      change(commands, shown, layer, VK_IMAGE_LAYOUT_UNDEFINED, kDrawable, read_then_drawn);
      draw(commands, frame_set, lists, shown_.layers[i].get(), true, i, l.cascade, l.other_calls, instancing);
      change(commands, shown, layer, kDrawable, kReadable, drawn_then_read);
      as_kept_[i] = 0;
      continue;
    }
    if (l.use == KeptShadow::Use::fill) {
      change(commands, kept, layer, VK_IMAGE_LAYOUT_UNDEFINED, kDrawable,
             {kCopying, VK_ACCESS_2_TRANSFER_READ_BIT, kDepthStages, kDepthAccess});
      draw(commands, frame_set, lists, kept_.layers[i].get(), true, i, l.cascade, l.still_calls, instancing);
      change(commands, kept, layer, kDrawable, kCopied,
             {kDepthStages, kDepthAccess, kCopying, VK_ACCESS_2_TRANSFER_READ_BIT});
      as_kept_[i] = 0;
    }
    const bool alone = l.other_calls.empty();
    if (as_kept_[i] == 0) {
      change(commands, shown, layer, VK_IMAGE_LAYOUT_UNDEFINED, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL,
             {kShading, VK_ACCESS_2_SHADER_READ_BIT, kCopying, VK_ACCESS_2_TRANSFER_WRITE_BIT});
      VkImageCopy copy{};
      copy.srcSubresource = copy.dstSubresource = {VK_IMAGE_ASPECT_DEPTH_BIT, 0, layer, 1};
      copy.extent = {static_cast<std::uint32_t>(side_px_), static_cast<std::uint32_t>(side_px_), 1};
      vkCmdCopyImage(commands, kept, kCopied, shown, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, 1, &copy);
      change(commands, shown, layer, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, kReadable,
             {kCopying, VK_ACCESS_2_TRANSFER_WRITE_BIT, kShading, VK_ACCESS_2_SHADER_READ_BIT});
    }
    as_kept_[i] = alone ? 1 : 0;
    if (alone) continue;
    change(commands, shown, layer, kReadable, kDrawable,
           {kShading | kCopying, VK_ACCESS_2_SHADER_READ_BIT | VK_ACCESS_2_TRANSFER_WRITE_BIT, kDepthStages,
            kDepthAccess});
    draw(commands, frame_set, lists, shown_.layers[i].get(), false, i, l.cascade, l.other_calls, instancing);
    change(commands, shown, layer, kDrawable, kReadable, drawn_then_read);
  }
}

}  // namespace rigor::render
