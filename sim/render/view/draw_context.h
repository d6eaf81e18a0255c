// What everything that draws content on a device needs: pipelines, the content that lies on the device, and a
// command buffer. The view renderer and the engine of range views build on it. Internal to sim/render/view.
#pragma once

#include <memory>
#include <vector>

#include "sim/render/view/frame_passes.h"
#include "sim/render/view/view_renderer.h"

namespace rigor::render {

class DrawContext {
 public:
  explicit DrawContext(std::shared_ptr<Device> d)
      : device(std::move(d)),
        pipelines(gpu()),
        uploads(gpu()),
        resources(gpu(), pipelines, uploads),
        lists(gpu(), pipelines) {}
  [[nodiscard]] Status create();

  [[nodiscard]] const Device::Impl& gpu() const { return device->impl(); }
  /// A fresh command buffer.
  [[nodiscard]] Status begin();
  /// Ends it, and waits until the device is done.
  [[nodiscard]] Status submit();
  /// What of a frame can be drawn, made resident under `frame_number`. Adds to the statistics.
  [[nodiscard]] Status take_over(const ContentFrame& frame, std::vector<const ResidentBatch*>& batches,
                                 ViewStatistics& s);
  void bind_frame() const;
  /// Frees what none of the last frames showed.
  void drop_unseen();

  // Destroyed last to first: what others were made from outlives them.
  std::shared_ptr<Device> device;
  ViewPipelines pipelines;
  ImageUploads uploads;
  FrameResources resources;
  std::unique_ptr<TexturePool> textures;
  std::unique_ptr<ResidentContent> content;
  DrawLists lists;
  vk::CommandPool pool;
  VkCommandBuffer commands = VK_NULL_HANDLE;
  vk::Fence fence;
  std::uint64_t frame_number = 0;
  /// Frames for which things stay on the device unseen.
  static constexpr std::uint64_t kFramesKept = 16;
};

}  // namespace rigor::render
