// Pictures of prototypes from all round, baked on the device from their finest level: what they reflect and
// where they face, so that they are lit like the rest. Internal to sim/render/view.
#pragma once

#include <cstdint>
#include <memory>
#include <unordered_map>
#include <vector>

#include "sim/render/view/resident_content.h"
#include "sim/render/view/view_pipelines.h"

namespace rigor::render {

inline constexpr VkFormat kImpostorMapFormat = VK_FORMAT_R8G8B8A8_UNORM;
inline constexpr int kImpostorColumns = 16, kImpostorRows = 3;  ///< azimuths; elevations 0°, 30°, 60°
inline constexpr std::uint32_t kImpostorCell_px = 64, kImpostorMips = 4;

struct ImpostorAtlas {
  vk::Image visible, infrared, normal;
  vk::Buffer uniforms;
  vk::DescriptorPool pool;
  VkDescriptorSet set = VK_NULL_HANDLE;  ///< owned by its pool
  bool baked = false;
  bool translucent = false;
  std::uint64_t last_seen = 0;
};

class Impostors {
 public:
  Impostors(const Device::Impl& gpu, ViewPipelines& pipelines) : gpu_(gpu), pipelines_(pipelines) {}
  [[nodiscard]] Status create();
  /// Null where the device has no room for one.
  [[nodiscard]] const ImpostorAtlas* get(const ResidentPrototype& prototype, std::uint64_t frame);
  /// Bakes those that are new.
  [[nodiscard]] Status record(VkCommandBuffer commands, VkDescriptorSet frame_set);
  void set_bands(const view_gpu::Bands& bands);
  void drop_older_than(std::uint64_t frame);

 private:
  struct Entry : ImpostorAtlas {
    const ResidentPrototype* prototype = nullptr;
  };
  [[nodiscard]] Result<std::unique_ptr<Entry>> make(const ResidentPrototype& prototype) const;
  [[nodiscard]] Status bake(VkCommandBuffer commands, VkDescriptorSet frame_set, Entry& entry);
  void write_uniforms(const Entry& entry) const;

  const Device::Impl& gpu_;
  ViewPipelines& pipelines_;
  vk::Sampler sampler_;
  vk::Image depth_;
  view_gpu::Bands bands_{0, 1, 2, 3};
  std::vector<vk::ImageView> views_of_bakes_;  ///< until the work that uses them is done
  std::vector<Entry*> pending_;
  std::unordered_map<std::uint64_t, std::unique_ptr<Entry>> entries_;
};

}  // namespace rigor::render
