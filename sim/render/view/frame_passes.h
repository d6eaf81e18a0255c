// What the passes of a frame share, and their recording. Internal to sim/render/view.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "sim/render/view/culling.h"
#include "sim/render/view/draw_lists.h"
#include "sim/render/view/frame_targets.h"
#include "sim/render/view/particles.h"
#include "sim/render/view/shadow_map.h"
#include "sim/render/view/sky_light.h"
#include "sim/render/view/texture_pool.h"

namespace rigor::render {

/// The frame's own set of descriptors: uniforms, sky, shadow maps.
class FrameResources {
 public:
  FrameResources(const Device::Impl& gpu, ViewPipelines& pipelines, ImageUploads& uploads)
      : gpu_(gpu),
        pipelines_(pipelines),
        uploads_(uploads),
        shadow_(gpu, pipelines, view_gpu::kSunCascades, 0, true),
        zenith_(gpu, pipelines, 1, view_gpu::kZenith, false) {}
  [[nodiscard]] Status create();
  /// The sky's texture in these bands; made anew where map or bands are others than last.
  [[nodiscard]] Status set_sky(const std::shared_ptr<const SkyMap>& map, const view_gpu::Bands& bands);
  [[nodiscard]] const SkyLight& sky() const { return sky_light_; }
  [[nodiscard]] float sky_scale() const { return sky_scale_; }
  /// Shadow maps of this size; they can be sampled only after they have been recorded.
  [[nodiscard]] Status set_shadow_side(int side_px) { return set_side(shadow_, side_px); }
  [[nodiscard]] Status set_zenith_side(int side_px) { return set_side(zenith_, side_px); }
  [[nodiscard]] ShadowMap& shadow() { return shadow_; }
  [[nodiscard]] ShadowMap& zenith() { return zenith_; }
  void write(const view_gpu::ViewFrame& uniforms);
  /// Before anything else in the frame.
  void record_begin(VkCommandBuffer commands);
  [[nodiscard]] VkDescriptorSet set() const { return set_; }

 private:
  [[nodiscard]] Status set_side(ShadowMap& map, int side_px);
  void write_set();
  const Device::Impl& gpu_;
  ViewPipelines& pipelines_;
  ImageUploads& uploads_;
  vk::Buffer uniforms_;
  vk::DescriptorPool pool_;
  VkDescriptorSet set_ = VK_NULL_HANDLE;
  vk::Sampler sky_sampler_;
  vk::Image sky_;
  VkFormat sky_format_ = VK_FORMAT_R32G32B32A32_SFLOAT;
  std::uint64_t sky_serial_ = ~std::uint64_t{0};
  view_gpu::Bands sky_bands_{-1, -1, -1, -1};
  SkyLight sky_light_{};
  float sky_scale_ = 1;
  ShadowMap shadow_, zenith_;
};

/// Farthest depths of tiles, computed on the device.
class TilePass {
 public:
  TilePass(const Device::Impl& gpu, ViewPipelines& pipelines) : gpu_(gpu), pipelines_(pipelines) {}
  [[nodiscard]] Status record(VkCommandBuffer commands, const FrameTargets& targets, int width_px,
                              int height_px, bool multisampled);
  /// After the work is done.
  [[nodiscard]] DepthTiles read(int width_px, int height_px, double near_m) const;

 private:
  const Device::Impl& gpu_;
  ViewPipelines& pipelines_;
  vk::Buffer tiles_;
  vk::DescriptorPool pool_;
  VkDescriptorSet set_ = VK_NULL_HANDLE;
};

/// A full-screen sky behind what was drawn.
[[nodiscard]] Status record_sky(VkCommandBuffer commands, ViewPipelines& pipelines, std::uint32_t features);

/// Rain and snow in the air.
class ParticlePass {
 public:
  ParticlePass(const Device::Impl& gpu, ViewPipelines& pipelines) : gpu_(gpu), pipelines_(pipelines) {}
  [[nodiscard]] Status prepare(const std::vector<Particle>& particles);
  [[nodiscard]] Status record(VkCommandBuffer commands, std::uint32_t features) const;
  [[nodiscard]] bool any() const { return count_ > 0; }

 private:
  const Device::Impl& gpu_;
  ViewPipelines& pipelines_;
  vk::Buffer buffer_;
  std::uint32_t count_ = 0;
};

}  // namespace rigor::render
