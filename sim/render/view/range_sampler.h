// Rays, sampled from a range view on the device. Internal to sim/render/view.
#pragma once

#include <span>

#include "sim/render/view/range_targets.h"
#include "sim/render/view/ray_faces.h"
#include "sim/render/view/view_pipelines.h"
#include "sim/render/view/view_structs.h"

namespace rigor::render {

class RangeSampler {
 public:
  RangeSampler(const Device::Impl& gpu, ViewPipelines& pipelines) : gpu_(gpu), pipelines_(pipelines) {}
  /// Room for so many rays at a time.
  [[nodiscard]] Status prepare(std::size_t rays);
  /// To be filled before the work is submitted.
  [[nodiscard]] std::span<view_gpu::RayData> rays(std::size_t n) const;
  /// After the work is done.
  [[nodiscard]] std::span<const view_gpu::HitData> hits(std::size_t n) const;
  /// The first n rays, from a view that has ended. `axes`: of the face, in the world.
  [[nodiscard]] Status record(VkCommandBuffer commands, const RangeTargets& targets, const RayFace& face,
                              double near_m, std::size_t n);

 private:
  const Device::Impl& gpu_;
  ViewPipelines& pipelines_;
  vk::Buffer rays_, hits_;
  vk::DescriptorPool pool_;
  VkDescriptorSet set_ = VK_NULL_HANDLE;
};

}  // namespace rigor::render
