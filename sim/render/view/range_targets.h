// What a range view is drawn into: three pictures of words (sim/render/shaders/view/range_main.glsl) and a
// depth. Internal to sim/render/view.
#pragma once

#include <array>

#include "sim/render/view/gpu_commands.h"

namespace rigor::render {

class RangeTargets {
 public:
  explicit RangeTargets(const Device::Impl& gpu) : gpu_(gpu) {}
  /// Room for a view of this size; what is large enough is kept.
  [[nodiscard]] Status prepare(int width_px, int height_px);
  /// Clears, and begins to draw into the top left width x height of it.
  void begin(VkCommandBuffer commands, int width_px, int height_px) const;
  /// Ends drawing: compute shaders may read.
  void end(VkCommandBuffer commands) const;
  [[nodiscard]] VkImageView view(std::size_t i) const { return maps_[i].view.get(); }

 private:
  const Device::Impl& gpu_;
  int width_ = 0, height_ = 0;
  std::array<vk::Image, 3> maps_;
  vk::Image depth_;
};

}  // namespace rigor::render
