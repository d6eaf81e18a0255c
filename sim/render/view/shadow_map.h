// Depth from a light on the device, in layers that are drawn into one by one. What stands still is kept in a
// picture of its own, from which the next one begins. Internal to sim/render/view.
#pragma once

#include <span>
#include <vector>

#include "sim/render/view/draw_lists.h"
#include "sim/render/view/kept_shadow.h"

namespace rigor::render {

/// What a layer is drawn from.
struct ShadowLayer {
  ShadowCascade cascade;
  KeptShadow::Use use = KeptShadow::Use::none;
  std::vector<Bucket> still, others;  ///< what is to be kept; what is drawn for this picture alone
  std::vector<DrawCall> still_calls, other_calls;
};

class ShadowMap {
 public:
  /// `first_cascade`: of the frame's numbers, which its layers follow. `array`: shaders see an array.
  ShadowMap(const Device::Impl& gpu, const ViewPipelines& pipelines, std::uint32_t layers,
            std::uint32_t first_cascade, bool array)
      : gpu_(gpu), pipelines_(pipelines), layers_(layers), first_cascade_(first_cascade), array_(array) {}

  /// Layers of this size. True: they are others than before, and hold nothing. Errors: unavailable.
  [[nodiscard]] Result<bool> set_side(int side_px);
  [[nodiscard]] VkImageView view() const { return shown_.image.view.get(); }
  /// What has to be drawn for a cascade; not what is smaller across than `smallest_m`.
  [[nodiscard]] ShadowLayer plan(std::size_t layer, const ShadowCascade& cascade,
                                 std::span<const ResidentBatch* const> batches, const CullOptions& options,
                                 double smallest_m = 0);
  /// Before anything else in the frame: layers that no pass may have touched must still be readable.
  void record_begin(VkCommandBuffer commands);
  /// Draws the calls of the first layers; the frame's set is bound to `frame_set`.
  void record(VkCommandBuffer commands, VkDescriptorSet frame_set, const DrawLists& lists,
              std::span<const ShadowLayer> layers, bool instancing);
  /// After a frame that failed: nothing that was planned is there. False: nothing was kept before either.
  bool forget();
  /// There is no room for it, until the next set_side().
  void keep_nothing() { no_room_ = true; }

 private:
  struct Depths {
    vk::Image image;
    std::vector<vk::ImageView> layers;
  };
  [[nodiscard]] Result<Depths> make(int side_px, VkImageUsageFlags usage) const;
  void draw(VkCommandBuffer commands, VkDescriptorSet frame_set, const DrawLists& lists, VkImageView into,
            bool clears, std::size_t layer, const ShadowCascade& cascade, std::span<const DrawCall> calls,
            bool instancing) const;

  const Device::Impl& gpu_;
  const ViewPipelines& pipelines_;
  std::uint32_t layers_, first_cascade_;
  bool array_;
  int side_px_ = 0;
  bool fresh_ = false;  ///< made, and not yet in a layout that can be read
  Depths shown_, kept_;
  std::vector<KeptShadow> keeps_;
  std::vector<char> as_kept_;  ///< by layer: shown is what is kept, and nothing else
  bool no_room_ = false;       ///< for what is kept
};

}  // namespace rigor::render
