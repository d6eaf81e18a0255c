// Textures and surfaces on the device, kept as long as they are seen. Internal to sim/render/view.
#pragma once

#include <cstdint>
#include <memory>
#include <unordered_map>
#include <utility>
#include <vector>

#include "sim/render/view/gpu_arena.h"
#include "sim/render/view/view_structs.h"

namespace rigor::render {

/// Trilinear, over all mip levels. Errors: unavailable.
[[nodiscard]] Result<vk::Sampler> make_sampler(const Device::Impl& gpu, VkSamplerAddressMode mode);

/// Pictures on their way to the device: recorded at the beginning of a frame, kept until it is drawn.
class ImageUploads {
 public:
  struct Level {
    std::uint32_t width = 1, height = 1;
    std::vector<std::byte> bytes;
  };
  explicit ImageUploads(const Device::Impl& gpu) : gpu_(gpu) {}
  [[nodiscard]] Status add(VkImage image, const std::vector<Level>& levels);
  /// Leaves the pictures ready to be sampled in fragment shaders.
  void record(VkCommandBuffer commands);
  void done() { pending_.clear(); }
  /// Before an image goes that may not have been filled yet.
  void forget(VkImage image) {
    std::erase_if(pending_, [&](const Pending& p) { return p.image == image; });
  }
  [[nodiscard]] bool empty() const { return pending_.empty(); }
  [[nodiscard]] std::size_t bytes() const;

 private:
  struct Pending {
    VkImage image = VK_NULL_HANDLE;
    vk::Buffer staging;
    std::vector<VkBufferImageCopy> copies;
  };
  const Device::Impl& gpu_;
  std::vector<Pending> pending_;
};

/// What of a surface calls for code of its own in the shader.
enum SurfaceFeature : std::uint32_t {
  kFeatureColourMap = 1u << 0,
  kFeatureNearInfraredMap = 1u << 1,
  kFeatureNormalMap = 1u << 2,
  kFeatureGlossMap = 1u << 3,
  kFeatureAlpha = 1u << 4,
  kFeatureTranslucent = 1u << 5,
  kFeatureWater = 1u << 6,
  kFeatureHaze = 1u << 7,
  kFeatureLamps = 1u << 8,
  kFeatureSnow = 1u << 9,
  kFeatureWet = 1u << 10,
  kFeatureShadows = 1u << 11,
  kFeatureGlossy = 1u << 12,
  kFeatureMultisampled = 1u << 13,
  kFeatureTwoSided = 1u << 14,
  kFeatureSway = 1u << 15,
  kFeatureSkyCover = 1u << 16,
  kFeatureAfterDepth = 1u << 17,  ///< what is seen there is known already: shaded where the depth is the same
  kFeatureNormals = 1u << 18,     ///< normals are written too
};

struct ResidentSurface {
  std::shared_ptr<const Surface> surface;
  VkDescriptorSet set = VK_NULL_HANDLE;
  std::uint32_t features = 0;  ///< of SurfaceFeature: those that the surface itself brings
  Slice uniforms;
  std::uint64_t last_seen = 0;
};

class TexturePool {
 public:
  /// `set_layout`: uniforms and four maps.
  TexturePool(const Device::Impl& gpu, VkDescriptorSetLayout set_layout, ImageUploads& uploads);
  [[nodiscard]] Status create();
  /// Null stands for a matt grey. The address holds until the surface is dropped.
  [[nodiscard]] Result<const ResidentSurface*> get(const std::shared_ptr<const Surface>& surface,
                                                   std::uint64_t frame);
  void set_bands(const view_gpu::Bands& bands);
  /// Frees what has not been seen since `frame`. No work that reads them may be under way.
  void drop_older_than(std::uint64_t frame);
  [[nodiscard]] std::size_t textures() const { return textures_.size(); }

 private:
  struct ResidentTexture {
    vk::Image image;
    bool repeat = true;
    std::uint64_t last_seen = 0;
  };
  struct TextureKey {
    std::uint64_t serial = 0;
    std::uint32_t cutoff_bits = 0;
    bool operator==(const TextureKey&) const = default;
  };
  struct KeyHash {
    std::size_t operator()(const TextureKey& k) const {
      return static_cast<std::size_t>(k.serial * 0x9E3779B97F4A7C15ULL ^ k.cutoff_bits);
    }
  };
  [[nodiscard]] Result<ResidentTexture*> texture(const std::shared_ptr<const Texture>& texture, float cutoff,
                                                 std::uint64_t frame);
  [[nodiscard]] Result<VkDescriptorSet> make_set(std::pair<VkDescriptorPool, VkDescriptorSet>& out);
  void write_uniforms(const ResidentSurface& s) const;

  struct SurfaceSlot : ResidentSurface {
    VkDescriptorPool pool = VK_NULL_HANDLE;
    std::array<TextureKey, 4> maps{};
  };
  const Device::Impl& gpu_;
  VkDescriptorSetLayout set_layout_;
  ImageUploads& uploads_;
  GpuArena uniforms_;
  view_gpu::Bands bands_{0, 1, 2, 3};
  vk::Sampler repeat_, clamp_;
  vk::Image white_;
  std::vector<vk::DescriptorPool> pools_;
  std::shared_ptr<const Surface> grey_;
  std::unordered_map<TextureKey, std::unique_ptr<ResidentTexture>, KeyHash> textures_;
  std::unordered_map<std::uint64_t, std::unique_ptr<SurfaceSlot>> surfaces_;
};

/// Mip levels of a texture from the largest down. Colours are averaged in linear light, weighted by coverage;
/// with a cutoff above 0, each level's alpha is scaled so that as large a share of it passes the cutoff as of
/// the largest (Castaño 2010).
[[nodiscard]] std::vector<ImageUploads::Level> make_mips(const Texture& texture, float cutoff);

}  // namespace rigor::render
