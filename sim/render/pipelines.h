// The pipelines of a renderer, specialised for what it draws. Internal to sim/render.
#pragma once

#include <array>
#include <cstddef>

#include "sim/render/device_impl.h"

namespace rigor::render {

/// Bindings of the shaders, in their order; see bindings.glsl and the compute shaders.
enum Binding : std::uint32_t {
  kFrameBinding,
  kSurfaceBinding,
  kCasterBinding,
  kCasterListBinding,
  kLensBinding = 6,
  kMapBinding,
  kSensorBinding,
  kOutputBinding,
  kPictureBinding,
  kMapImageBinding
};

/// Variants of the surface shaders by how many bodies may shade a surface, without and with cylinders among
/// them. The last loops over any number.
constexpr std::array<std::uint32_t, 5> kCasterClasses{0, 1, 2, 4, 16};
constexpr std::size_t kLoopVariant = 2 * kCasterClasses.size();
constexpr std::size_t kCasterVariants = kLoopVariant + 1;
[[nodiscard]] constexpr std::size_t caster_variant(std::uint32_t casters, bool cylinders) {
  std::size_t i = 0;
  while (i < kCasterClasses.size() && casters > kCasterClasses[i]) ++i;
  return i == kCasterClasses.size() ? kLoopVariant : 2 * i + (cylinders ? 1 : 0);
}

/// Constants that the shaders are specialised for: what is off has no code.
struct PipelineOptions {
  bool mono = true;
  bool highlights = false;         ///< on bodies
  bool ground_highlights = false;  ///< on the ground
  bool ground_noise = false;
  bool boards = false;
  std::uint32_t bodies = 0;     ///< no surface is shaded by more
  std::uint32_t cylinders = 0;  ///< of them
  int format = 0;               ///< as PixelFormat
  bool shot_noise = true;
  bool read_noise = true;
  int taps = 1;
};

struct Pipelines {
  VkFormat colour_format = VK_FORMAT_R32_SFLOAT;
  vk::DescriptorSetLayout set_layout;
  vk::DescriptorPool descriptor_pool;
  VkDescriptorSet set = VK_NULL_HANDLE;  ///< owned by its pool
  vk::PipelineLayout layout;
  std::array<vk::Pipeline, kCasterVariants> body, board, ground;  ///< those that the scene can need
  vk::Pipeline sky, lens_map, sensor;
  vk::CommandPool pool;
  VkCommandBuffer commands = VK_NULL_HANDLE;  ///< owned by its pool
};

[[nodiscard]] Result<Pipelines> make_pipelines(const Device::Impl& gpu, const PipelineOptions& options);

}  // namespace rigor::render
