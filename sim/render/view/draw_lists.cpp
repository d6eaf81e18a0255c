#include "sim/render/view/draw_lists.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <tuple>

#include "sim/render/view/gpu_commands.h"
#include "sim/render/view/impostors.h"

namespace rigor::render {
namespace {

constexpr std::uint32_t kMostSets = 256;

/// What range views need of a surface: no light.
constexpr std::uint32_t kRangeFeatures = kFeatureColourMap | kFeatureNearInfraredMap | kFeatureNormalMap |
                                         kFeatureGlossMap | kFeatureAlpha | kFeatureTwoSided | kFeatureSway |
                                         kFeatureSnow | kFeatureWet;

/// What depth alone needs.
constexpr std::uint32_t kDepthFeatures =
    kFeatureAlpha | kFeatureTwoSided | kFeatureSway | kFeatureMultisampled;

/// Identities of instances that stand for nothing that is named: shadows.
constexpr std::uint32_t kNoIdentity = 0;

void sort(std::vector<DrawCall>& calls) {
  std::stable_sort(calls.begin(), calls.end(), [](const DrawCall& a, const DrawCall& b) {
    // What has holes comes last: it is the dearest to shade, and hides least.
    const auto rank = [](const DrawCall& c) {
      return std::tuple((c.features & kFeatureAlpha) != 0 || c.mesh == nullptr, c.features, c.surface,
                        c.distance_m, c.mesh_serial);
    };
    return rank(a) < rank(b);
  });
}

}  // namespace

Status DrawLists::begin(std::size_t instances) {
  constexpr VkBufferUsageFlags kStorage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT;
  if (instances > most_instances())
    return fail(ErrorCode::unavailable, gpu_.name,
                "expected at most " + std::to_string(most_instances()) + " instances in view, got " +
                    std::to_string(instances) + ": allow a larger error, or look at less at a time");
  if (auto r = reserve(gpu_, entries_, instances * sizeof(view_gpu::DrawEntry), kStorage); !r)
    return tl::unexpected(r.error());
  if (auto r = reserve(gpu_, drawn_, instances * sizeof(view_gpu::DrawnInstance),
                       kStorage | VK_BUFFER_USAGE_VERTEX_BUFFER_BIT);
      !r)
    return tl::unexpected(r.error());
  if (!pool_) {
    const VkDescriptorPoolSize size{VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 3 * kMostSets};
    VkDescriptorPoolCreateInfo info{};
    info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO;
    info.maxSets = kMostSets;
    info.poolSizeCount = 1;
    info.pPoolSizes = &size;
    VkDescriptorPool handle = VK_NULL_HANDLE;
    if (const VkResult r = vkCreateDescriptorPool(gpu_.device, &info, nullptr, &handle); r != VK_SUCCESS)
      return vk::failed("making a descriptor pool", r);
    pool_ = vk::DescriptorPool(gpu_.device, handle);
  }
  vkResetDescriptorPool(gpu_.device, pool_.get(), 0);
  sets_ = 0;
  pending_.clear();
  nodes_.clear();
  surfaces_.clear();
  surface_numbers_.clear();
  count_ = written_ = 0;
  return {};
}

void DrawLists::add_entries(const Bucket& bucket, const Eigen::Vector3d& eye, bool named) {
  const ResidentBatch* last = nullptr;
  view_gpu::vec4 origin;
  for (const Visible& v : bucket.instances) {
    if (v.batch != last) {
      origin = view_gpu::xyz(v.batch->batch->origin - eye);
      last = v.batch;
    }
    std::uint32_t identity = kNoIdentity;
    if (named) {
      nodes_.push_back(v.batch->node(v.index));
      identity = static_cast<std::uint32_t>(nodes_.size());
    }
    pending_.push_back(
        {v.batch->instances.block,
         {origin, {v.batch->first_slot + v.index, count_++, identity, v.batch->seed(v.index)}}});
  }
}

Result<std::vector<DrawCall>> DrawLists::add(const std::vector<Bucket>& buckets, const Eigen::Vector3d& eye,
                                             const FrameFeatures& frame) {
  return add_seen(buckets, eye, frame, ViewPass::surface);
}
Result<std::vector<DrawCall>> DrawLists::add_ranges(const std::vector<Bucket>& buckets,
                                                    const Eigen::Vector3d& eye, const FrameFeatures& frame) {
  return add_seen(buckets, eye, frame, ViewPass::range);
}

Result<std::vector<DrawCall>> DrawLists::add_seen(const std::vector<Bucket>& buckets,
                                                  const Eigen::Vector3d& eye, const FrameFeatures& frame,
                                                  ViewPass pass) {
  std::vector<DrawCall> calls;
  for (const Bucket& b : buckets) {
    if (b.instances.empty()) continue;
    const std::uint32_t first = count_;
    add_entries(b, eye, true);
    DrawCall c;
    c.first_instance = first;
    c.instance_count = static_cast<std::uint32_t>(b.instances.size());
    c.distance_m = b.instances.front().distance_m;
    if (b.impostor != nullptr) {
      c.features =
          frame.all | (frame.snow ? kFeatureSnow : 0U) | (b.impostor->translucent ? kFeatureTranslucent : 0U);
      c.features &= ~static_cast<std::uint32_t>(kFeatureGlossy | kFeatureAfterDepth);
      c.index_count = 4;
      c.set = b.impostor->set;
      c.surface = b.prototype->prototype->serial;
      auto pipeline = pipelines_.get(ViewPass::impostor, c.features);
      if (!pipeline) return tl::unexpected(pipeline.error());
      c.pipeline = *pipeline;
      calls.push_back(c);
      continue;
    }
    c.mesh = b.mesh;
    c.mesh_serial = b.mesh->mesh->serial;
    for (const ResidentPart& part : b.mesh->parts) {
      const ResidentSurface& s = *part.surface;
      c.features = frame.all | s.features;
      if (frame.snow && s.surface->takes_snow) c.features |= kFeatureSnow;
      if (frame.wet && !s.surface->water) c.features |= kFeatureGlossy;
      if (frame.sway && b.prototype->prototype->sway_m > 0) c.features |= kFeatureSway;
      if (pass == ViewPass::range) {
        c.features &= kRangeFeatures;
        const auto [it, fresh] =
            surface_numbers_.try_emplace(s.surface->serial, static_cast<std::uint32_t>(surfaces_.size() + 1));
        if (fresh) surfaces_.push_back(s.surface.get());
        c.named_surface = it->second;
      }
      std::uint32_t shaded = c.features;
      c.depth_pipeline = VK_NULL_HANDLE;
      if ((c.features & kFeatureAfterDepth) != 0) {
        auto depth = pipelines_.get(ViewPass::depth, c.features & kDepthFeatures);
        if (!depth) return tl::unexpected(depth.error());
        c.depth_pipeline = *depth;
        shaded &= ~static_cast<std::uint32_t>(kFeatureAlpha);  // holes are in the depth
      }
      auto pipeline = pipelines_.get(pass, shaded);
      if (!pipeline) return tl::unexpected(pipeline.error());
      c.pipeline = *pipeline;
      c.set = s.set;
      c.surface = s.surface->serial;
      c.first_index = part.first_index;
      c.index_count = part.index_count;
      calls.push_back(c);
    }
  }
  sort(calls);
  return calls;
}

Result<std::vector<DrawCall>> DrawLists::add_casters(const std::vector<Bucket>& buckets,
                                                     const Eigen::Vector3d& middle,
                                                     const FrameFeatures& frame) {
  std::vector<DrawCall> calls;
  for (const Bucket& b : buckets) {
    if (b.instances.empty()) continue;
    DrawCall c;
    c.first_instance = count_;
    c.instance_count = static_cast<std::uint32_t>(b.instances.size());
    add_entries(b, middle, false);
    c.mesh = b.mesh;
    c.mesh_serial = b.mesh->mesh->serial;
    for (const ResidentPart& part : b.mesh->parts) {
      c.features = part.surface->features & kFeatureAlpha;
      if (frame.sway && b.prototype->prototype->sway_m > 0) c.features |= kFeatureSway;
      auto pipeline = pipelines_.get(ViewPass::shadow, c.features);
      if (!pipeline) return tl::unexpected(pipeline.error());
      c.pipeline = *pipeline;
      c.set = (c.features & kFeatureAlpha) != 0 ? part.surface->set : VK_NULL_HANDLE;
      c.surface = c.set != VK_NULL_HANDLE ? part.surface->surface->serial : 0;
      c.first_index = part.first_index;
      c.index_count = part.index_count;
      // Parts without holes need no surface: neighbours in the list of indices are one call.
      if (!calls.empty() && c.set == VK_NULL_HANDLE && calls.back().set == VK_NULL_HANDLE &&
          calls.back().mesh == c.mesh && calls.back().first_instance == c.first_instance &&
          calls.back().features == c.features &&
          calls.back().first_index + calls.back().index_count == c.first_index) {
        calls.back().index_count += c.index_count;
        continue;
      }
      calls.push_back(c);
    }
  }
  sort(calls);
  return calls;
}

Status DrawLists::record_gather(VkCommandBuffer commands, const ResidentContent& content) {
  if (pending_.empty()) return {};
  auto pipeline = pipelines_.get(ViewPass::gather);
  if (!pipeline) return tl::unexpected(pipeline.error());
  std::stable_sort(pending_.begin(), pending_.end(),
                   [](const Pending& a, const Pending& b) { return a.block < b.block; });
  auto* const out = reinterpret_cast<view_gpu::DrawEntry*>(entries_.data) + written_;
  for (std::size_t i = 0; i < pending_.size(); ++i) out[i] = pending_[i].entry;
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, *pipeline);
  for (std::size_t i = 0; i < pending_.size();) {
    std::size_t end = i;
    while (end < pending_.size() && pending_[end].block == pending_[i].block) ++end;
    if (sets_ == kMostSets)
      return fail(ErrorCode::unavailable, gpu_.name,
                  "instances lie in more than " + std::to_string(kMostSets) +
                      " blocks: expected fewer batches of millions");
    ++sets_;
    const VkDescriptorSetLayout layout = pipelines_.gather_layout();
    VkDescriptorSetAllocateInfo allocate{};
    allocate.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO;
    allocate.descriptorPool = pool_.get();
    allocate.descriptorSetCount = 1;
    allocate.pSetLayouts = &layout;
    VkDescriptorSet set = VK_NULL_HANDLE;
    if (const VkResult r = vkAllocateDescriptorSets(gpu_.device, &allocate, &set); r != VK_SUCCESS)
      return vk::failed("making a descriptor set", r);
    const std::array buffers{
        VkDescriptorBufferInfo{content.instance_arena().block(static_cast<std::size_t>(pending_[i].block)), 0,
                               VK_WHOLE_SIZE},
        VkDescriptorBufferInfo{entries_.handle.get(), 0, VK_WHOLE_SIZE},
        VkDescriptorBufferInfo{drawn_.handle.get(), 0, VK_WHOLE_SIZE}};
    VkWriteDescriptorSet write{};
    write.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    write.dstSet = set;
    write.descriptorCount = buffers.size();
    write.descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
    write.pBufferInfo = buffers.data();
    vkUpdateDescriptorSets(gpu_.device, 1, &write, 0, nullptr);
    vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipelines_.gather(), 0, 1, &set, 0,
                            nullptr);
    const view_gpu::uvec4 range{static_cast<std::uint32_t>(written_ + i), static_cast<std::uint32_t>(end - i),
                                0, 0};
    vkCmdPushConstants(commands, pipelines_.gather(), VK_SHADER_STAGE_COMPUTE_BIT, 0, sizeof range, &range);
    const auto groups = static_cast<std::uint32_t>((end - i + 63) / 64);
    vkCmdDispatch(commands, std::min(groups, 65535U), (groups + 65534) / 65535, 1);
    i = end;
  }
  written_ += static_cast<std::uint32_t>(pending_.size());
  pending_.clear();
  barrier(commands, {VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT, VK_ACCESS_2_SHADER_WRITE_BIT,
                     VK_PIPELINE_STAGE_2_VERTEX_ATTRIBUTE_INPUT_BIT, VK_ACCESS_2_VERTEX_ATTRIBUTE_READ_BIT});
  return {};
}

void DrawLists::record(VkCommandBuffer commands, std::span<const DrawCall> calls, bool instancing,
                       bool depth_only) const {
  VkPipeline pipeline = VK_NULL_HANDLE;
  VkDescriptorSet set = VK_NULL_HANDLE;
  const ResidentMesh* mesh = nullptr;
  std::uint32_t named = 0;
  constexpr VkDeviceSize kStart = 0;
  const VkBuffer drawn = drawn_.handle.get();
  if (!calls.empty()) vkCmdBindVertexBuffers(commands, 1, 1, &drawn, &kStart);
  for (const DrawCall& c : calls) {
    const VkPipeline wanted = depth_only ? c.depth_pipeline : c.pipeline;
    if (wanted == VK_NULL_HANDLE) continue;
    if (wanted != pipeline) vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, wanted);
    pipeline = wanted;
    if (c.set != VK_NULL_HANDLE && c.set != set) {
      vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipelines_.draw(), 1, 1, &c.set, 0,
                              nullptr);
      set = c.set;
    }
    if (c.mesh != nullptr && c.mesh != mesh) {
      vkCmdBindVertexBuffers(commands, 0, 1, &c.mesh->vertices.buffer, &c.mesh->vertices.offset);
      vkCmdBindIndexBuffer(commands, c.mesh->indices.buffer, c.mesh->indices.offset, VK_INDEX_TYPE_UINT32);
      mesh = c.mesh;
    }
    if (c.named_surface != named) {
      named = c.named_surface;
      const view_gpu::uvec4 push{named, 0, 0, 0};
      vkCmdPushConstants(commands, pipelines_.draw(), kDrawStages, 0, sizeof push, &push);
    }
    const std::uint32_t step = instancing ? c.instance_count : 1;
    for (std::uint32_t i = 0; i < c.instance_count; i += step) {
      if (c.mesh != nullptr)
        vkCmdDrawIndexed(commands, c.index_count, step, c.first_index, 0, c.first_instance + i);
      else
        vkCmdDraw(commands, c.index_count, step, 0, c.first_instance + i);
    }
  }
}

}  // namespace rigor::render
