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

Status FrameResources::set_side(ShadowMap& map, int side_px) {
  auto another = map.set_side(side_px);
  if (!another) return tl::unexpected(another.error());
  if (*another && sky_.handle) write_set();
  return {};
}

void FrameResources::write_set() {
  const VkDescriptorBufferInfo buffer{uniforms_.handle.get(), 0, sizeof(view_gpu::ViewFrame)};
  const VkDescriptorImageInfo sky{sky_sampler_.get(), sky_.view.get(),
                                  VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL};
  const VkDescriptorImageInfo shadow{VK_NULL_HANDLE, shadow_.view(),
                                     VK_IMAGE_LAYOUT_DEPTH_STENCIL_READ_ONLY_OPTIMAL};
  const VkDescriptorImageInfo zenith{VK_NULL_HANDLE, zenith_.view(),
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
  shadow_.record_begin(commands);
  zenith_.record_begin(commands);
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
