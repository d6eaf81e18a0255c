// The pipelines of a renderer, specialised for what it draws. Internal to sim/render.
#pragma once

#include "sim/render/device_impl.h"

namespace rigor::render {

constexpr std::uint32_t kBufferBindings = 10;  ///< storage buffers 0 to 9 of the shaders
constexpr std::uint32_t kPictureBinding = 10;

/// Constants that the shaders are specialised for: what is off has no code.
struct PipelineOptions {
  bool mono = true;
  bool highlights = false;
  bool ground_noise = false;
  int format = 0;  ///< as PixelFormat
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
  vk::Pipeline body, ground, sky, lens_map, sensor;
  vk::CommandPool pool;
  VkCommandBuffer commands = VK_NULL_HANDLE;  ///< owned by its pool
};

[[nodiscard]] Result<Pipelines> make_pipelines(const Device::Impl& gpu, const PipelineOptions& options);

}  // namespace rigor::render
