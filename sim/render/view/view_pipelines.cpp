#include "sim/render/view/view_pipelines.h"

#include <array>
#include <cstddef>
#include <iterator>
#include <span>

#include "sim/render/view/gpu_commands.h"
#include "sim/render/view/impostors.h"
#include "sim/render/view/particles.h"
#include "sim/render/view/texture_pool.h"
#include "sim/render/view/view_structs.h"

namespace rigor::render {
namespace {

// SPIR-V made by the build from shaders/view/*: see CMakeLists.txt.
constexpr std::uint32_t kSurfaceVert[] = {
#include "surface.vert.inc"
};
constexpr std::uint32_t kSurfaceFrag[] = {
#include "surface.frag.inc"
};
constexpr std::uint32_t kFoliageFrag[] = {
#include "foliage.frag.inc"
};
constexpr std::uint32_t kShadowVert[] = {
#include "shadow.vert.inc"
};
constexpr std::uint32_t kShadowFrag[] = {
#include "shadow.frag.inc"
};
constexpr std::uint32_t kSkyVert[] = {
#include "sky.vert.inc"
};
constexpr std::uint32_t kSkyFrag[] = {
#include "sky.frag.inc"
};
constexpr std::uint32_t kGatherComp[] = {
#include "gather.comp.inc"
};
constexpr std::uint32_t kDepthTilesComp[] = {
#include "depth_tiles.comp.inc"
};
constexpr std::uint32_t kDepthTilesMsComp[] = {
#include "depth_tiles_ms.comp.inc"
};
constexpr std::uint32_t kParticleVert[] = {
#include "particle.vert.inc"
};
constexpr std::uint32_t kParticleFrag[] = {
#include "particle.frag.inc"
};
constexpr std::uint32_t kBakeVert[] = {
#include "impostor_bake.vert.inc"
};
constexpr std::uint32_t kBakeFrag[] = {
#include "impostor_bake.frag.inc"
};
constexpr std::uint32_t kImpostorVert[] = {
#include "impostor.vert.inc"
};
constexpr std::uint32_t kImpostorFrag[] = {
#include "impostor.frag.inc"
};
constexpr std::uint32_t kFoliageDepthFrag[] = {
#include "foliage_depth.frag.inc"
};
constexpr std::uint32_t kSurfaceNormalsFrag[] = {
#include "surface_normals.frag.inc"
};
constexpr std::uint32_t kFoliageNormalsFrag[] = {
#include "foliage_normals.frag.inc"
};
constexpr std::uint32_t kImpostorNormalsFrag[] = {
#include "impostor_normals.frag.inc"
};
constexpr std::uint32_t kSkyNormalsFrag[] = {
#include "sky_normals.frag.inc"
};
constexpr std::uint32_t kRangeFrag[] = {
#include "range.frag.inc"
};
constexpr std::uint32_t kRangeHolesFrag[] = {
#include "range_holes.frag.inc"
};
constexpr std::uint32_t kSampleRaysComp[] = {
#include "sample_rays.comp.inc"
};

constexpr std::uint32_t kConstants = 19;
constexpr const char* kFeatureNames[kConstants] = {"colour_map", "near_infrared_map",
                                                   "normal_map", "gloss_map",
                                                   "alpha",      "translucent",
                                                   "water",      "haze",
                                                   "lamps",      "snow",
                                                   "wet",        "shadows",
                                                   "glossy",     "multisampled",
                                                   "two_sided",  "sway",
                                                   "sky_cover",  "after_depth",
                                                   "normals"};

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

/// Each feature is the specialisation constant of its bit's number.
struct Constants {
  explicit Constants(std::uint32_t features) {
    for (std::uint32_t i = 0; i < kConstants; ++i) {
      values[i] = features >> i & 1u;
      entries[i] = {i, i * 4, 4};
    }
    info = {kConstants, entries.data(), sizeof values, values.data()};
  }
  Constants(const Constants&) = delete;
  Constants& operator=(const Constants&) = delete;
  std::array<VkBool32, kConstants> values{};
  std::array<VkSpecializationMapEntry, kConstants> entries{};
  VkSpecializationInfo info{};
};

Result<vk::DescriptorSetLayout> make_set_layout(const Device::Impl& gpu,
                                                std::span<const VkDescriptorSetLayoutBinding> bindings) {
  VkDescriptorSetLayoutCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO;
  info.bindingCount = static_cast<std::uint32_t>(bindings.size());
  info.pBindings = bindings.data();
  VkDescriptorSetLayout handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateDescriptorSetLayout(gpu.device, &info, nullptr, &handle); r != VK_SUCCESS)
    return vk::failed("making a descriptor layout", r);
  return vk::DescriptorSetLayout(gpu.device, handle);
}

Result<vk::PipelineLayout> make_layout(const Device::Impl& gpu, std::span<const VkDescriptorSetLayout> sets,
                                       VkShaderStageFlags push_stages, std::uint32_t push_bytes) {
  const VkPushConstantRange push{push_stages, 0, push_bytes};
  VkPipelineLayoutCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO;
  info.setLayoutCount = static_cast<std::uint32_t>(sets.size());
  info.pSetLayouts = sets.data();
  info.pushConstantRangeCount = 1;
  info.pPushConstantRanges = &push;
  VkPipelineLayout handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreatePipelineLayout(gpu.device, &info, nullptr, &handle); r != VK_SUCCESS)
    return vk::failed("making a pipeline layout", r);
  return vk::PipelineLayout(gpu.device, handle);
}

/// All that differs between the pipelines that draw.
struct Drawing {
  std::span<const std::uint32_t> vertex, fragment;  ///< fragment: empty where depth alone is written
  bool vertices = true, instances = true;           ///< vertex input: a mesh; instances
  std::uint32_t colours = 2;            ///< attachments: 0, radiance, and identity too; or so many maps
  VkFormat maps = VK_FORMAT_UNDEFINED;  ///< of all attachments, where they are not those of a picture
  VkCompareOp depth = VK_COMPARE_OP_GREATER;
  bool writes_depth = true, blends = false;
  std::uint32_t instance_stride = sizeof(view_gpu::DrawnInstance);
};

}  // namespace

std::string pipeline_name(ViewPass pass, std::uint32_t features) {
  constexpr const char* kPasses[] = {"surface",  "depth",       "shadow",     "sky",
                                     "gather",   "depth_tiles", "particles",  "impostor_bake",
                                     "impostor", "range",       "sample_rays"};
  static_assert(std::size(kPasses) == static_cast<std::size_t>(ViewPass::sample_rays) + 1);
  std::string name = kPasses[static_cast<std::size_t>(pass)];
  for (std::uint32_t i = 0; i < kConstants; ++i)
    if ((features >> i & 1u) != 0) name += std::string(" ") + kFeatureNames[i];
  return name;
}

Status ViewPipelines::create() {
  VkFormatProperties radiance{};
  vkGetPhysicalDeviceFormatProperties(gpu_.physical, colour_format_, &radiance);
  constexpr VkFormatFeatureFlags kNeeded = VK_FORMAT_FEATURE_COLOR_ATTACHMENT_BLEND_BIT;
  if ((radiance.optimalTilingFeatures & kNeeded) != kNeeded)
    return fail(ErrorCode::unavailable, gpu_.name, "expected pictures of 32-bit floats that can be blended");
  constexpr VkShaderStageFlags kDraw = VK_SHADER_STAGE_VERTEX_BIT | VK_SHADER_STAGE_FRAGMENT_BIT;
  constexpr VkShaderStageFlags kFragment = VK_SHADER_STAGE_FRAGMENT_BIT,
                               kCompute = VK_SHADER_STAGE_COMPUTE_BIT;
  constexpr VkDescriptorType kUniform = VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER,
                             kStorage = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER,
                             kSampled = VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER,
                             kImage = VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE;
  const std::array frame{VkDescriptorSetLayoutBinding{0, kUniform, 1, kDraw, nullptr},
                         VkDescriptorSetLayoutBinding{1, kSampled, 1, kFragment, nullptr},
                         VkDescriptorSetLayoutBinding{2, kImage, 1, kFragment, nullptr},
                         VkDescriptorSetLayoutBinding{3, kImage, 1, kFragment, nullptr}};
  const std::array surface{VkDescriptorSetLayoutBinding{0, kUniform, 1, kDraw, nullptr},
                           VkDescriptorSetLayoutBinding{1, kSampled, 1, kFragment, nullptr},
                           VkDescriptorSetLayoutBinding{2, kSampled, 1, kFragment, nullptr},
                           VkDescriptorSetLayoutBinding{3, kSampled, 1, kFragment, nullptr},
                           VkDescriptorSetLayoutBinding{4, kSampled, 1, kFragment, nullptr}};
  const std::array gather{VkDescriptorSetLayoutBinding{0, kStorage, 1, kCompute, nullptr},
                          VkDescriptorSetLayoutBinding{1, kStorage, 1, kCompute, nullptr},
                          VkDescriptorSetLayoutBinding{2, kStorage, 1, kCompute, nullptr}};
  const std::array tiles{VkDescriptorSetLayoutBinding{0, kImage, 1, kCompute, nullptr},
                         VkDescriptorSetLayoutBinding{1, kStorage, 1, kCompute, nullptr}};
  const std::array rays{VkDescriptorSetLayoutBinding{0, kImage, 1, kCompute, nullptr},
                        VkDescriptorSetLayoutBinding{1, kImage, 1, kCompute, nullptr},
                        VkDescriptorSetLayoutBinding{2, kImage, 1, kCompute, nullptr},
                        VkDescriptorSetLayoutBinding{3, kStorage, 1, kCompute, nullptr},
                        VkDescriptorSetLayoutBinding{4, kStorage, 1, kCompute, nullptr}};
  const auto set = [&](vk::DescriptorSetLayout& out,
                       std::span<const VkDescriptorSetLayoutBinding> b) -> Status {
    auto made = make_set_layout(gpu_, b);
    if (!made) return tl::unexpected(made.error());
    out = std::move(*made);
    return {};
  };
  if (auto s = set(frame_layout_, frame); !s) return s;
  if (auto s = set(surface_layout_, surface); !s) return s;
  if (auto s = set(gather_layout_, gather); !s) return s;
  if (auto s = set(tiles_layout_, tiles); !s) return s;
  if (auto s = set(rays_layout_, rays); !s) return s;
  const auto layout = [&](vk::PipelineLayout& out, std::span<const VkDescriptorSetLayout> sets,
                          VkShaderStageFlags stages, std::uint32_t bytes) -> Status {
    auto made = make_layout(gpu_, sets, stages, bytes);
    if (!made) return tl::unexpected(made.error());
    out = std::move(*made);
    return {};
  };
  const std::array draw_sets{frame_layout_.get(), surface_layout_.get()};
  const std::array gather_sets{gather_layout_.get()};
  const std::array tiles_sets{tiles_layout_.get()};
  const std::array rays_sets{rays_layout_.get()};
  if (auto s = layout(draw_, draw_sets, kDrawStages, kDrawPushBytes); !s) return s;
  if (auto s = layout(gather_, gather_sets, kCompute, 16); !s) return s;
  if (auto s = layout(tiles_, tiles_sets, kCompute, 16); !s) return s;
  return layout(rays_, rays_sets, kCompute, kRaysPushBytes);
}

Result<vk::Pipeline> ViewPipelines::make_drawing(ViewPass pass, std::uint32_t features) const {
  Drawing d;
  const bool alpha = (features & kFeatureAlpha) != 0;
  const bool normals = (features & kFeatureNormals) != 0, known = (features & kFeatureAfterDepth) != 0;
  const std::uint32_t picture_colours = normals ? 3 : 2;
  switch (pass) {
    case ViewPass::depth:
      d = {.vertex = kSurfaceVert, .fragment = {}, .colours = 0};
      if (alpha) d.fragment = kFoliageDepthFrag;
      break;
    case ViewPass::shadow:
      d = {.vertex = kShadowVert, .fragment = {}, .colours = 0, .depth = VK_COMPARE_OP_LESS};
      if (alpha) d.fragment = kShadowFrag;
      break;
    case ViewPass::sky:
      d = {.vertex = kSkyVert,
           .fragment = normals ? std::span<const std::uint32_t>(kSkyNormalsFrag) : kSkyFrag,
           .vertices = false,
           .instances = false,
           .colours = picture_colours,
           .depth = VK_COMPARE_OP_EQUAL,
           .writes_depth = false};
      break;
    case ViewPass::particles:
      d = {.vertex = kParticleVert,
           .fragment = kParticleFrag,
           .vertices = false,
           .colours = 1,
           .writes_depth = false,
           .blends = true,
           .instance_stride = sizeof(Particle)};
      break;
    case ViewPass::impostor_bake:
      d = {.vertex = kBakeVert,
           .fragment = kBakeFrag,
           .instances = false,
           .colours = 3,
           .maps = kImpostorMapFormat,
           .depth = VK_COMPARE_OP_LESS};
      break;
    case ViewPass::impostor:
      d = {.vertex = kImpostorVert,
           .fragment = normals ? std::span<const std::uint32_t>(kImpostorNormalsFrag) : kImpostorFrag,
           .vertices = false,
           .colours = picture_colours};
      break;
    case ViewPass::range:
      d = {.vertex = kSurfaceVert,
           .fragment = alpha ? std::span<const std::uint32_t>(kRangeHolesFrag) : kRangeFrag,
           .colours = 3,
           .maps = kRangeFormat};
      break;
    default:
      d = {.vertex = kSurfaceVert, .fragment = kSurfaceFrag, .colours = picture_colours};
      if (normals) d.fragment = kSurfaceNormalsFrag;
      if (alpha) d.fragment = normals ? std::span<const std::uint32_t>(kFoliageNormalsFrag) : kFoliageFrag;
      if (known) {
        d.depth = VK_COMPARE_OP_EQUAL;
        d.writes_depth = false;
      }
  }
  const Constants constants(features);
  auto vertex = gpu_.make_shader(d.vertex);
  if (!vertex) return tl::unexpected(vertex.error());
  vk::ShaderModule fragment;
  if (!d.fragment.empty()) {
    auto made = gpu_.make_shader(d.fragment);
    if (!made) return tl::unexpected(made.error());
    fragment = std::move(*made);
  }
  const std::array stages{stage(VK_SHADER_STAGE_VERTEX_BIT, *vertex, &constants.info),
                          stage(VK_SHADER_STAGE_FRAGMENT_BIT, fragment, &constants.info)};
  std::vector<VkVertexInputBindingDescription> bindings;
  std::vector<VkVertexInputAttributeDescription> attributes;
  if (d.vertices) {
    bindings.push_back({0, sizeof(Vertex), VK_VERTEX_INPUT_RATE_VERTEX});
    attributes.insert(attributes.end(), {{0, 0, VK_FORMAT_R32G32B32_SFLOAT, offsetof(Vertex, position)},
                                         {1, 0, VK_FORMAT_R32G32B32_SFLOAT, offsetof(Vertex, normal)},
                                         {2, 0, VK_FORMAT_R32G32_SFLOAT, offsetof(Vertex, uv)},
                                         {3, 0, VK_FORMAT_R32_SFLOAT, offsetof(Vertex, sway)}});
  }
  if (d.instances) {
    bindings.push_back({1, d.instance_stride, VK_VERTEX_INPUT_RATE_INSTANCE});
    const std::uint32_t fields = d.instance_stride / 16;
    for (std::uint32_t i = 0; i < fields; ++i)
      attributes.push_back(
          {4 + i, 1, i == 4 ? VK_FORMAT_R32G32B32A32_UINT : VK_FORMAT_R32G32B32A32_SFLOAT, 16 * i});
  }
  VkPipelineVertexInputStateCreateInfo input{};
  input.sType = VK_STRUCTURE_TYPE_PIPELINE_VERTEX_INPUT_STATE_CREATE_INFO;
  input.vertexBindingDescriptionCount = static_cast<std::uint32_t>(bindings.size());
  input.pVertexBindingDescriptions = bindings.data();
  input.vertexAttributeDescriptionCount = static_cast<std::uint32_t>(attributes.size());
  input.pVertexAttributeDescriptions = attributes.data();
  VkPipelineInputAssemblyStateCreateInfo assembly{};
  assembly.sType = VK_STRUCTURE_TYPE_PIPELINE_INPUT_ASSEMBLY_STATE_CREATE_INFO;
  assembly.topology =
      d.vertices || !d.instances ? VK_PRIMITIVE_TOPOLOGY_TRIANGLE_LIST : VK_PRIMITIVE_TOPOLOGY_TRIANGLE_STRIP;
  VkPipelineViewportStateCreateInfo viewport{};
  viewport.sType = VK_STRUCTURE_TYPE_PIPELINE_VIEWPORT_STATE_CREATE_INFO;
  viewport.viewportCount = 1;
  viewport.scissorCount = 1;
  VkPipelineRasterizationStateCreateInfo raster{};
  raster.sType = VK_STRUCTURE_TYPE_PIPELINE_RASTERIZATION_STATE_CREATE_INFO;
  raster.cullMode = (pass == ViewPass::surface || pass == ViewPass::depth || pass == ViewPass::range) &&
                            (features & kFeatureTwoSided) == 0
                        ? VK_CULL_MODE_BACK_BIT
                        : VK_CULL_MODE_NONE;
  // Vulkan's y points down like the optical frame's, so that what is counter-clockwise from outside stays so.
  raster.frontFace = VK_FRONT_FACE_COUNTER_CLOCKWISE;
  raster.lineWidth = 1.0F;
  VkPipelineMultisampleStateCreateInfo samples{};
  samples.sType = VK_STRUCTURE_TYPE_PIPELINE_MULTISAMPLE_STATE_CREATE_INFO;
  samples.rasterizationSamples =
      (features & kFeatureMultisampled) != 0 ? VK_SAMPLE_COUNT_4_BIT : VK_SAMPLE_COUNT_1_BIT;
  VkPipelineDepthStencilStateCreateInfo depth{};
  depth.sType = VK_STRUCTURE_TYPE_PIPELINE_DEPTH_STENCIL_STATE_CREATE_INFO;
  depth.depthTestEnable = VK_TRUE;
  depth.depthWriteEnable = d.writes_depth ? VK_TRUE : VK_FALSE;
  depth.depthCompareOp = d.depth;
  std::array<VkPipelineColorBlendAttachmentState, 4> attachment{};
  for (auto& a : attachment) {
    a.colorWriteMask = VK_COLOR_COMPONENT_R_BIT | VK_COLOR_COMPONENT_G_BIT | VK_COLOR_COMPONENT_B_BIT |
                       VK_COLOR_COMPONENT_A_BIT;
    if (!d.blends) continue;
    // The fourth band lies in alpha, so that what shines through comes as a second source. Without that, what
    // falls through the air only adds its own light.
    a.blendEnable = VK_TRUE;
    a.srcColorBlendFactor = a.srcAlphaBlendFactor = VK_BLEND_FACTOR_ONE;
    a.dstColorBlendFactor = gpu_.dual_source_blend ? VK_BLEND_FACTOR_SRC1_COLOR : VK_BLEND_FACTOR_ONE;
    a.dstAlphaBlendFactor = gpu_.dual_source_blend ? VK_BLEND_FACTOR_SRC1_ALPHA : VK_BLEND_FACTOR_ONE;
    a.colorBlendOp = a.alphaBlendOp = VK_BLEND_OP_ADD;
  }
  VkPipelineColorBlendStateCreateInfo blend{};
  blend.sType = VK_STRUCTURE_TYPE_PIPELINE_COLOR_BLEND_STATE_CREATE_INFO;
  blend.attachmentCount = d.colours;
  blend.pAttachments = attachment.data();
  const std::array dynamic{VK_DYNAMIC_STATE_VIEWPORT, VK_DYNAMIC_STATE_SCISSOR};
  VkPipelineDynamicStateCreateInfo dynamic_info{};
  dynamic_info.sType = VK_STRUCTURE_TYPE_PIPELINE_DYNAMIC_STATE_CREATE_INFO;
  dynamic_info.dynamicStateCount = dynamic.size();
  dynamic_info.pDynamicStates = dynamic.data();
  const std::array picture{colour_format_, VK_FORMAT_R32_UINT, VK_FORMAT_R32_UINT};
  const std::array maps{d.maps, d.maps, d.maps};
  VkPipelineRenderingCreateInfo rendering{};
  rendering.sType = VK_STRUCTURE_TYPE_PIPELINE_RENDERING_CREATE_INFO;
  rendering.colorAttachmentCount = d.colours;
  rendering.pColorAttachmentFormats = d.maps != VK_FORMAT_UNDEFINED ? maps.data() : picture.data();
  rendering.depthAttachmentFormat = VK_FORMAT_D32_SFLOAT;
  VkGraphicsPipelineCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_GRAPHICS_PIPELINE_CREATE_INFO;
  info.pNext = &rendering;
  info.stageCount = d.fragment.empty() ? 1 : 2;
  info.pStages = stages.data();
  info.pVertexInputState = &input;
  info.pInputAssemblyState = &assembly;
  info.pViewportState = &viewport;
  info.pRasterizationState = &raster;
  info.pMultisampleState = &samples;
  info.pDepthStencilState = &depth;
  info.pColorBlendState = &blend;
  info.pDynamicState = &dynamic_info;
  info.layout = draw_.get();
  VkPipeline handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateGraphicsPipelines(gpu_.device, VK_NULL_HANDLE, 1, &info, nullptr, &handle);
      r != VK_SUCCESS)
    return vk::failed("making the pipeline '" + pipeline_name(pass, features) + "'", r);
  return vk::Pipeline(gpu_.device, handle);
}

Result<vk::Pipeline> ViewPipelines::make_compute(ViewPass pass, std::uint32_t features) const {
  std::span<const std::uint32_t> code = kGatherComp;
  if (pass == ViewPass::depth_tiles)
    code = (features & kFeatureMultisampled) != 0 ? std::span<const std::uint32_t>(kDepthTilesMsComp)
                                                  : kDepthTilesComp;
  if (pass == ViewPass::sample_rays) code = kSampleRaysComp;
  auto shader = gpu_.make_shader(code);
  if (!shader) return tl::unexpected(shader.error());
  VkComputePipelineCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO;
  info.stage = stage(VK_SHADER_STAGE_COMPUTE_BIT, *shader, nullptr);
  info.layout = pass == ViewPass::gather        ? gather_.get()
                : pass == ViewPass::sample_rays ? rays_.get()
                                                : tiles_.get();
  VkPipeline handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateComputePipelines(gpu_.device, VK_NULL_HANDLE, 1, &info, nullptr, &handle);
      r != VK_SUCCESS)
    return vk::failed("making the pipeline '" + pipeline_name(pass, features) + "'", r);
  return vk::Pipeline(gpu_.device, handle);
}

Result<VkPipeline> ViewPipelines::get(ViewPass pass, std::uint32_t features) {
  auto& slot = made_[{pass, features}];
  if (!slot) {
    auto made = pass == ViewPass::gather || pass == ViewPass::depth_tiles || pass == ViewPass::sample_rays
                    ? make_compute(pass, features)
                    : make_drawing(pass, features);
    if (!made) return tl::unexpected(made.error());
    slot = std::move(*made);
    names_.push_back(pipeline_name(pass, features));
  }
  return slot.get();
}

std::vector<std::string> ViewPipelines::names() const { return names_; }

}  // namespace rigor::render
