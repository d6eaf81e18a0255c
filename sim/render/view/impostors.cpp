#include "sim/render/view/impostors.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numbers>

#include "sim/render/view/gpu_commands.h"
#include "sim/render/view/texture_pool.h"

namespace rigor::render {
namespace {

constexpr std::uint32_t kWidth = kImpostorColumns * kImpostorCell_px,
                        kHeight = kImpostorRows * kImpostorCell_px;

struct BakePush {
  view_gpu::vec4 row_x, row_y, row_z, reflectance, near_infrared;
};
static_assert(sizeof(BakePush) == kDrawPushBytes);

BakePush view_from(const ResidentPrototype& p, int column, int row) {
  const double a = column * 2 * std::numbers::pi / kImpostorColumns, e = row * std::numbers::pi / 6;
  const Eigen::Vector3d toward(std::sin(a) * std::cos(e), std::cos(a) * std::cos(e), std::sin(e));
  const Eigen::Vector3d right(-std::cos(a), std::sin(a), 0);
  const Eigen::Vector3d up(-std::sin(a) * std::sin(e), -std::cos(a) * std::sin(e), std::cos(e));
  const Eigen::Vector3d c = p.centre.cast<double>();
  const double k = 1.0 / static_cast<double>(p.radius);
  BakePush b;
  b.row_x = view_gpu::xyz(right * k, -right.dot(c) * k);
  b.row_y = view_gpu::xyz(-up * k, up.dot(c) * k);
  b.row_z = view_gpu::xyz(-toward * (0.5 * k), 0.5 + 0.5 * toward.dot(c) * k);
  return b;
}

}  // namespace

Status Impostors::create() {
  auto sampler = make_sampler(gpu_, VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE);
  if (!sampler) return tl::unexpected(sampler.error());
  sampler_ = std::move(*sampler);
  return {};
}

void Impostors::write_uniforms(const Entry& e) const {
  view_gpu::SurfaceData d;
  d.reflectance = view_gpu::xyz(e.prototype->centre.cast<double>(), static_cast<double>(e.prototype->radius));
  view_gpu::put(colour_to_band(bands_, false), d.colour_to_band);
  view_gpu::put(near_infrared_to_band(bands_), d.near_infrared_to_band);
  std::memcpy(e.uniforms.data, &d, sizeof d);
}

void Impostors::set_bands(const view_gpu::Bands& bands) {
  if (bands == bands_) return;
  bands_ = bands;
  for (const auto& [serial, e] : entries_)
    if (e) write_uniforms(*e);
}

Result<std::unique_ptr<Impostors::Entry>> Impostors::make(const ResidentPrototype& p) const {
  auto e = std::make_unique<Entry>();
  e->prototype = &p;
  for (vk::Image* image : {&e->visible, &e->infrared, &e->normal}) {
    auto made = gpu_.make_image({.format = kImpostorMapFormat,
                                 .width = kWidth,
                                 .height = kHeight,
                                 .mip_levels = kImpostorMips,
                                 .usage = VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT | VK_IMAGE_USAGE_SAMPLED_BIT |
                                          VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT});
    if (!made) return tl::unexpected(made.error());
    *image = std::move(*made);
  }
  auto uniforms = gpu_.make_buffer(sizeof(view_gpu::SurfaceData), VK_BUFFER_USAGE_UNIFORM_BUFFER_BIT);
  if (!uniforms) return tl::unexpected(uniforms.error());
  e->uniforms = std::move(*uniforms);
  const std::array sizes{VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, 1},
                         VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER, 4}};
  auto set = make_descriptor_set(gpu_, pipelines_.surface_layout(), sizes, e->pool);
  if (!set) return tl::unexpected(set.error());
  e->set = *set;
  const VkDescriptorBufferInfo buffer{e->uniforms.handle.get(), 0, sizeof(view_gpu::SurfaceData)};
  std::array<VkDescriptorImageInfo, 4> images{};
  std::array<VkWriteDescriptorSet, 5> write{};
  const std::array<VkImageView, 4> views{e->visible.view.get(), e->infrared.view.get(), e->normal.view.get(),
                                         e->normal.view.get()};
  for (std::uint32_t i = 0; i < write.size(); ++i) {
    write[i].sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    write[i].dstSet = e->set;
    write[i].dstBinding = i;
    write[i].descriptorCount = 1;
    write[i].descriptorType =
        i == 0 ? VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER : VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER;
    if (i == 0) {
      write[i].pBufferInfo = &buffer;
    } else {
      images[i - 1] = {sampler_.get(), views[i - 1], VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL};
      write[i].pImageInfo = &images[i - 1];
    }
  }
  vkUpdateDescriptorSets(gpu_.device, write.size(), write.data(), 0, nullptr);
  write_uniforms(*e);
  return e;
}

const ImpostorAtlas* Impostors::get(const ResidentPrototype& p, std::uint64_t frame) {
  if (p.levels.empty() || p.levels.front() == nullptr || p.levels.front()->parts.empty()) return nullptr;
  auto& slot = entries_[p.prototype->serial];
  if (slot && slot->prototype != &p) slot.reset();  // the prototype was dropped and has come back
  if (!slot) {
    auto made = make(p);
    if (!made) return nullptr;
    slot = std::move(*made);
    for (const ResidentPart& part : p.levels.front()->parts)
      slot->translucent = slot->translucent || (part.surface->features & kFeatureTranslucent) != 0;
    pending_.push_back(slot.get());
  }
  slot->last_seen = frame;
  return slot.get();
}

Status Impostors::bake(VkCommandBuffer commands, VkDescriptorSet frame_set, Entry& e) {
  if (!depth_.handle) {
    auto made = gpu_.make_image(VK_FORMAT_D32_SFLOAT, kWidth, kHeight,
                                VK_IMAGE_USAGE_DEPTH_STENCIL_ATTACHMENT_BIT, VK_IMAGE_ASPECT_DEPTH_BIT);
    if (!made) return tl::unexpected(made.error());
    depth_ = std::move(*made);
  }
  const std::array<VkImage, 3> images{e.visible.handle.get(), e.infrared.handle.get(), e.normal.handle.get()};
  constexpr VkPipelineStageFlags2 kWrite = VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT;
  std::vector<VkImageMemoryBarrier2> barriers;
  for (VkImage image : images)
    barriers.push_back(
        image_change(image, {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1}, VK_IMAGE_LAYOUT_UNDEFINED,
                     VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL,
                     {VK_PIPELINE_STAGE_2_NONE, 0, kWrite, VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT}));
  barriers.push_back(image_change(depth_.handle.get(), {VK_IMAGE_ASPECT_DEPTH_BIT, 0, 1, 0, 1},
                                  VK_IMAGE_LAYOUT_UNDEFINED, VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL,
                                  kDepthAfterDepth));
  barrier(commands, barriers);
  std::array<VkImageView, 3> views{e.visible.view.get(), e.infrared.view.get(), e.normal.view.get()};
  // Views of one level: attachments take no more.
  std::array<vk::ImageView, 3> level0;
  for (std::size_t i = 0; i < 3; ++i) {
    auto made = make_level_view(gpu_, images[i], kImpostorMapFormat, 0);
    if (!made) return tl::unexpected(made.error());
    level0[i] = std::move(*made);
    views[i] = level0[i].get();
  }
  std::array<VkRenderingAttachmentInfo, 3> colours{};
  for (std::size_t i = 0; i < 3; ++i)
    colours[i] = attachment(views[i], VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL, true);
  auto depth = attachment(depth_.view.get(), VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL, true,
                          VK_ATTACHMENT_STORE_OP_DONT_CARE);
  depth.clearValue.depthStencil.depth = 1.0F;
  VkRenderingInfo rendering{};
  rendering.sType = VK_STRUCTURE_TYPE_RENDERING_INFO;
  rendering.renderArea = {{0, 0}, {kWidth, kHeight}};
  rendering.layerCount = 1;
  rendering.colorAttachmentCount = colours.size();
  rendering.pColorAttachments = colours.data();
  rendering.pDepthAttachment = &depth;
  vkCmdBeginRendering(commands, &rendering);
  const ResidentMesh& mesh = *e.prototype->levels.front();
  vkCmdBindVertexBuffers(commands, 0, 1, &mesh.vertices.buffer, &mesh.vertices.offset);
  vkCmdBindIndexBuffer(commands, mesh.indices.buffer, mesh.indices.offset, VK_INDEX_TYPE_UINT32);
  vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipelines_.draw(), 0, 1, &frame_set, 0,
                          nullptr);
  for (const ResidentPart& part : mesh.parts) {
    auto pipeline = pipelines_.get(ViewPass::impostor_bake,
                                   part.surface->features & (kFeatureColourMap | kFeatureNearInfraredMap |
                                                             kFeatureAlpha | kFeatureTwoSided));
    if (!pipeline) return tl::unexpected(pipeline.error());
    vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, *pipeline);
    vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipelines_.draw(), 1, 1,
                            &part.surface->set, 0, nullptr);
    const Spectrum& r = part.surface->surface->reflectance;
    const Spectrum& t = part.surface->surface->transmittance;
    float sum_r = 0, sum_t = 0;
    for (std::size_t b = 0; b < r.size(); ++b) {
      sum_r += r[b];
      sum_t += t[b];
    }
    for (int row = 0; row < kImpostorRows; ++row)
      for (int column = 0; column < kImpostorColumns; ++column) {
        BakePush push = view_from(*e.prototype, column, row);
        push.reflectance = {r[0], r[1], r[2], 0};
        push.near_infrared = {r[3], r[4], r[5], sum_r > 0 ? std::min(sum_t / sum_r, 1.0F) : 0.0F};
        vkCmdPushConstants(commands, pipelines_.draw(), kDrawStages, 0, sizeof push, &push);
        const auto cell = static_cast<float>(kImpostorCell_px);
        const VkViewport viewport{
            static_cast<float>(column) * cell, static_cast<float>(row) * cell, cell, cell, 0, 1};
        const VkRect2D scissor{
            {static_cast<int>(column * kImpostorCell_px), static_cast<int>(row * kImpostorCell_px)},
            {kImpostorCell_px, kImpostorCell_px}};
        vkCmdSetViewport(commands, 0, 1, &viewport);
        vkCmdSetScissor(commands, 0, 1, &scissor);
        vkCmdDrawIndexed(commands, part.index_count, 1, part.first_index, 0, 0);
      }
  }
  vkCmdEndRendering(commands);
  views_of_bakes_.insert(views_of_bakes_.end(), std::make_move_iterator(level0.begin()),
                         std::make_move_iterator(level0.end()));
  for (VkImage image : images) make_mips_on_device(commands, image, kWidth, kHeight, kImpostorMips);
  e.baked = true;
  return {};
}

Status Impostors::record(VkCommandBuffer commands, VkDescriptorSet frame_set) {
  views_of_bakes_.clear();
  for (Entry* e : pending_)
    if (auto s = bake(commands, frame_set, *e); !s) return s;
  pending_.clear();
  return {};
}

void Impostors::drop_older_than(std::uint64_t frame) {
  std::erase_if(entries_, [&](const auto& e) { return !e.second || e.second->last_seen < frame; });
}

}  // namespace rigor::render
