#include "sim/render/pipelines.h"

#include <array>
#include <cstddef>
#include <iterator>

#include "sim/render/gpu_structs.h"

namespace rigor::render {
namespace {

// SPIR-V made by the build from shaders/*: see CMakeLists.txt.
constexpr std::uint32_t kBodyVert[] = {
#include "body.vert.inc"
};
constexpr std::uint32_t kBodyFrag[] = {
#include "body.frag.inc"
};
constexpr std::uint32_t kGroundVert[] = {
#include "ground.vert.inc"
};
constexpr std::uint32_t kGroundFrag[] = {
#include "ground.frag.inc"
};
constexpr std::uint32_t kSkyVert[] = {
#include "sky.vert.inc"
};
constexpr std::uint32_t kSkyFrag[] = {
#include "sky.frag.inc"
};
constexpr std::uint32_t kLensMapComp[] = {
#include "lens_map.comp.inc"
};
constexpr std::uint32_t kSensorComp[] = {
#include "sensor.comp.inc"
};

/// Specialisation constants 0, 1, ... of a shader, 32 bits each.
template <std::size_t N>
struct Constants {
  explicit Constants(std::array<std::uint32_t, N> v) : values(v) {
    for (std::uint32_t i = 0; i < N; ++i) entries[i] = {i, i * 4, 4};
    info = {N, entries.data(), sizeof values, values.data()};
  }
  Constants(const Constants&) = delete;
  Constants& operator=(const Constants&) = delete;
  std::array<std::uint32_t, N> values;
  std::array<VkSpecializationMapEntry, N> entries{};
  VkSpecializationInfo info{};
};

VkPipelineShaderStageCreateInfo stage(VkShaderStageFlagBits which, const vk::ShaderModule& module,
                                      const VkSpecializationInfo* constants) {
  VkPipelineShaderStageCreateInfo s{};
  s.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
  s.stage = which;
  s.module = module.get();
  s.pName = "main";
  s.pSpecializationInfo = constants;
  return s;
}

struct RasterWanted {
  const char* name;
  std::span<const std::uint32_t> vertex;
  std::span<const std::uint32_t> fragment;
  const VkSpecializationInfo* constants;
  std::uint32_t stride;
  std::span<const VkVertexInputAttributeDescription> attributes;
  VkCullModeFlags cull;
  bool writes_depth;
};

Result<vk::Pipeline> make_raster(const Device::Impl& gpu, const Pipelines& p, const RasterWanted& w) {
  auto vertex = gpu.make_shader(w.vertex);
  if (!vertex) return tl::unexpected(vertex.error());
  auto fragment = gpu.make_shader(w.fragment);
  if (!fragment) return tl::unexpected(fragment.error());
  const std::array stages{stage(VK_SHADER_STAGE_VERTEX_BIT, *vertex, nullptr),
                          stage(VK_SHADER_STAGE_FRAGMENT_BIT, *fragment, w.constants)};
  const VkVertexInputBindingDescription binding{0, w.stride, VK_VERTEX_INPUT_RATE_VERTEX};
  VkPipelineVertexInputStateCreateInfo input{};
  input.sType = VK_STRUCTURE_TYPE_PIPELINE_VERTEX_INPUT_STATE_CREATE_INFO;
  input.vertexBindingDescriptionCount = w.attributes.empty() ? 0 : 1;
  input.pVertexBindingDescriptions = &binding;
  input.vertexAttributeDescriptionCount = static_cast<std::uint32_t>(w.attributes.size());
  input.pVertexAttributeDescriptions = w.attributes.data();
  VkPipelineInputAssemblyStateCreateInfo assembly{};
  assembly.sType = VK_STRUCTURE_TYPE_PIPELINE_INPUT_ASSEMBLY_STATE_CREATE_INFO;
  assembly.topology = VK_PRIMITIVE_TOPOLOGY_TRIANGLE_LIST;
  VkPipelineViewportStateCreateInfo viewport{};
  viewport.sType = VK_STRUCTURE_TYPE_PIPELINE_VIEWPORT_STATE_CREATE_INFO;
  viewport.viewportCount = 1;
  viewport.scissorCount = 1;
  VkPipelineRasterizationStateCreateInfo raster{};
  raster.sType = VK_STRUCTURE_TYPE_PIPELINE_RASTERIZATION_STATE_CREATE_INFO;
  raster.cullMode = w.cull;
  // Vulkan's y points down like the optical frame's, so that what is counter-clockwise from outside stays so.
  raster.frontFace = VK_FRONT_FACE_COUNTER_CLOCKWISE;
  raster.lineWidth = 1.0f;
  VkPipelineMultisampleStateCreateInfo samples{};
  samples.sType = VK_STRUCTURE_TYPE_PIPELINE_MULTISAMPLE_STATE_CREATE_INFO;
  samples.rasterizationSamples = VK_SAMPLE_COUNT_1_BIT;
  VkPipelineDepthStencilStateCreateInfo depth{};
  depth.sType = VK_STRUCTURE_TYPE_PIPELINE_DEPTH_STENCIL_STATE_CREATE_INFO;
  depth.depthTestEnable = VK_TRUE;
  depth.depthWriteEnable = w.writes_depth ? VK_TRUE : VK_FALSE;
  depth.depthCompareOp = w.writes_depth ? VK_COMPARE_OP_GREATER : VK_COMPARE_OP_GREATER_OR_EQUAL;
  VkPipelineColorBlendAttachmentState attachment{};
  attachment.colorWriteMask = VK_COLOR_COMPONENT_R_BIT | VK_COLOR_COMPONENT_G_BIT | VK_COLOR_COMPONENT_B_BIT |
                              VK_COLOR_COMPONENT_A_BIT;
  VkPipelineColorBlendStateCreateInfo blend{};
  blend.sType = VK_STRUCTURE_TYPE_PIPELINE_COLOR_BLEND_STATE_CREATE_INFO;
  blend.attachmentCount = 1;
  blend.pAttachments = &attachment;
  const std::array dynamic{VK_DYNAMIC_STATE_VIEWPORT, VK_DYNAMIC_STATE_SCISSOR};
  VkPipelineDynamicStateCreateInfo dynamic_info{};
  dynamic_info.sType = VK_STRUCTURE_TYPE_PIPELINE_DYNAMIC_STATE_CREATE_INFO;
  dynamic_info.dynamicStateCount = dynamic.size();
  dynamic_info.pDynamicStates = dynamic.data();
  VkPipelineRenderingCreateInfo rendering{};
  rendering.sType = VK_STRUCTURE_TYPE_PIPELINE_RENDERING_CREATE_INFO;
  rendering.colorAttachmentCount = 1;
  rendering.pColorAttachmentFormats = &p.colour_format;
  rendering.depthAttachmentFormat = VK_FORMAT_D32_SFLOAT;
  VkGraphicsPipelineCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_GRAPHICS_PIPELINE_CREATE_INFO;
  info.pNext = &rendering;
  info.stageCount = stages.size();
  info.pStages = stages.data();
  info.pVertexInputState = &input;
  info.pInputAssemblyState = &assembly;
  info.pViewportState = &viewport;
  info.pRasterizationState = &raster;
  info.pMultisampleState = &samples;
  info.pDepthStencilState = &depth;
  info.pColorBlendState = &blend;
  info.pDynamicState = &dynamic_info;
  info.layout = p.layout.get();
  VkPipeline handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateGraphicsPipelines(gpu.device, VK_NULL_HANDLE, 1, &info, nullptr, &handle);
      r != VK_SUCCESS)
    return vk::failed(std::string("making the pipeline '") + w.name + "'", r);
  return vk::Pipeline(gpu.device, handle);
}

Result<vk::Pipeline> make_compute(const Device::Impl& gpu, const Pipelines& p, const char* name,
                                  std::span<const std::uint32_t> code,
                                  const VkSpecializationInfo* constants) {
  auto shader = gpu.make_shader(code);
  if (!shader) return tl::unexpected(shader.error());
  VkComputePipelineCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO;
  info.stage = stage(VK_SHADER_STAGE_COMPUTE_BIT, *shader, constants);
  info.layout = p.layout.get();
  VkPipeline handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateComputePipelines(gpu.device, VK_NULL_HANDLE, 1, &info, nullptr, &handle);
      r != VK_SUCCESS)
    return vk::failed(std::string("making the pipeline '") + name + "'", r);
  return vk::Pipeline(gpu.device, handle);
}

Status make_layout(const Device::Impl& gpu, Pipelines& p) {
  constexpr VkShaderStageFlags kRaster = VK_SHADER_STAGE_VERTEX_BIT | VK_SHADER_STAGE_FRAGMENT_BIT;
  constexpr VkShaderStageFlags kCompute = VK_SHADER_STAGE_COMPUTE_BIT;
  const std::array bindings{
      VkDescriptorSetLayoutBinding{kFrameBinding, VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, 1, kRaster, nullptr},
      VkDescriptorSetLayoutBinding{kSurfaceBinding, VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER_DYNAMIC, 1, kRaster,
                                   nullptr},
      VkDescriptorSetLayoutBinding{kCasterBinding, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1, kRaster, nullptr},
      VkDescriptorSetLayoutBinding{kCasterListBinding, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1, kRaster,
                                   nullptr},
      VkDescriptorSetLayoutBinding{kLensBinding, VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, 1, kCompute, nullptr},
      VkDescriptorSetLayoutBinding{kMapBinding, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1, kCompute, nullptr},
      VkDescriptorSetLayoutBinding{kSensorBinding, VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, 1, kCompute, nullptr},
      VkDescriptorSetLayoutBinding{kOutputBinding, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 1, kCompute, nullptr},
      VkDescriptorSetLayoutBinding{kPictureBinding, VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE, 1, kCompute, nullptr},
      VkDescriptorSetLayoutBinding{kMapImageBinding, VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE, 1, kCompute, nullptr}};
  VkDescriptorSetLayoutCreateInfo set_info{};
  set_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO;
  set_info.bindingCount = bindings.size();
  set_info.pBindings = bindings.data();
  VkDescriptorSetLayout set_layout = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateDescriptorSetLayout(gpu.device, &set_info, nullptr, &set_layout);
      r != VK_SUCCESS)
    return vk::failed("making a descriptor layout", r);
  p.set_layout = vk::DescriptorSetLayout(gpu.device, set_layout);
  const std::array sizes{VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, 4},
                         VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, 3},
                         VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER_DYNAMIC, 1},
                         VkDescriptorPoolSize{VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE, 2}};
  VkDescriptorPoolCreateInfo pool_info{};
  pool_info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_POOL_CREATE_INFO;
  pool_info.maxSets = 1;
  pool_info.poolSizeCount = sizes.size();
  pool_info.pPoolSizes = sizes.data();
  VkDescriptorPool pool = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateDescriptorPool(gpu.device, &pool_info, nullptr, &pool); r != VK_SUCCESS)
    return vk::failed("making a descriptor pool", r);
  p.descriptor_pool = vk::DescriptorPool(gpu.device, pool);
  VkDescriptorSetAllocateInfo allocate{};
  allocate.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_ALLOCATE_INFO;
  allocate.descriptorPool = pool;
  allocate.descriptorSetCount = 1;
  allocate.pSetLayouts = &set_layout;
  if (const VkResult r = vkAllocateDescriptorSets(gpu.device, &allocate, &p.set); r != VK_SUCCESS)
    return vk::failed("making a descriptor set", r);
  VkPipelineLayoutCreateInfo layout_info{};
  layout_info.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO;
  layout_info.setLayoutCount = 1;
  layout_info.pSetLayouts = &set_layout;
  VkPipelineLayout layout = VK_NULL_HANDLE;
  if (const VkResult r = vkCreatePipelineLayout(gpu.device, &layout_info, nullptr, &layout); r != VK_SUCCESS)
    return vk::failed("making a pipeline layout", r);
  p.layout = vk::PipelineLayout(gpu.device, layout);
  return {};
}

Status make_commands(const Device::Impl& gpu, Pipelines& p) {
  VkCommandPoolCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO;
  info.queueFamilyIndex = gpu.queue_family;
  VkCommandPool pool = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateCommandPool(gpu.device, &info, nullptr, &pool); r != VK_SUCCESS)
    return vk::failed("making a command pool", r);
  p.pool = vk::CommandPool(gpu.device, pool);
  VkCommandBufferAllocateInfo allocate{};
  allocate.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO;
  allocate.commandPool = pool;
  allocate.level = VK_COMMAND_BUFFER_LEVEL_PRIMARY;
  allocate.commandBufferCount = 1;
  if (const VkResult r = vkAllocateCommandBuffers(gpu.device, &allocate, &p.commands); r != VK_SUCCESS)
    return vk::failed("making a command buffer", r);
  return {};
}

}  // namespace

Result<Pipelines> make_pipelines(const Device::Impl& gpu, const PipelineOptions& options) {
  Pipelines p;
  p.colour_format = options.mono ? VK_FORMAT_R32_SFLOAT : VK_FORMAT_R32G32B32A32_SFLOAT;
  if (auto s = make_layout(gpu, p); !s) return tl::unexpected(s.error());
  if (auto s = make_commands(gpu, p); !s) return tl::unexpected(s.error());

  const Constants<4> sensor({static_cast<std::uint32_t>(options.format), options.shot_noise,
                             options.read_noise, static_cast<std::uint32_t>(options.taps)});
  const VkVertexInputAttributeDescription body_input[] = {
      {0, 0, VK_FORMAT_R32G32B32_SFLOAT, offsetof(gpu::BodyVertex, position)},
      {1, 0, VK_FORMAT_R32G32B32_SFLOAT, offsetof(gpu::BodyVertex, normal)}};
  const VkVertexInputAttributeDescription ground_input[] = {
      {0, 0, VK_FORMAT_R32G32B32_SFLOAT, offsetof(gpu::GroundVertex, position_camera)},
      {1, 0, VK_FORMAT_R32G32_SFLOAT, offsetof(gpu::GroundVertex, cell_position)},
      {2, 0, VK_FORMAT_R32G32_SINT, offsetof(gpu::GroundVertex, base_cell)}};
  const auto add = [&](vk::Pipeline& pipeline, const RasterWanted& wanted) -> Status {
    auto made = make_raster(gpu, p, wanted);
    if (!made) return tl::unexpected(made.error());
    pipeline = std::move(*made);
    return {};
  };
  const std::size_t last = caster_variant(options.bodies, true);
  for (std::size_t i = 0; i <= last; ++i) {
    const bool cylinders = i % 2 == 1 || i == kLoopVariant;
    if (cylinders && (options.cylinders == 0 || i == 1) && i != kLoopVariant) continue;
    const std::uint32_t casters = i == kLoopVariant ? ~0u : kCasterClasses[i / 2];
    const Constants<5> plain({options.mono, options.highlights, false, casters, cylinders});
    const Constants<5> board({options.mono, options.highlights, true, casters, cylinders});
    const Constants<5> ground(
        {options.mono, options.ground_highlights, options.ground_noise, casters, cylinders});
    const RasterWanted body_wanted{
        "body", kBodyVert, kBodyFrag, &plain.info, sizeof(gpu::BodyVertex), body_input, VK_CULL_MODE_BACK_BIT,
        true};
    RasterWanted board_wanted = body_wanted;
    board_wanted.constants = &board.info;
    if (auto s = add(p.body[i], body_wanted); !s) return tl::unexpected(s.error());
    if (options.boards)
      if (auto s = add(p.board[i], board_wanted); !s) return tl::unexpected(s.error());
    if (auto s = add(p.ground[i], {"ground", kGroundVert, kGroundFrag, &ground.info,
                                   sizeof(gpu::GroundVertex), ground_input, VK_CULL_MODE_NONE, true});
        !s)
      return tl::unexpected(s.error());
  }
  if (auto s = add(p.sky, {"sky", kSkyVert, kSkyFrag, nullptr, 0, {}, VK_CULL_MODE_NONE, false}); !s)
    return tl::unexpected(s.error());
  auto lens_map = make_compute(gpu, p, "lens map", kLensMapComp, nullptr);
  if (!lens_map) return tl::unexpected(lens_map.error());
  p.lens_map = std::move(*lens_map);
  auto sensor_pipeline = make_compute(gpu, p, "sensor", kSensorComp, &sensor.info);
  if (!sensor_pipeline) return tl::unexpected(sensor_pipeline.error());
  p.sensor = std::move(*sensor_pipeline);
  return p;
}

}  // namespace rigor::render
