// What a picture is drawn into, and read back from. Internal to sim/render/view.
#pragma once

#include <cstdint>

#include "sim/render/view/gpu_arena.h"
#include "sim/render/view/gpu_commands.h"

namespace rigor::render {

class FrameTargets {
 public:
  explicit FrameTargets(const Device::Impl& gpu) : gpu_(gpu) {}
  /// A part of the picture that is drawn at once: all its columns, some rows.
  struct Part {
    int first_row = 0, rows = 0;
  };
  /// Images for a part, buffers for the whole. Keeps what fits already.
  [[nodiscard]] Status prepare(int width_px, int height_px, int samples, VkFormat colour_format,
                               bool normals);
  [[nodiscard]] int rows_at_once() const { return rows_; }
  [[nodiscard]] VkSampleCountFlagBits samples() const {
    return samples_ == 4 ? VK_SAMPLE_COUNT_4_BIT : VK_SAMPLE_COUNT_1_BIT;
  }

  void record_begin(VkCommandBuffer commands) const;
  /// Which attachments a pass has.
  enum class Writes : std::uint8_t { depth, radiance, picture };
  struct Pass {
    Writes writes = Writes::picture;  ///< picture: radiance, identity, and normals where they were asked for
    bool clears_depth = false;        ///< the first pass on this part
    bool clears_colours = false;
    bool resolves = false;  ///< the last pass that writes them: samples become pixels
    bool resolves_identity = false;
  };
  void begin_pass(VkCommandBuffer commands, const Pass& pass, const Part& part) const;
  /// After the last pass: into the buffers.
  void record_readback(VkCommandBuffer commands, const Part& part) const;
  /// Farthest depths of tiles: makes the depth readable, and back.
  void record_depth_for_reading(VkCommandBuffer commands) const;
  void record_depth_for_drawing(VkCommandBuffer commands) const;
  [[nodiscard]] VkImageView depth_view() const { return depth_.view.get(); }

  [[nodiscard]] const float* radiance() const { return reinterpret_cast<const float*>(radiance_back_.data); }
  [[nodiscard]] const float* reversed_depth() const {
    return reinterpret_cast<const float*>(depth_back_.data);
  }
  [[nodiscard]] const std::uint32_t* identities() const {
    return reinterpret_cast<const std::uint32_t*>(identity_back_.data);
  }

  /// Where they were asked for.
  [[nodiscard]] const std::uint32_t* packed_normals() const {
    return reinterpret_cast<const std::uint32_t*>(normal_back_.data);
  }

 private:
  const Device::Impl& gpu_;
  int width_ = 0, height_ = 0, rows_ = 0, samples_ = 0;
  bool normals_ = false;
  vk::Image colour_, identity_, depth_, normal_;                  ///< with as many samples as asked for
  vk::Image colour_one_, identity_one_, depth_one_, normal_one_;  ///< of one sample, where there are more
  vk::Buffer radiance_back_, identity_back_, depth_back_, normal_back_;  ///< of the whole picture
};

}  // namespace rigor::render
