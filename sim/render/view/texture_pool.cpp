#include "sim/render/view/texture_pool.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "sim/render/content/texels.h"

namespace rigor::render {

Result<vk::Sampler> make_sampler(const Device::Impl& gpu, VkSamplerAddressMode mode) {
  VkSamplerCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_SAMPLER_CREATE_INFO;
  info.magFilter = info.minFilter = VK_FILTER_LINEAR;
  info.mipmapMode = VK_SAMPLER_MIPMAP_MODE_LINEAR;
  info.addressModeU = info.addressModeV = info.addressModeW = mode;
  info.maxLod = VK_LOD_CLAMP_NONE;
  VkSampler handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateSampler(gpu.device, &info, nullptr, &handle); r != VK_SUCCESS)
    return vk::failed("making a sampler", r);
  return vk::Sampler(gpu.device, handle);
}

Status ImageUploads::add(VkImage image, const std::vector<Level>& levels) {
  std::size_t total = 0;
  for (const Level& l : levels) total += (l.bytes.size() + 15) & ~std::size_t{15};
  Pending p;
  p.image = image;
  auto staging = gpu_.make_buffer(total, VK_BUFFER_USAGE_TRANSFER_SRC_BIT);
  if (!staging) return tl::unexpected(staging.error());
  p.staging = std::move(*staging);
  std::size_t offset = 0;
  for (std::size_t i = 0; i < levels.size(); ++i) {
    std::memcpy(p.staging.data + offset, levels[i].bytes.data(), levels[i].bytes.size());
    VkBufferImageCopy c{};
    c.bufferOffset = offset;
    c.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, static_cast<std::uint32_t>(i), 0, 1};
    c.imageExtent = {levels[i].width, levels[i].height, 1};
    p.copies.push_back(c);
    offset += (levels[i].bytes.size() + 15) & ~std::size_t{15};
  }
  pending_.push_back(std::move(p));
  return {};
}

std::size_t ImageUploads::bytes() const {
  std::size_t n = 0;
  for (const Pending& p : pending_) n += p.staging.size_bytes;
  return n;
}

void ImageUploads::record(VkCommandBuffer commands) {
  for (const Pending& p : pending_) {
    VkImageMemoryBarrier2 b{};
    b.sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER_2;
    b.srcQueueFamilyIndex = b.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
    b.image = p.image;
    b.subresourceRange = {VK_IMAGE_ASPECT_COLOR_BIT, 0, static_cast<std::uint32_t>(p.copies.size()), 0, 1};
    b.newLayout = VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL;
    b.dstStageMask = VK_PIPELINE_STAGE_2_COPY_BIT;
    b.dstAccessMask = VK_ACCESS_2_TRANSFER_WRITE_BIT;
    VkDependencyInfo info{};
    info.sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO;
    info.imageMemoryBarrierCount = 1;
    info.pImageMemoryBarriers = &b;
    vkCmdPipelineBarrier2(commands, &info);
    vkCmdCopyBufferToImage(commands, p.staging.handle.get(), p.image, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL,
                           static_cast<std::uint32_t>(p.copies.size()), p.copies.data());
    b.oldLayout = VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL;
    b.newLayout = VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL;
    b.srcStageMask = VK_PIPELINE_STAGE_2_COPY_BIT;
    b.srcAccessMask = VK_ACCESS_2_TRANSFER_WRITE_BIT;
    b.dstStageMask = VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT;
    b.dstAccessMask = VK_ACCESS_2_SHADER_READ_BIT;
    vkCmdPipelineBarrier2(commands, &info);
  }
}

TexturePool::TexturePool(const Device::Impl& gpu, VkDescriptorSetLayout set_layout, ImageUploads& uploads)
    : gpu_(gpu),
      set_layout_(set_layout),
      uploads_(uploads),
      uniforms_(gpu, {.block_bytes = 256u << 10,
                      .usage = VK_BUFFER_USAGE_UNIFORM_BUFFER_BIT,
                      .alignment = std::max<std::size_t>(gpu.limits.minUniformBufferOffsetAlignment, 64)}) {
  Surface grey;
  grey.name = "unknown";
  grey_ = std::make_shared<const Surface>(std::move(grey));
}

Status TexturePool::create() {
  auto repeat = make_sampler(gpu_, VK_SAMPLER_ADDRESS_MODE_REPEAT);
  if (!repeat) return tl::unexpected(repeat.error());
  repeat_ = std::move(*repeat);
  auto clamp = make_sampler(gpu_, VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE);
  if (!clamp) return tl::unexpected(clamp.error());
  clamp_ = std::move(*clamp);
  auto white = gpu_.make_image({.format = VK_FORMAT_R8G8B8A8_UNORM,
                                .usage = VK_IMAGE_USAGE_TRANSFER_DST_BIT | VK_IMAGE_USAGE_SAMPLED_BIT});
  if (!white) return tl::unexpected(white.error());
  white_ = std::move(*white);
  return uploads_.add(white_.handle.get(), {{1, 1, std::vector<std::byte>(4, std::byte{255})}});
}

Result<TexturePool::ResidentTexture*> TexturePool::texture(const std::shared_ptr<const Texture>& t,
                                                           float cutoff, std::uint64_t frame) {
  ResidentTexture* const none = nullptr;
  if (usable(t) == nullptr || std::max(t->width, t->height) > gpu_.limits.maxImageDimension2D) return none;
  const TextureKey key{t->serial, std::bit_cast<std::uint32_t>(cutoff)};
  auto& slot = textures_[key];
  if (!slot) {
    const auto levels = make_mips(*t, cutoff);
    auto made = gpu_.make_image({.format = t->srgb ? VK_FORMAT_R8G8B8A8_SRGB : VK_FORMAT_R8G8B8A8_UNORM,
                                 .width = t->width,
                                 .height = t->height,
                                 .mip_levels = static_cast<std::uint32_t>(levels.size()),
                                 .usage = VK_IMAGE_USAGE_TRANSFER_DST_BIT | VK_IMAGE_USAGE_SAMPLED_BIT});
    if (!made) return tl::unexpected(made.error());
    if (auto s = uploads_.add(made->handle.get(), levels); !s) return tl::unexpected(s.error());
    slot = std::make_unique<ResidentTexture>();
    slot->image = std::move(*made);
    slot->repeat = t->repeat;
  }
  slot->last_seen = frame;
  return slot.get();
}

Result<VkDescriptorSet> TexturePool::make_set(std::pair<VkDescriptorPool, VkDescriptorSet>& out) {
  constexpr std::uint32_t kSets = 256;
  VkDescriptorSetAllocateInfo allocate{};
  allocate.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO;
  allocate.descriptorSetCount = 1;
  allocate.pSetLayouts = &set_layout_;
  for (auto it = pools_.rbegin(); it != pools_.rend(); ++it) {
    allocate.descriptorPool = it->get();
    if (vkAllocateDescriptorSets(gpu_.device, &allocate, &out.second) == VK_SUCCESS) {
      out.first = it->get();
      return out.second;
    }
  }
  const std::array sizes{VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, kSets},
                         VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER, 4 * kSets}};
  VkDescriptorPoolCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO;
  info.flags = VK_DESCRIPTOR_POOL_CREATE_FREE_DESCRIPTOR_SET_BIT;
  info.maxSets = kSets;
  info.poolSizeCount = sizes.size();
  info.pPoolSizes = sizes.data();
  VkDescriptorPool pool = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateDescriptorPool(gpu_.device, &info, nullptr, &pool); r != VK_SUCCESS)
    return vk::failed("making a descriptor pool", r);
  pools_.emplace_back(gpu_.device, pool);
  allocate.descriptorPool = pool;
  if (const VkResult r = vkAllocateDescriptorSets(gpu_.device, &allocate, &out.second); r != VK_SUCCESS)
    return vk::failed("making a descriptor set", r);
  out.first = pool;
  return out.second;
}

void TexturePool::write_uniforms(const ResidentSurface& s) const {
  const Surface& a = *s.surface;
  view_gpu::SurfaceData d;
  d.reflectance = view_gpu::pick(a.reflectance, bands_);
  d.transmittance = view_gpu::pick(a.transmittance, bands_);
  const bool nir = (s.features & kFeatureNearInfraredMap) != 0;
  view_gpu::put(colour_to_band(bands_, !nir), d.colour_to_band);
  view_gpu::put(near_infrared_to_band(bands_), d.near_infrared_to_band);
  d.gloss = {std::clamp(a.roughness, 0.0F, 1.0F), std::clamp(a.metallic, 0.0F, 1.0F), a.alpha_cutoff,
             std::clamp(a.porosity, 0.0F, 1.0F)};
  d.flags = {a.takes_snow ? 1.0F : 0.0F, a.retro_reflection > 0 ? std::min(a.retro_reflection, 1.0F) : 0.0F,
             0, 0};
  std::memcpy(s.uniforms.data, &d, sizeof d);
}

Result<const ResidentSurface*> TexturePool::get(const std::shared_ptr<const Surface>& wanted,
                                                std::uint64_t frame) {
  const std::shared_ptr<const Surface>& surface = wanted ? wanted : grey_;
  auto& slot = surfaces_[surface->serial];
  if (slot && slot->last_seen == frame) return static_cast<const ResidentSurface*>(slot.get());
  if (slot) {
    slot->last_seen = frame;
    for (const TextureKey& k : slot->maps)
      if (k.serial != 0) textures_.at(k)->last_seen = frame;
    return static_cast<const ResidentSurface*>(slot.get());
  }
  auto made = std::make_unique<SurfaceSlot>();
  made->surface = surface;
  made->last_seen = frame;
  const float cutoff = surface->alpha_cutoff > 0 ? surface->alpha_cutoff : 0.0F;
  const std::array<std::shared_ptr<const Texture>, 4> maps{surface->colour_map, surface->near_infrared_map,
                                                           surface->normal_map, surface->gloss_map};
  std::array<VkDescriptorImageInfo, 4> images{};
  for (std::size_t i = 0; i < 4; ++i) {
    const float map_cutoff = i == 0 ? cutoff : 0.0F;
    auto t = texture(maps[i], map_cutoff, frame);
    if (!t) {
      surfaces_.erase(surface->serial);
      return tl::unexpected(t.error());
    }
    const bool there = *t != nullptr;
    images[i] = {there && !(*t)->repeat ? clamp_.get() : repeat_.get(),
                 there ? (*t)->image.view.get() : white_.view.get(),
                 VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL};
    if (!there) continue;
    made->features |= 1u << i;
    made->maps[i] = {maps[i]->serial, std::bit_cast<std::uint32_t>(map_cutoff)};
  }
  const auto any = [](const Spectrum& s) {
    return std::any_of(s.begin(), s.end(), [](float v) { return v > 0; });
  };
  if (cutoff > 0 && (made->features & kFeatureColourMap) != 0) made->features |= kFeatureAlpha;
  if (any(surface->transmittance)) made->features |= kFeatureTranslucent;
  if (surface->water) made->features |= kFeatureWater;
  if (surface->roughness < 1 || surface->metallic > 0 || (made->features & kFeatureGlossMap) != 0)
    made->features |= kFeatureGlossy;
  if (surface->two_sided) made->features |= kFeatureTwoSided;
  auto uniforms = uniforms_.take(sizeof(view_gpu::SurfaceData));
  std::pair<VkDescriptorPool, VkDescriptorSet> set{};
  auto ok = uniforms ? make_set(set) : Result<VkDescriptorSet>(tl::unexpected(uniforms.error()));
  if (!ok) {
    surfaces_.erase(surface->serial);
    return tl::unexpected(ok.error());
  }
  made->uniforms = *uniforms;
  made->pool = set.first;
  made->set = set.second;
  write_uniforms(*made);
  const VkDescriptorBufferInfo buffer{made->uniforms.buffer, made->uniforms.offset,
                                      sizeof(view_gpu::SurfaceData)};
  std::array<VkWriteDescriptorSet, 5> write{};
  for (std::uint32_t i = 0; i < 5; ++i) {
    write[i].sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    write[i].dstSet = made->set;
    write[i].dstBinding = i;
    write[i].descriptorCount = 1;
    write[i].descriptorType =
        i == 0 ? VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER : VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER;
    if (i == 0)
      write[i].pBufferInfo = &buffer;
    else
      write[i].pImageInfo = &images[i - 1];
  }
  vkUpdateDescriptorSets(gpu_.device, write.size(), write.data(), 0, nullptr);
  slot = std::move(made);
  return static_cast<const ResidentSurface*>(slot.get());
}

void TexturePool::set_bands(const view_gpu::Bands& bands) {
  if (bands == bands_) return;
  bands_ = bands;
  for (const auto& [serial, s] : surfaces_) write_uniforms(*s);
}

void TexturePool::drop_older_than(std::uint64_t frame) {
  std::erase_if(surfaces_, [&](auto& entry) {
    SurfaceSlot& s = *entry.second;
    if (s.last_seen >= frame) return false;
    uniforms_.give(s.uniforms);
    vkFreeDescriptorSets(gpu_.device, s.pool, 1, &s.set);
    return true;
  });
  std::erase_if(textures_, [&](const auto& entry) { return entry.second->last_seen < frame; });
}

}  // namespace rigor::render
