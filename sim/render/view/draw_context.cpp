#include "sim/render/view/draw_context.h"

namespace rigor::render {

Status DrawContext::create() {
  if (auto s = pipelines.create(); !s) return s;
  if (auto s = resources.create(); !s) return s;
  textures = std::make_unique<TexturePool>(gpu(), pipelines.surface_layout(), uploads);
  if (auto s = textures->create(); !s) return s;
  content = std::make_unique<ResidentContent>(gpu(), *textures);
  VkCommandPoolCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO;
  info.queueFamilyIndex = gpu().queue_family;
  VkCommandPool pool_handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateCommandPool(gpu().device, &info, nullptr, &pool_handle); r != VK_SUCCESS)
    return vk::failed("making a command pool", r);
  pool = vk::CommandPool(gpu().device, pool_handle);
  VkCommandBufferAllocateInfo allocate{};
  allocate.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO;
  allocate.commandPool = pool_handle;
  allocate.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
  allocate.commandBufferCount = 1;
  if (const VkResult r = vkAllocateCommandBuffers(gpu().device, &allocate, &commands); r != VK_SUCCESS)
    return vk::failed("making a command buffer", r);
  VkFenceCreateInfo fence_info{};
  fence_info.sType = VK_STRUCTURE_TYPE_FENCE_CREATE_INFO;
  VkFence fence_handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateFence(gpu().device, &fence_info, nullptr, &fence_handle); r != VK_SUCCESS)
    return vk::failed("making a fence", r);
  fence = vk::Fence(gpu().device, fence_handle);
  return {};
}

Status DrawContext::begin() {
  if (const VkResult r = vkResetCommandPool(gpu().device, pool.get(), 0); r != VK_SUCCESS)
    return vk::failed("resetting a command pool", r);
  VkCommandBufferBeginInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO;
  info.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
  if (const VkResult r = vkBeginCommandBuffer(commands, &info); r != VK_SUCCESS)
    return vk::failed("beginning a command buffer", r);
  return {};
}

Status DrawContext::submit() {
  if (const VkResult r = vkEndCommandBuffer(commands); r != VK_SUCCESS)
    return vk::failed("recording a command buffer", r);
  auto done = gpu().run(commands, fence.get());
  if (done) uploads.done();
  return done;
}

Status DrawContext::take_over(const ContentFrame& frame, std::vector<const ResidentBatch*>& batches,
                              ViewStatistics& s) {
  for (const auto& b : frame.batches) {
    auto resident = content->get(b, frame_number);
    if (!resident) return tl::unexpected(resident.error());
    if (b) s.instances += b->instances.size();
    if (*resident == nullptr) continue;
    s.instances_skipped += (*resident)->skipped;
    if (!(*resident)->spheres.empty()) batches.push_back(*resident);
  }
  s.batches += frame.batches.size();
  s.uploaded_bytes += content->take_uploaded_bytes() + uploads.bytes();
  return {};
}

void DrawContext::bind_frame() const {
  const VkDescriptorSet set = resources.set();
  vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipelines.draw(), 0, 1, &set, 0,
                          nullptr);
}

void DrawContext::drop_unseen() {
  if (frame_number <= kFramesKept) return;
  content->drop_older_than(frame_number - kFramesKept);
  textures->drop_older_than(frame_number - kFramesKept);
}

}  // namespace rigor::render
