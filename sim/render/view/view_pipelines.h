// Pipelines of the view, each built when it is first needed. Internal to sim/render/view.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "sim/render/device_impl.h"

namespace rigor::render {

/// Of a range view's three pictures.
inline constexpr VkFormat kRangeFormat = VK_FORMAT_R32G32B32A32_UINT;
/// What sampling them is told: three vec4 and a uvec4.
inline constexpr std::uint32_t kRaysPushBytes = 64;

enum class ViewPass : std::uint32_t {
  surface,  ///< meshes; keyed by SurfaceFeature
  depth,    ///< their depth alone
  shadow,   ///< depth of casters from the sun
  sky,
  gather,       ///< compute: instances into the order of drawing
  depth_tiles,  ///< compute: farthest depth of each tile
  particles,
  impostor_bake,
  impostor,
  range,       ///< meshes without light: what rays find; keyed by SurfaceFeature
  sample_rays  ///< compute: rays sampled from range views
};

class ViewPipelines {
 public:
  explicit ViewPipelines(const Device::Impl& gpu) : gpu_(gpu) {}
  [[nodiscard]] Status create();

  [[nodiscard]] Result<VkPipeline> get(ViewPass pass, std::uint32_t features = 0);
  [[nodiscard]] std::vector<std::string> names() const;

  // Layouts by number of set: frame and surface for drawing; buffers for compute.
  [[nodiscard]] VkDescriptorSetLayout frame_layout() const { return frame_layout_.get(); }
  [[nodiscard]] VkDescriptorSetLayout surface_layout() const { return surface_layout_.get(); }
  [[nodiscard]] VkDescriptorSetLayout gather_layout() const { return gather_layout_.get(); }
  [[nodiscard]] VkDescriptorSetLayout tiles_layout() const { return tiles_layout_.get(); }
  [[nodiscard]] VkDescriptorSetLayout rays_layout() const { return rays_layout_.get(); }
  [[nodiscard]] VkPipelineLayout draw() const { return draw_.get(); }
  [[nodiscard]] VkPipelineLayout gather() const { return gather_.get(); }
  [[nodiscard]] VkPipelineLayout tiles() const { return tiles_.get(); }
  [[nodiscard]] VkPipelineLayout rays() const { return rays_.get(); }
  [[nodiscard]] VkFormat colour_format() const { return colour_format_; }

 private:
  [[nodiscard]] Result<vk::Pipeline> make_drawing(ViewPass pass, std::uint32_t features) const;
  [[nodiscard]] Result<vk::Pipeline> make_compute(ViewPass pass, std::uint32_t features) const;

  const Device::Impl& gpu_;
  VkFormat colour_format_ = VK_FORMAT_R32G32B32A32_SFLOAT;
  vk::DescriptorSetLayout frame_layout_, surface_layout_, gather_layout_, tiles_layout_, rays_layout_;
  vk::PipelineLayout draw_, gather_, tiles_, rays_;
  std::map<std::pair<ViewPass, std::uint32_t>, vk::Pipeline> made_;
  std::vector<std::string> names_;
};

/// As `ViewRenderer::pipelines` tells it: the pass and its features, e.g. `surface alpha colour_map shadows`.
[[nodiscard]] std::string pipeline_name(ViewPass pass, std::uint32_t features);

}  // namespace rigor::render
