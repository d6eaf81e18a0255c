#include "sim/render/view/frame_passes.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include "sim/render/view/gpu_commands.h"

namespace rigor::render {
namespace {

/// IEEE half precision, rounded to nearest even; the value is at most 1 and not negative.
std::uint16_t half_of(float v) {
  const auto bits = std::bit_cast<std::uint32_t>(v);
  const int exponent = static_cast<int>(bits >> 23) - 127 + 15;
  if (exponent <= 0) return static_cast<std::uint16_t>(std::lround(std::ldexp(v, 24)));
  const std::uint32_t mantissa = bits & 0x7FFFFFU;
  std::uint32_t out = static_cast<std::uint32_t>(exponent) << 10 | mantissa >> 13;
  const std::uint32_t rest = mantissa & 0x1FFFU;
  if (rest > 0x1000U || (rest == 0x1000U && (out & 1U) != 0)) ++out;
  return static_cast<std::uint16_t>(out);
}

}  // namespace

Status FrameResources::create() {
  if (auto r = reserve(gpu_, uniforms_, sizeof(view_gpu::ViewFrame), VK_BUFFER_USAGE_UNIFORM_BUFFER_BIT); !r)
    return tl::unexpected(r.error());
  const std::array sizes{VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, 1},
                         VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER, 1},
                         VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE, 2}};
  auto set = make_descriptor_set(gpu_, pipelines_.frame_layout(), sizes, pool_);
  if (!set) return tl::unexpected(set.error());
  set_ = *set;
  VkSamplerCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_SAMPLER_CREATE_INFO;
  info.magFilter = info.minFilter = VK_FILTER_LINEAR;
  info.addressModeU = VK_SAMPLER_ADDRESS_MODE_REPEAT;  // all round
  info.addressModeV = info.addressModeW = VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE;
  VkSampler handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateSampler(gpu_.device, &info, nullptr, &handle); r != VK_SUCCESS)
    return vk::failed("making a sampler", r);
  sky_sampler_ = vk::Sampler(gpu_.device, handle);
  VkFormatProperties format{};
  vkGetPhysicalDeviceFormatProperties(gpu_.physical, sky_format_, &format);
  if ((format.optimalTilingFeatures & VK_FORMAT_FEATURE_SAMPLED_IMAGE_FILTER_LINEAR_BIT) == 0)
    sky_format_ = VK_FORMAT_R16G16B16A16_SFLOAT;
  if (auto s = set_shadow_side(16); !s) return s;
  if (auto s = set_zenith_side(16); !s) return s;
  return set_sky(nullptr, {0, 1, 2, 3});
}

Status FrameResources::set_sky(const std::shared_ptr<const SkyMap>& map, const view_gpu::Bands& bands) {
  const bool valid = map && map->width > 0 && map->height > 0 &&
                     map->radiance.size() >= static_cast<std::size_t>(map->width) * map->height;
  const std::uint64_t serial = valid ? map->serial : 0;
  if (serial == sky_serial_ && bands == sky_bands_) return {};
  if (serial != sky_serial_) sky_light_ = sky_light(valid ? map.get() : nullptr);
  const int width = valid ? map->width : 1, height = valid ? map->height : 1;
  const std::size_t texels = static_cast<std::size_t>(width) * height;
  float most = 0;
  if (valid)
    for (std::size_t i = 0; i < texels; ++i)
      for (const float r : map->radiance[i])
        if (std::isfinite(r)) most = std::max(most, r);
  sky_scale_ = most > 0 ? most : 1.0F;
  const bool half = sky_format_ == VK_FORMAT_R16G16B16A16_SFLOAT;
  ImageUploads::Level level{static_cast<std::uint32_t>(width), static_cast<std::uint32_t>(height), {}};
  level.bytes.resize(texels * (half ? 8 : 16));
  for (std::size_t i = 0; valid && i < texels; ++i)
    for (std::size_t c = 0; c < 4; ++c) {
      const float r = map->radiance[i][static_cast<std::size_t>(bands[c])];
      const float v = std::isfinite(r) ? std::clamp(r / sky_scale_, 0.0F, 1.0F) : 0.0F;
      if (half) {
        const std::uint16_t bits = half_of(v);
        std::memcpy(&level.bytes[i * 8 + c * 2], &bits, 2);
      } else {
        std::memcpy(&level.bytes[i * 16 + c * 4], &v, 4);
      }
    }
  auto made = gpu_.make_image({.format = sky_format_,
                               .width = level.width,
                               .height = level.height,
                               .usage = VK_IMAGE_USAGE_TRANSFER_DST_BIT | VK_IMAGE_USAGE_SAMPLED_BIT});
  if (!made) return tl::unexpected(made.error());
  if (auto s = uploads_.add(made->handle.get(), {std::move(level)}); !s) return s;
  if (sky_.handle) uploads_.forget(sky_.handle.get());
  sky_ = std::move(*made);
  sky_serial_ = serial;
  sky_bands_ = bands;
  write_set();
  return {};
}

Status FrameResources::set_side(DepthMap& map, int side_px, std::uint32_t layers, bool array) {
  if (side_px == map.side_px) return {};
  const auto side = static_cast<std::uint32_t>(side_px);
  auto made =
      gpu_.make_image({.format = VK_FORMAT_D32_SFLOAT,
                       .width = side,
                       .height = side,
                       .layers = layers,
                       .usage = VK_IMAGE_USAGE_DEPTH_STENCIL_ATTACHMENT_BIT | VK_IMAGE_USAGE_SAMPLED_BIT,
                       .aspect = VK_IMAGE_ASPECT_DEPTH_BIT,
                       .array_view = array});
  if (!made) return tl::unexpected(made.error());
  map.layers.clear();
  map.image = std::move(*made);
  for (std::uint32_t i = 0; i < layers; ++i) {
    auto view =
        make_layer_view(gpu_, map.image.handle.get(), VK_FORMAT_D32_SFLOAT, VK_IMAGE_ASPECT_DEPTH_BIT, i);
    if (!view) return tl::unexpected(view.error());
    map.layers.push_back(std::move(*view));
  }
  map.side_px = side_px;
  map.fresh = true;
  if (sky_.handle) write_set();
  return {};
}

Status FrameResources::set_shadow_side(int side_px) {
  return set_side(shadow_, side_px, static_cast<std::uint32_t>(view_gpu::kSunCascades), true);
}

Status FrameResources::set_zenith_side(int side_px) { return set_side(zenith_, side_px, 1, false); }

void FrameResources::write_set() {
  const VkDescriptorBufferInfo buffer{uniforms_.handle.get(), 0, sizeof(view_gpu::ViewFrame)};
  const VkDescriptorImageInfo sky{sky_sampler_.get(), sky_.view.get(),
                                  VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL};
  const VkDescriptorImageInfo shadow{VK_NULL_HANDLE, shadow_.image.view.get(),
                                     VK_IMAGE_LAYOUT_DEPTH_STENCIL_READ_ONLY_OPTIMAL};
  const VkDescriptorImageInfo zenith{VK_NULL_HANDLE, zenith_.image.view.get(),
                                     VK_IMAGE_LAYOUT_DEPTH_STENCIL_READ_ONLY_OPTIMAL};
  std::array<VkWriteDescriptorSet, 4> write{};
  for (std::uint32_t i = 0; i < write.size(); ++i) {
    write[i].sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    write[i].dstSet = set_;
    write[i].dstBinding = i;
    write[i].descriptorCount = 1;
  }
  write[0].descriptorType = VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER;
  write[0].pBufferInfo = &buffer;
  write[1].descriptorType = VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER;
  write[1].pImageInfo = &sky;
  write[2].descriptorType = VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE;
  write[2].pImageInfo = &shadow;
  write[3].descriptorType = VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE;
  write[3].pImageInfo = &zenith;
  vkUpdateDescriptorSets(gpu_.device, write.size(), write.data(), 0, nullptr);
}

void FrameResources::write(const view_gpu::ViewFrame& uniforms) {
  std::memcpy(uniforms_.data, &uniforms, sizeof uniforms);
}

void FrameResources::record_begin(VkCommandBuffer commands) {
  for (DepthMap* map : {&shadow_, &zenith_}) {
    if (!map->fresh) continue;
    const std::array change{image_change(
        map->image.handle.get(), {VK_IMAGE_ASPECT_DEPTH_BIT, 0, 1, 0, VK_REMAINING_ARRAY_LAYERS},
        VK_IMAGE_LAYOUT_UNDEFINED, VK_IMAGE_LAYOUT_DEPTH_STENCIL_READ_ONLY_OPTIMAL,
        {VK_PIPELINE_STAGE_2_NONE, 0, VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT, VK_ACCESS_2_SHADER_READ_BIT})};
    barrier(commands, change);
    map->fresh = false;
  }
}

void FrameResources::record_shadows(VkCommandBuffer commands, const DrawLists& lists,
                                    std::span<const std::vector<DrawCall>> cascades, bool instancing) {
  record_depth(commands, lists, shadow_, cascades, 0, instancing);
}

void FrameResources::record_zenith(VkCommandBuffer commands, const DrawLists& lists,
                                   const std::vector<DrawCall>& calls, bool instancing) {
  record_depth(commands, lists, zenith_, {&calls, 1}, static_cast<std::uint32_t>(view_gpu::kZenith),
               instancing);
}

void FrameResources::record_depth(VkCommandBuffer commands, const DrawLists& lists, const DepthMap& map,
                                  std::span<const std::vector<DrawCall>> layers, std::uint32_t first_cascade,
                                  bool instancing) {
  if (layers.empty()) return;
  const VkImageSubresourceRange range{VK_IMAGE_ASPECT_DEPTH_BIT, 0, 1, 0,
                                      static_cast<std::uint32_t>(layers.size())};
  const std::array before{image_change(
      map.image.handle.get(), range, VK_IMAGE_LAYOUT_UNDEFINED, VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL,
      {VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT, VK_ACCESS_2_SHADER_READ_BIT, kDepthStages, kDepthAccess})};
  barrier(commands, before);
  for (std::size_t i = 0; i < layers.size(); ++i) {
    VkRenderingAttachmentInfo depth{};
    depth.sType = VK_STRUCTURE_TYPE_RENDERING_ATTACHMENT_INFO;
    depth.imageView = map.layers[i].get();
    depth.imageLayout = VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL;
    depth.loadOp = VK_ATTACHMENT_LOAD_OP_CLEAR;
    depth.storeOp = VK_ATTACHMENT_STORE_OP_STORE;
    depth.clearValue.depthStencil.depth = 1.0F;
    VkRenderingInfo info{};
    info.sType = VK_STRUCTURE_TYPE_RENDERING_INFO;
    info.renderArea.extent = {static_cast<std::uint32_t>(map.side_px),
                              static_cast<std::uint32_t>(map.side_px)};
    info.layerCount = 1;
    info.pDepthAttachment = &depth;
    vkCmdBeginRendering(commands, &info);
    const VkViewport viewport{0, 0, static_cast<float>(map.side_px), static_cast<float>(map.side_px), 0, 1};
    vkCmdSetViewport(commands, 0, 1, &viewport);
    vkCmdSetScissor(commands, 0, 1, &info.renderArea);
    vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipelines_.draw(), 0, 1, &set_, 0,
                            nullptr);
    const view_gpu::uvec4 push{first_cascade + static_cast<std::uint32_t>(i), 0, 0, 0};
    vkCmdPushConstants(commands, pipelines_.draw(), kDrawStages, 0, sizeof push, &push);
    lists.record(commands, layers[i], instancing);
    vkCmdEndRendering(commands);
  }
  const std::array after{image_change(
      map.image.handle.get(), range, VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL,
      VK_IMAGE_LAYOUT_DEPTH_STENCIL_READ_ONLY_OPTIMAL,
      {kDepthStages, kDepthAccess, VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT, VK_ACCESS_2_SHADER_READ_BIT})};
  barrier(commands, after);
}

Status TilePass::record(VkCommandBuffer commands, const FrameTargets& targets, int width_px, int height_px,
                        bool multisampled) {
  auto pipeline = pipelines_.get(ViewPass::depth_tiles, multisampled ? kFeatureMultisampled : 0U);
  if (!pipeline) return tl::unexpected(pipeline.error());
  const auto columns = static_cast<std::uint32_t>(DepthTiles::count(width_px));
  const auto rows = static_cast<std::uint32_t>(DepthTiles::count(height_px));
  if (auto r =
          reserve(gpu_, tiles_, sizeof(float) * columns * rows, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT, true);
      !r)
    return tl::unexpected(r.error());
  if (set_ == VK_NULL_HANDLE) {
    const std::array sizes{VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE, 1},
                           VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1}};
    auto set = make_descriptor_set(gpu_, pipelines_.tiles_layout(), sizes, pool_);
    if (!set) return tl::unexpected(set.error());
    set_ = *set;
  }
  const VkDescriptorImageInfo image{VK_NULL_HANDLE, targets.depth_view(),
                                    VK_IMAGE_LAYOUT_DEPTH_STENCIL_READ_ONLY_OPTIMAL};
  const VkDescriptorBufferInfo buffer{tiles_.handle.get(), 0, VK_WHOLE_SIZE};
  std::array<VkWriteDescriptorSet, 2> write{};
  for (std::uint32_t i = 0; i < 2; ++i) {
    write[i].sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    write[i].dstSet = set_;
    write[i].dstBinding = i;
    write[i].descriptorCount = 1;
    write[i].descriptorType = i == 0 ? VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE : VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
  }
  write[0].pImageInfo = &image;
  write[1].pBufferInfo = &buffer;
  vkUpdateDescriptorSets(gpu_.device, write.size(), write.data(), 0, nullptr);
  targets.record_depth_for_reading(commands);
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, *pipeline);
  vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipelines_.tiles(), 0, 1, &set_, 0,
                          nullptr);
  const view_gpu::uvec4 size{static_cast<std::uint32_t>(width_px), static_cast<std::uint32_t>(height_px),
                             columns, rows};
  vkCmdPushConstants(commands, pipelines_.tiles(), VK_SHADER_STAGE_COMPUTE_BIT, 0, sizeof size, &size);
  vkCmdDispatch(commands, (columns + 7) / 8, (rows + 7) / 8, 1);
  barrier(commands, Hazard{VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT, VK_ACCESS_2_SHADER_WRITE_BIT,
                           VK_PIPELINE_STAGE_2_HOST_BIT, VK_ACCESS_2_HOST_READ_BIT});
  targets.record_depth_for_drawing(commands);
  return {};
}

DepthTiles TilePass::read(int width_px, int height_px, double near_m) const {
  const std::size_t n = static_cast<std::size_t>(DepthTiles::count(width_px)) * DepthTiles::count(height_px);
  return {width_px, height_px, near_m, std::span(reinterpret_cast<const float*>(tiles_.data), n)};
}

Status record_sky(VkCommandBuffer commands, ViewPipelines& pipelines, std::uint32_t features) {
  auto pipeline =
      pipelines.get(ViewPass::sky, features & (kFeatureHaze | kFeatureMultisampled | kFeatureNormals));
  if (!pipeline) return tl::unexpected(pipeline.error());
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, *pipeline);
  vkCmdDraw(commands, 3, 1, 0, 0);
  return {};
}

Status ParticlePass::prepare(const std::vector<Particle>& particles) {
  count_ = static_cast<std::uint32_t>(particles.size());
  if (count_ == 0) return {};
  const std::size_t bytes = particles.size() * sizeof(Particle);
  if (auto r = reserve(gpu_, buffer_, bytes, VK_BUFFER_USAGE_VERTEX_BUFFER_BIT); !r)
    return tl::unexpected(r.error());
  std::memcpy(buffer_.data, particles.data(), bytes);
  return {};
}

Status ParticlePass::record(VkCommandBuffer commands, std::uint32_t features) const {
  auto pipeline = pipelines_.get(ViewPass::particles, features);
  if (!pipeline) return tl::unexpected(pipeline.error());
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, *pipeline);
  const VkBuffer buffer = buffer_.handle.get();
  constexpr VkDeviceSize kStart = 0;
  vkCmdBindVertexBuffers(commands, 1, 1, &buffer, &kStart);
  vkCmdDraw(commands, 4, count_, 0, 0);
  return {};
}

}  // namespace rigor::render
