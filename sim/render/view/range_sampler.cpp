#include "sim/render/view/range_sampler.h"

#include <algorithm>
#include <array>

#include "sim/render/view/gpu_arena.h"

namespace rigor::render {

Status RangeSampler::prepare(std::size_t rays) {
  for (auto [buffer, bytes] : {std::pair{&rays_, rays * sizeof(view_gpu::RayData)},
                               std::pair{&hits_, rays * sizeof(view_gpu::HitData)}})
    if (auto r = reserve(gpu_, *buffer, bytes, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT, true); !r)
      return tl::unexpected(r.error());
  if (set_ != VK_NULL_HANDLE) return {};
  const std::array sizes{VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE, 3},
                         VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 2}};
  auto set = make_descriptor_set(gpu_, pipelines_.rays_layout(), sizes, pool_);
  if (!set) return tl::unexpected(set.error());
  set_ = *set;
  return {};
}

std::span<view_gpu::RayData> RangeSampler::rays(std::size_t n) const {
  return {reinterpret_cast<view_gpu::RayData*>(rays_.data), n};
}
std::span<const view_gpu::HitData> RangeSampler::hits(std::size_t n) const {
  return {reinterpret_cast<const view_gpu::HitData*>(hits_.data), n};
}

Status RangeSampler::record(VkCommandBuffer commands, const RangeTargets& targets, const RayFace& face,
                            double near_m, std::size_t n) {
  auto pipeline = pipelines_.get(ViewPass::sample_rays);
  if (!pipeline) return tl::unexpected(pipeline.error());
  std::array<VkDescriptorImageInfo, 3> images{};
  const std::array buffers{VkDescriptorBufferInfo{rays_.handle.get(), 0, VK_WHOLE_SIZE},
                           VkDescriptorBufferInfo{hits_.handle.get(), 0, VK_WHOLE_SIZE}};
  std::array<VkWriteDescriptorSet, 5> write{};
  for (std::uint32_t i = 0; i < write.size(); ++i) {
    write[i].sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    write[i].dstSet = set_;
    write[i].dstBinding = i;
    write[i].descriptorCount = 1;
    write[i].descriptorType = i < 3 ? VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE : VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
    if (i < 3) {
      images[i] = {VK_NULL_HANDLE, targets.view(i), VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL};
      write[i].pImageInfo = &images[i];
    } else {
      write[i].pBufferInfo = &buffers[i - 3];
    }
  }
  vkUpdateDescriptorSets(gpu_.device, write.size(), write.data(), 0, nullptr);
  struct {
    view_gpu::vec4 axis, per_u, per_v;
    view_gpu::uvec4 size;
  } push;
  static_assert(sizeof push == kRaysPushBytes);
  const Pinhole& p = face.pinhole;
  const Eigen::Vector3d right = face.R_world_face.col(0) / p.fx_px, down = face.R_world_face.col(1) / p.fy_px;
  push.axis = view_gpu::xyz(face.R_world_face.col(2) - right * p.cx_px - down * p.cy_px, near_m);
  push.per_u = view_gpu::xyz(right, 1.0 / p.fx_px);
  push.per_v = view_gpu::xyz(down);
  push.size = {static_cast<std::uint32_t>(p.width_px), static_cast<std::uint32_t>(p.height_px), 0,
               static_cast<std::uint32_t>(n)};
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, *pipeline);
  vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipelines_.rays(), 0, 1, &set_, 0,
                          nullptr);
  vkCmdPushConstants(commands, pipelines_.rays(), VK_SHADER_STAGE_COMPUTE_BIT, 0, sizeof push, &push);
  const auto groups = static_cast<std::uint32_t>((n + 63) / 64);
  vkCmdDispatch(commands, std::min(groups, 65535U), (groups + 65534) / 65535, 1);
  barrier(commands, Hazard{VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT, VK_ACCESS_2_SHADER_WRITE_BIT,
                           VK_PIPELINE_STAGE_2_HOST_BIT, VK_ACCESS_2_HOST_READ_BIT});
  return {};
}

}  // namespace rigor::render
