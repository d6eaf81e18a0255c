// A compute shader over two storage buffers, run once: what a differential test needs of Vulkan.
#pragma once

#include <array>
#include <cstring>
#include <memory>
#include <span>
#include <vector>

#include "sim/render/device_impl.h"

namespace rigor::test {

class ComputeKernel {
 public:
  static Result<std::unique_ptr<ComputeKernel>> make(render::Device& device,
                                                     std::span<const std::uint32_t> spirv) {
    auto k = std::unique_ptr<ComputeKernel>(new ComputeKernel(device.impl()));
    if (auto s = k->build(spirv); !s) return tl::unexpected<Error>(s.error());
    return k;
  }

  /// One invocation for each of `count` records of 12 floats; 4 floats come back for each.
  Result<std::vector<float>> run(int which, std::span<const float> arguments) {
    const auto count = static_cast<std::uint32_t>(arguments.size() / 12);
    auto in = gpu_.make_buffer(arguments.size_bytes(), VK_BUFFER_USAGE_STORAGE_BUFFER_BIT);
    if (!in) return tl::unexpected<Error>(in.error());
    auto out = gpu_.make_buffer(std::size_t{count} * 16, VK_BUFFER_USAGE_STORAGE_BUFFER_BIT);
    if (!out) return tl::unexpected<Error>(out.error());
    std::memcpy(in->data, arguments.data(), arguments.size_bytes());
    const VkDescriptorBufferInfo buffers[] = {{in->handle.get(), 0, VK_WHOLE_SIZE},
                                              {out->handle.get(), 0, VK_WHOLE_SIZE}};
    VkWriteDescriptorSet write{};
    write.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    write.dstSet = set_;
    write.descriptorCount = 2;
    write.descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER;
    write.pBufferInfo = buffers;
    vkUpdateDescriptorSets(gpu_.device, 1, &write, 0, nullptr);
    VkCommandBufferBeginInfo begin{};
    begin.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO;
    vkBeginCommandBuffer(commands_, &begin);
    vkCmdBindPipeline(commands_, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline_.get());
    vkCmdBindDescriptorSets(commands_, VK_PIPELINE_BIND_POINT_COMPUTE, layout_.get(), 0, 1, &set_, 0,
                            nullptr);
    const std::array<std::uint32_t, 2> push{static_cast<std::uint32_t>(which), count};
    vkCmdPushConstants(commands_, layout_.get(), VK_SHADER_STAGE_COMPUTE_BIT, 0, sizeof push, push.data());
    vkCmdDispatch(commands_, (count + 63) / 64, 1, 1);
    VkMemoryBarrier done{};
    done.sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER;
    done.srcAccessMask = VK_ACCESS_SHADER_WRITE_BIT;
    done.dstAccessMask = VK_ACCESS_HOST_READ_BIT;
    vkCmdPipelineBarrier(commands_, VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT, VK_PIPELINE_STAGE_HOST_BIT, 0, 1,
                         &done, 0, nullptr, 0, nullptr);
    vkEndCommandBuffer(commands_);
    if (auto s = gpu_.run(commands_, fence_.get()); !s) return tl::unexpected<Error>(s.error());
    std::vector<float> results(std::size_t{count} * 4);
    std::memcpy(results.data(), out->data, results.size() * sizeof(float));
    return results;
  }

 private:
  explicit ComputeKernel(render::Device::Impl& gpu) : gpu_(gpu) {}

  Status build(std::span<const std::uint32_t> spirv) {
    const auto failed = [](VkResult r) { return render::vk::failed("making a compute kernel", r); };
    VkDescriptorSetLayoutBinding bindings[2]{};
    for (std::uint32_t b = 0; b < 2; ++b)
      bindings[b] = {b, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1, VK_SHADER_STAGE_COMPUTE_BIT, nullptr};
    VkDescriptorSetLayoutCreateInfo set_info{};
    set_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO;
    set_info.bindingCount = 2;
    set_info.pBindings = bindings;
    VkDescriptorSetLayout set_layout = VK_NULL_HANDLE;
    if (const auto r = vkCreateDescriptorSetLayout(gpu_.device, &set_info, nullptr, &set_layout))
      return failed(r);
    set_layout_ = render::vk::DescriptorSetLayout(gpu_.device, set_layout);
    const VkPushConstantRange push{VK_SHADER_STAGE_COMPUTE_BIT, 0, 8};
    VkPipelineLayoutCreateInfo layout_info{};
    layout_info.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO;
    layout_info.setLayoutCount = 1;
    layout_info.pSetLayouts = &set_layout;
    layout_info.pushConstantRangeCount = 1;
    layout_info.pPushConstantRanges = &push;
    VkPipelineLayout layout = VK_NULL_HANDLE;
    if (const auto r = vkCreatePipelineLayout(gpu_.device, &layout_info, nullptr, &layout)) return failed(r);
    layout_ = render::vk::PipelineLayout(gpu_.device, layout);
    const VkDescriptorPoolSize size{VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 2};
    VkDescriptorPoolCreateInfo pool_info{};
    pool_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO;
    pool_info.maxSets = 1;
    pool_info.poolSizeCount = 1;
    pool_info.pPoolSizes = &size;
    VkDescriptorPool pool = VK_NULL_HANDLE;
    if (const auto r = vkCreateDescriptorPool(gpu_.device, &pool_info, nullptr, &pool)) return failed(r);
    descriptors_ = render::vk::DescriptorPool(gpu_.device, pool);
    VkDescriptorSetAllocateInfo allocate{};
    allocate.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO;
    allocate.descriptorPool = pool;
    allocate.descriptorSetCount = 1;
    allocate.pSetLayouts = &set_layout;
    if (const auto r = vkAllocateDescriptorSets(gpu_.device, &allocate, &set_)) return failed(r);
    auto shader = gpu_.make_shader(spirv);
    if (!shader) return tl::unexpected<Error>(shader.error());
    VkComputePipelineCreateInfo info{};
    info.sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO;
    info.stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
    info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
    info.stage.module = shader->get();
    info.stage.pName = "main";
    info.layout = layout;
    VkPipeline pipeline = VK_NULL_HANDLE;
    if (const auto r = vkCreateComputePipelines(gpu_.device, VK_NULL_HANDLE, 1, &info, nullptr, &pipeline))
      return failed(r);
    pipeline_ = render::vk::Pipeline(gpu_.device, pipeline);
    VkCommandPoolCreateInfo command_info{};
    command_info.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO;
    command_info.flags = VK_COMMAND_POOL_CREATE_RESET_COMMAND_BUFFER_BIT;
    command_info.queueFamilyIndex = gpu_.queue_family;
    VkCommandPool commands = VK_NULL_HANDLE;
    if (const auto r = vkCreateCommandPool(gpu_.device, &command_info, nullptr, &commands)) return failed(r);
    command_pool_ = render::vk::CommandPool(gpu_.device, commands);
    VkCommandBufferAllocateInfo buffer{};
    buffer.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO;
    buffer.commandPool = commands;
    buffer.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
    buffer.commandBufferCount = 1;
    if (const auto r = vkAllocateCommandBuffers(gpu_.device, &buffer, &commands_)) return failed(r);
    VkFenceCreateInfo fence_info{};
    fence_info.sType = VK_STRUCTURE_TYPE_FENCE_CREATE_INFO;
    VkFence fence = VK_NULL_HANDLE;
    if (const auto r = vkCreateFence(gpu_.device, &fence_info, nullptr, &fence)) return failed(r);
    fence_ = render::vk::Fence(gpu_.device, fence);
    return {};
  }

  render::Device::Impl& gpu_;
  render::vk::DescriptorSetLayout set_layout_;
  render::vk::PipelineLayout layout_;
  render::vk::DescriptorPool descriptors_;
  VkDescriptorSet set_ = VK_NULL_HANDLE;
  render::vk::Pipeline pipeline_;
  render::vk::CommandPool command_pool_;
  VkCommandBuffer commands_ = VK_NULL_HANDLE;
  render::vk::Fence fence_;
};

}  // namespace rigor::test
