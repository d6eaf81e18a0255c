#include "sim/render/renderer.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstring>
#include <iterator>
#include <optional>
#include <string>

#include "rt-core/stage_time.h"
#include "sim/render/device_impl.h"
#include "sim/render/frame_geometry.h"
#include "sim/render/pipelines.h"

namespace rigor::render {
namespace {

constexpr int kPictureMargin_px = 2;  // bilinear taps of the outermost pixels stay inside
constexpr int kMaxPictureSide_px = 8192;
constexpr int kCylinderSegments = 64;
constexpr std::uint32_t kNoOffset = 0;

using Clock = std::chrono::steady_clock;
template <class T>
void upload(const vk::Buffer& buffer, const std::vector<T>& data) {
  if (!data.empty()) std::memcpy(buffer.data, data.data(), data.size() * sizeof(T));
}

int picture_bits(PixelFormat f, int adc_bits) { return std::min(adc_bits, significant_bits(f)); }

/// How the sensor pass lays pixels down: the number in sensor.comp.
int layout_of(PixelFormat f) {
  constexpr int kBayer16 = 5;
  if (is_mono(f) && has_words(f)) return static_cast<int>(PixelFormat::mono16);
  if (is_bayer(f) && has_words(f)) return kBayer16;
  return static_cast<int>(f);
}

/// A cube and a cylinder of half size 1, counter-clockwise seen from outside.
struct UnitMeshes {
  std::vector<gpu::BodyVertex> vertices;
  std::uint32_t box_first = 0, box_count = 0, cylinder_first = 0, cylinder_count = 0;
};

UnitMeshes make_unit_meshes() {
  UnitMeshes m;
  const auto add = [&m](const Eigen::Vector3f& p, const Eigen::Vector3f& n) {
    m.vertices.push_back({{p.x(), p.y(), p.z()}, {n.x(), n.y(), n.z()}});
  };
  for (int axis = 0; axis < 3; ++axis)
    for (const float side : {-1.0f, 1.0f}) {
      Eigen::Vector3f n = Eigen::Vector3f::Zero(), u = n, v = n;
      n[axis] = side;
      u[(axis + 1) % 3] = side;
      v[(axis + 2) % 3] = 1.0f;
      const Eigen::Vector3f c[4] = {n - u - v, n + u - v, n + u + v, n - u + v};
      for (const int k : {0, 1, 2, 0, 2, 3}) add(c[k], n);
    }
  m.box_count = static_cast<std::uint32_t>(m.vertices.size());
  m.cylinder_first = m.box_count;
  const auto rim = [](int k, float z) {
    const double a = 2.0 * 3.14159265358979323846 * (k % kCylinderSegments) / kCylinderSegments;
    return Eigen::Vector3f(static_cast<float>(std::cos(a)), static_cast<float>(std::sin(a)), z);
  };
  const auto flat = [](const Eigen::Vector3f& p) { return Eigen::Vector3f(p.x(), p.y(), 0.0f); };
  for (int k = 0; k < kCylinderSegments; ++k) {
    const Eigen::Vector3f a = rim(k, -1), b = rim(k + 1, -1), c = rim(k + 1, 1), d = rim(k, 1);
    for (const auto& p : {a, b, c, a, c, d}) add(p, flat(p));
    if (k == 0 || k + 1 == kCylinderSegments) continue;  // caps as fans about vertex 0
    for (const auto& p : {rim(0, 1), d, c}) add(p, Eigen::Vector3f::UnitZ());
    for (const auto& p : {rim(0, -1), b, a}) add(p, -Eigen::Vector3f::UnitZ());
  }
  m.cylinder_count = static_cast<std::uint32_t>(m.vertices.size()) - m.cylinder_first;
  return m;
}

/// The extent of the ideal rays of a region, from the lens map.
struct RayBounds {
  float x0 = 0, x1 = 0, y0 = 0, y1 = 0;
  bool any = false;
};

}  // namespace

struct Renderer::Impl {
  // Destroyed last to first: what the pipelines were made from outlives them.
  std::shared_ptr<Device> device;
  std::shared_ptr<const world::Scene> scene;
  RendererOptions options;
  Pipelines pipelines;
  UnitMeshes meshes;
  std::optional<FrameGeometry> geometry;
  PictureGeometry picture;
  int taps = 1;

  vk::Buffer frame, surfaces, casters, caster_list, lens, map, sensor, output;
  vk::Buffer mesh_vertices, ground_vertices;
  vk::Image colour, depth, map_image;
  vk::Fence fence;
  std::size_t surface_stride = 0;
  bool warm_up = false;  ///< draw one empty triangle with every variant, so that all are compiled
  std::optional<Region> bounds_of;
  VkRect2D scissor{};

  Device::Impl& gpu() { return device->impl(); }

  Status make_buffers();
  Status make_lens_map();
  Status choose_picture();
  Status make_images();
  void write_descriptors(bool with_picture);
  RayBounds ray_bounds(const Region& region) const;
  void set_scissor(const Region& region);
  Status check(const PictureRequest& request, const world::WorldSnapshot& snapshot) const;
  void prepare(const PictureRequest& request, const world::WorldSnapshot& snapshot);
  Status begin();
  Status submit();
  void draw_surface(const SurfaceDraw& d);
  void draw_nothing_with(const vk::Pipeline& pipeline, bool ground);
  void record_raster();
  void record_sensor(const Region& region);
};

/// Lists grow with the square of the bodies, as each may throw its shadow on each: refused before they are
/// made, by what is too large.
static Status check_limits(const world::Scene& scene, const CameraModel& camera, std::size_t most_bytes) {
  const std::size_t n = scene.bodies.size();
  if (n * n * sizeof(std::uint32_t) > most_bytes)
    return fail(ErrorCode::bad_input, "world",
                "bodies: expected at most " +
                    std::to_string(static_cast<std::size_t>(
                        std::sqrt(static_cast<double>(most_bytes / sizeof(std::uint32_t))))) +
                    ", which the small renderer draws on this device, got " + std::to_string(n) +
                    "; give the channel `renderer: rays`");
  const std::size_t pixels =
      static_cast<std::size_t>(camera.width_px) * static_cast<std::size_t>(camera.height_px);
  if (pixels * sizeof(gpu::vec4) > most_bytes)
    return fail(ErrorCode::bad_input, "camera model",
                "expected at most " + std::to_string(most_bytes / sizeof(gpu::vec4)) +
                    " pixels, which the small renderer draws on this device, got " +
                    std::to_string(camera.width_px) + " x " + std::to_string(camera.height_px) +
                    "; give the channel `renderer: rays`, or choose a smaller picture");
  return {};
}

Status Renderer::Impl::make_buffers() {
  const std::size_t n = scene->bodies.size();
  const std::size_t pixels = static_cast<std::size_t>(options.camera.width_px) * options.camera.height_px;
  const std::size_t output_bytes = (pixels * bits_per_pixel(options.format) / 8 + 32) & ~std::size_t{15};
  constexpr VkBufferUsageFlags kStorage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT;
  constexpr VkBufferUsageFlags kUniform = VK_BUFFER_USAGE_UNIFORM_BUFFER_BIT;
  const std::size_t step = gpu().limits.minUniformBufferOffsetAlignment;
  surface_stride = (sizeof(gpu::SurfaceData) + step - 1) / step * step;
  struct Wanted {
    vk::Buffer* buffer;
    std::size_t size_bytes;
    VkBufferUsageFlags usage;
  };
  for (const Wanted& w :
       {Wanted{&frame, sizeof(gpu::FrameUniforms), kUniform},
        Wanted{&surfaces, std::max<std::size_t>(geometry->max_surfaces(), 1) * surface_stride, kUniform},
        Wanted{&casters, n * sizeof(gpu::CasterData), kStorage},
        Wanted{&caster_list, geometry->max_caster_list() * sizeof(std::uint32_t), kStorage},
        Wanted{&lens, sizeof(gpu::LensUniforms), kUniform},
        Wanted{&map, pixels * sizeof(gpu::vec4), kStorage | VK_BUFFER_USAGE_TRANSFER_SRC_BIT},
        Wanted{&sensor, sizeof(gpu::SensorUniforms), kUniform}, Wanted{&output, output_bytes, kStorage},
        Wanted{&mesh_vertices, meshes.vertices.size() * sizeof(gpu::BodyVertex),
               VK_BUFFER_USAGE_VERTEX_BUFFER_BIT},
        Wanted{&ground_vertices, 6 * geometry->max_tiles() * sizeof(gpu::GroundVertex),
               VK_BUFFER_USAGE_VERTEX_BUFFER_BIT}}) {
    auto made = gpu().make_buffer(w.size_bytes, w.usage);
    if (!made) return tl::unexpected(made.error());
    *w.buffer = std::move(*made);
  }
  upload(mesh_vertices, meshes.vertices);
  VkFenceCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_FENCE_CREATE_INFO;
  VkFence handle = VK_NULL_HANDLE;
  if (const VkResult r = vkCreateFence(gpu().device, &info, nullptr, &handle); r != VK_SUCCESS)
    return vk::failed("making a fence", r);
  fence = vk::Fence(gpu().device, handle);
  return {};
}

void Renderer::Impl::write_descriptors(bool with_picture) {
  struct Bound {
    Binding binding;
    const vk::Buffer* buffer;
    VkDescriptorType type;
    VkDeviceSize range;
  };
  const std::array bound{
      Bound{kFrameBinding, &frame, VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, VK_WHOLE_SIZE},
      Bound{kSurfaceBinding, &surfaces, VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER_DYNAMIC, sizeof(gpu::SurfaceData)},
      Bound{kCasterBinding, &casters, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, VK_WHOLE_SIZE},
      Bound{kCasterListBinding, &caster_list, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, VK_WHOLE_SIZE},
      Bound{kLensBinding, &lens, VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, VK_WHOLE_SIZE},
      Bound{kMapBinding, &map, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, VK_WHOLE_SIZE},
      Bound{kSensorBinding, &sensor, VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, VK_WHOLE_SIZE},
      Bound{kOutputBinding, &output, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, VK_WHOLE_SIZE}};
  std::array<VkDescriptorBufferInfo, bound.size()> info{};
  std::array<VkWriteDescriptorSet, bound.size() + 2> write{};
  for (std::size_t i = 0; i < bound.size(); ++i) {
    info[i] = {bound[i].buffer->handle.get(), 0, bound[i].range};
    write[i].sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    write[i].dstSet = pipelines.set;
    write[i].dstBinding = bound[i].binding;
    write[i].descriptorCount = 1;
    write[i].descriptorType = bound[i].type;
    write[i].pBufferInfo = &info[i];
  }
  const std::array<VkDescriptorImageInfo, 2> images{
      VkDescriptorImageInfo{VK_NULL_HANDLE, colour.view.get(), VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL},
      VkDescriptorImageInfo{VK_NULL_HANDLE, map_image.view.get(), VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL}};
  for (std::size_t i = 0; i < images.size(); ++i) {
    VkWriteDescriptorSet& w = write[bound.size() + i];
    w.sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET;
    w.dstSet = pipelines.set;
    w.dstBinding = i == 0 ? kPictureBinding : kMapImageBinding;
    w.descriptorCount = 1;
    w.descriptorType = VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE;
    w.pImageInfo = &images[i];
  }
  vkUpdateDescriptorSets(gpu().device, static_cast<std::uint32_t>(bound.size()) + (with_picture ? 2u : 0u),
                         write.data(), 0, nullptr);
}

Status Renderer::Impl::begin() {
  if (const VkResult r = vkResetCommandPool(gpu().device, pipelines.pool.get(), 0); r != VK_SUCCESS)
    return vk::failed("resetting a command pool", r);
  VkCommandBufferBeginInfo info{};
  info.sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO;
  info.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
  if (const VkResult r = vkBeginCommandBuffer(pipelines.commands, &info); r != VK_SUCCESS)
    return vk::failed("beginning a command buffer", r);
  return {};
}

Status Renderer::Impl::submit() {
  if (const VkResult r = vkEndCommandBuffer(pipelines.commands); r != VK_SUCCESS)
    return vk::failed("recording a command buffer", r);
  return gpu().run(pipelines.commands, fence.get());
}

namespace {

void memory_barrier(VkCommandBuffer commands, VkPipelineStageFlags2 from, VkAccessFlags2 from_access,
                    VkPipelineStageFlags2 to, VkAccessFlags2 to_access) {
  VkMemoryBarrier2 barrier{};
  barrier.sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER_2;
  barrier.srcStageMask = from;
  barrier.srcAccessMask = from_access;
  barrier.dstStageMask = to;
  barrier.dstAccessMask = to_access;
  VkDependencyInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO;
  info.memoryBarrierCount = 1;
  info.pMemoryBarriers = &barrier;
  vkCmdPipelineBarrier2(commands, &info);
}

VkImageMemoryBarrier2 image_barrier(VkImage image, VkImageAspectFlags aspect, VkImageLayout from,
                                    VkImageLayout to) {
  VkImageMemoryBarrier2 b{};
  b.sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER_2;
  b.oldLayout = from;
  b.newLayout = to;
  b.srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
  b.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
  b.image = image;
  b.subresourceRange = {aspect, 0, 1, 0, 1};
  return b;
}

void barrier(VkCommandBuffer commands, std::span<const VkImageMemoryBarrier2> images) {
  VkDependencyInfo info{};
  info.sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO;
  info.imageMemoryBarrierCount = static_cast<std::uint32_t>(images.size());
  info.pImageMemoryBarriers = images.data();
  vkCmdPipelineBarrier2(commands, &info);
}
void barrier(VkCommandBuffer commands, const VkImageMemoryBarrier2& image) { barrier(commands, {&image, 1}); }

void dispatch(VkCommandBuffer commands, std::size_t invocations) {
  constexpr std::size_t kRow = 32768;
  const std::size_t groups = (invocations + 63) / 64;
  const std::size_t x = std::min(groups, kRow);
  vkCmdDispatch(commands, static_cast<std::uint32_t>(x), static_cast<std::uint32_t>((groups + x - 1) / x), 1);
}

}  // namespace

Status Renderer::Impl::make_lens_map() {
  const CameraModel& c = options.camera;
  const auto f = [](double v) { return static_cast<float>(v); };
  gpu::LensUniforms u;
  u.camera = {f(c.fx_px), f(c.fy_px), f(c.cx_px), f(c.cy_px)};
  u.lens_a = {f(c.lens.k1), f(c.lens.k2), f(c.lens.p1), f(c.lens.p2)};
  u.lens_b = {f(c.lens.k3), f(c.lens.k4), f(c.lens.k5), f(c.lens.k6)};
  u.vignetting = {f(c.vignetting.cos4_weight), f(c.vignetting.a2), f(c.vignetting.a4), f(c.vignetting.a6)};
  const bool pattern = options.noise && (c.noise.prnu > 0.0 || c.noise.dsnu_e > 0.0);
  u.pattern = {f(c.noise.prnu), f(c.noise.dsnu_e), pattern ? 1.0f : 0.0f, 0.0f};
  u.sensor = {static_cast<std::uint32_t>(c.width_px), static_cast<std::uint32_t>(c.height_px),
              options.key.word0, options.key.word1};
  std::memcpy(lens.data, &u, sizeof u);
  write_descriptors(false);
  auto made = gpu().make_image(VK_FORMAT_R32G32B32A32_SFLOAT, u.sensor.x, u.sensor.y,
                               VK_IMAGE_USAGE_TRANSFER_DST_BIT | VK_IMAGE_USAGE_SAMPLED_BIT,
                               VK_IMAGE_ASPECT_COLOR_BIT);
  if (!made) return tl::unexpected(made.error());
  map_image = std::move(*made);
  if (auto s = begin(); !s) return s;
  vkCmdBindPipeline(pipelines.commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipelines.lens_map.get());
  vkCmdBindDescriptorSets(pipelines.commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipelines.layout.get(), 0, 1,
                          &pipelines.set, 1, &kNoOffset);
  dispatch(pipelines.commands, static_cast<std::size_t>(c.width_px) * c.height_px);
  // The host reads the map here; the sensor pass samples a copy of it, which software drivers read several
  // times faster than a buffer.
  memory_barrier(pipelines.commands, VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT, VK_ACCESS_2_SHADER_WRITE_BIT,
                 VK_PIPELINE_STAGE_2_HOST_BIT | VK_PIPELINE_STAGE_2_COPY_BIT,
                 VK_ACCESS_2_HOST_READ_BIT | VK_ACCESS_2_TRANSFER_READ_BIT);
  VkImageMemoryBarrier2 change =
      image_barrier(map_image.handle.get(), VK_IMAGE_ASPECT_COLOR_BIT, VK_IMAGE_LAYOUT_UNDEFINED,
                    VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL);
  change.dstStageMask = VK_PIPELINE_STAGE_2_COPY_BIT;
  change.dstAccessMask = VK_ACCESS_2_TRANSFER_WRITE_BIT;
  barrier(pipelines.commands, change);
  VkBufferImageCopy copy{};
  copy.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
  copy.imageExtent = {u.sensor.x, u.sensor.y, 1};
  vkCmdCopyBufferToImage(pipelines.commands, map.handle.get(), map_image.handle.get(),
                         VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, 1, &copy);
  change = image_barrier(map_image.handle.get(), VK_IMAGE_ASPECT_COLOR_BIT,
                         VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL);
  change.srcStageMask = VK_PIPELINE_STAGE_2_COPY_BIT;
  change.srcAccessMask = VK_ACCESS_2_TRANSFER_WRITE_BIT;
  change.dstStageMask = VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT;
  change.dstAccessMask = VK_ACCESS_2_SHADER_READ_BIT;
  barrier(pipelines.commands, change);
  return submit();
}

RayBounds Renderer::Impl::ray_bounds(const Region& region) const {
  RayBounds b;
  const auto* const pixel = reinterpret_cast<const gpu::vec4*>(map.data);
  for (int v = region.offset_y_px; v < region.offset_y_px + region.height_px; ++v) {
    const gpu::vec4* const row = pixel + static_cast<std::size_t>(v) * options.camera.width_px;
    for (int u = region.offset_x_px; u < region.offset_x_px + region.width_px; ++u) {
      const gpu::vec4& p = row[u];
      if (p.z == 0.0f) continue;  // no ray reaches this pixel
      if (!b.any) b = {p.x, p.x, p.y, p.y, true};
      b.x0 = std::min(b.x0, p.x);
      b.x1 = std::max(b.x1, p.x);
      b.y0 = std::min(b.y0, p.y);
      b.y1 = std::max(b.y1, p.y);
    }
  }
  return b;
}

Status Renderer::Impl::choose_picture() {
  const CameraModel& c = options.camera;
  const RayBounds b = ray_bounds({0, 0, c.width_px, c.height_px});
  if (!b.any)
    return fail(ErrorCode::bad_input, "camera model",
                "lens: expected coefficients under which light reaches a pixel, got none");
  taps = static_cast<int>(std::ceil(options.supersampling));
  picture.focal_x_px = c.fx_px * options.supersampling;
  picture.focal_y_px = c.fy_px * options.supersampling;
  // With an even number of taps a sensor pixel's centre lies between picture pixels, so that its taps fall on
  // them.
  const double shift = kPictureMargin_px + (taps % 2 == 0 ? 0.5 : 0.0) + options.supersampling;
  picture.centre_u_px = shift - b.x0 * picture.focal_x_px;
  picture.centre_v_px = shift - b.y0 * picture.focal_y_px;
  const double width = std::ceil((b.x1 - b.x0) * picture.focal_x_px + 2 * shift) + 1;
  const double height = std::ceil((b.y1 - b.y0) * picture.focal_y_px + 2 * shift) + 1;
  const double limit = std::min<double>(kMaxPictureSide_px, gpu().limits.maxImageDimension2D);
  if (!(width <= limit && height <= limit))
    return fail(ErrorCode::bad_input, "camera model",
                "lens: its rays reach tan x = " + std::to_string(std::max(-b.x0, b.x1)) +
                    ", tan y = " + std::to_string(std::max(-b.y0, b.y1)) +
                    ", which needs a pinhole picture of " + std::to_string(static_cast<long long>(width)) +
                    "x" + std::to_string(static_cast<long long>(height)) + " px; expected at most " +
                    std::to_string(static_cast<long long>(limit)) +
                    " a side: choose a narrower lens or less supersampling");
  picture.width_px = static_cast<int>(width);
  picture.height_px = static_cast<int>(height);
  return {};
}

Status Renderer::Impl::make_images() {
  const auto w = static_cast<std::uint32_t>(picture.width_px),
             h = static_cast<std::uint32_t>(picture.height_px);
  auto made = gpu().make_image(
      pipelines.colour_format, w, h,
      VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT | VK_IMAGE_USAGE_SAMPLED_BIT | VK_IMAGE_USAGE_TRANSFER_SRC_BIT,
      VK_IMAGE_ASPECT_COLOR_BIT);
  if (!made) return tl::unexpected(made.error());
  colour = std::move(*made);
  made = gpu().make_image(VK_FORMAT_D32_SFLOAT, w, h, VK_IMAGE_USAGE_DEPTH_STENCIL_ATTACHMENT_BIT,
                          VK_IMAGE_ASPECT_DEPTH_BIT);
  if (!made) return tl::unexpected(made.error());
  depth = std::move(*made);
  write_descriptors(true);
  return {};
}

void Renderer::Impl::set_scissor(const Region& region) {
  if (bounds_of && *bounds_of == region) return;
  const RayBounds b = ray_bounds(region);
  const double margin = kPictureMargin_px + options.supersampling;
  const auto clip = [](double v, int size) {
    return static_cast<int>(std::clamp(v, 0.0, static_cast<double>(size)));
  };
  const int x0 =
      clip(std::floor(b.x0 * picture.focal_x_px + picture.centre_u_px - margin), picture.width_px - 1);
  const int y0 =
      clip(std::floor(b.y0 * picture.focal_y_px + picture.centre_v_px - margin), picture.height_px - 1);
  const int x1 =
      clip(std::ceil(b.x1 * picture.focal_x_px + picture.centre_u_px + margin) + 1, picture.width_px);
  const int y1 =
      clip(std::ceil(b.y1 * picture.focal_y_px + picture.centre_v_px + margin) + 1, picture.height_px);
  scissor = {{x0, y0}, {static_cast<std::uint32_t>(x1 - x0), static_cast<std::uint32_t>(y1 - y0)}};
  bounds_of = region;
}

Status Renderer::Impl::check(const PictureRequest& q, const world::WorldSnapshot& snapshot) const {
  const CameraModel& c = options.camera;
  const Region& r = q.region;
  // In 64 bits: an offset near the end of int must not wrap around.
  const auto fits = [](long long offset, long long size, long long all) {
    return offset >= 0 && size >= 1 && offset + size <= all;
  };
  if (!fits(r.offset_x_px, r.width_px, c.width_px) || !fits(r.offset_y_px, r.height_px, c.height_px))
    return fail(ErrorCode::bad_input, "region",
                "expected a region within " + std::to_string(c.width_px) + "x" + std::to_string(c.height_px) +
                    " px, got " + std::to_string(r.width_px) + "x" + std::to_string(r.height_px) + " at (" +
                    std::to_string(r.offset_x_px) + ", " + std::to_string(r.offset_y_px) + ")");
  if (is_bayer(options.format) && (r.offset_x_px % 2 != 0 || r.offset_y_px % 2 != 0))
    return fail(ErrorCode::bad_input, "region",
                std::string(pfnc_name(options.format)) + ": expected even offsets, got (" +
                    std::to_string(r.offset_x_px) + ", " + std::to_string(r.offset_y_px) + ")");
  if (!(q.exposure_s >= 0.0 && q.exposure_s <= 3600.0))
    return fail(ErrorCode::bad_input, "exposure",
                "expected 0 to 3600 s, got " + std::to_string(q.exposure_s));
  if (!(q.gain > 0.0 && q.gain <= 1e6))
    return fail(ErrorCode::bad_input, "gain", "expected a factor in (0, 1e6], got " + std::to_string(q.gain));
  if (snapshot.joints.size() != scene->nodes.size())
    return fail(ErrorCode::bad_input, "world",
                "expected a snapshot of this scene with " + std::to_string(scene->nodes.size()) +
                    " nodes, got one with " + std::to_string(snapshot.joints.size()));
  if (!q.T_world_sensor.matrix().allFinite())
    return fail(ErrorCode::bad_input, "T_world_sensor", "expected finite numbers");
  return {};
}

void Renderer::Impl::prepare(const PictureRequest& q, const world::WorldSnapshot& snapshot) {
  set_scissor(q.region);
  geometry->build(picture, q.T_world_sensor, snapshot, q.t_capture);
  std::memcpy(frame.data, &geometry->uniforms, sizeof geometry->uniforms);
  for (std::size_t i = 0; i < geometry->surfaces.size(); ++i)
    std::memcpy(surfaces.data + i * surface_stride, &geometry->surfaces[i], sizeof(gpu::SurfaceData));
  upload(casters, geometry->casters);
  upload(caster_list, geometry->caster_list);
  upload(ground_vertices, geometry->ground_vertices);

  const CameraModel& c = options.camera;
  const auto f = [](double v) { return static_cast<float>(v); };
  const auto u32 = [](auto v) { return static_cast<std::uint32_t>(v); };
  const int adc_bits = c.noise.adc_bits;
  gpu::SensorUniforms u;
  u.region = {u32(q.region.offset_x_px), u32(q.region.offset_y_px), u32(q.region.width_px),
              u32(q.region.height_px)};
  u.sensor = {u32(c.width_px), u32(c.height_px), options.key.word0, options.key.word1};
  const std::size_t bits =
      static_cast<std::size_t>(q.region.width_px) * q.region.height_px * bits_per_pixel(options.format);
  u.capture = {u32(q.capture_index), u32(q.capture_index >> 32),
               u32(adc_bits - picture_bits(options.format, adc_bits)), u32((bits + 31) / 32)};
  u.exposure = {f(q.exposure_s), f(c.system_gain_dn_per_e() * q.gain), f(c.noise.black_level_dn),
                f(std::ldexp(1.0, adc_bits) - 1.0)};
  u.noise = {f(c.noise.read_noise_e), f(c.noise.full_well_e),
             f(c.noise.dark_current_at_temperature_e_per_s()), f(c.noise.response_c2)};
  u.picture = {f(picture.focal_x_px), f(picture.focal_y_px), f(picture.centre_u_px), f(picture.centre_v_px)};
  u.tap = {f(options.supersampling / taps), f(taps), f(1.0 / (taps * taps)), f(c.noise.response_c3)};
  u.picture_limit = {f(picture.width_px - 1.001), f(picture.height_px - 1.001), 0.0f, 0.0f};
  std::memcpy(sensor.data, &u, sizeof u);
}

void Renderer::Impl::draw_surface(const SurfaceDraw& d) {
  const VkCommandBuffer commands = pipelines.commands;
  const bool ground = d.mesh == Mesh::ground;
  const std::size_t variant = caster_variant(d.casters, d.cylinders);
  const vk::Pipeline& pipeline = ground      ? pipelines.ground[variant]
                                 : d.pattern ? pipelines.board[variant]
                                             : pipelines.body[variant];
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipeline.get());
  const auto offset = static_cast<std::uint32_t>(d.data * surface_stride);
  vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipelines.layout.get(), 0, 1,
                          &pipelines.set, 1, &offset);
  const VkBuffer vertices = ground ? ground_vertices.handle.get() : mesh_vertices.handle.get();
  const VkDeviceSize zero = 0;
  vkCmdBindVertexBuffers(commands, 0, 1, &vertices, &zero);
  if (ground)
    vkCmdDraw(commands, d.vertex_count, 1, d.first_vertex, 0);
  else if (d.mesh == Mesh::box)
    vkCmdDraw(commands, meshes.box_count, 1, meshes.box_first, 0);
  else
    vkCmdDraw(commands, meshes.cylinder_count, 1, meshes.cylinder_first, 0);
}

void Renderer::Impl::draw_nothing_with(const vk::Pipeline& pipeline, bool ground) {
  const VkCommandBuffer commands = pipelines.commands;
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipeline.get());
  vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipelines.layout.get(), 0, 1,
                          &pipelines.set, 1, &kNoOffset);
  const VkBuffer vertices = ground ? ground_vertices.handle.get() : mesh_vertices.handle.get();
  const VkDeviceSize zero = 0;
  vkCmdBindVertexBuffers(commands, 0, 1, &vertices, &zero);
  vkCmdDraw(commands, 3, 1, 0, 0);
}

void Renderer::Impl::record_raster() {
  const VkCommandBuffer commands = pipelines.commands;
  // What the last picture left is discarded; its readers were waited for by the host.
  std::array<VkImageMemoryBarrier2, 2> start{
      image_barrier(colour.handle.get(), VK_IMAGE_ASPECT_COLOR_BIT, VK_IMAGE_LAYOUT_UNDEFINED,
                    VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL),
      image_barrier(depth.handle.get(), VK_IMAGE_ASPECT_DEPTH_BIT, VK_IMAGE_LAYOUT_UNDEFINED,
                    VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL)};
  start[0].dstStageMask = VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT;
  start[0].dstAccessMask = VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT;
  start[1].dstStageMask =
      VK_PIPELINE_STAGE_2_EARLY_FRAGMENT_TESTS_BIT | VK_PIPELINE_STAGE_2_LATE_FRAGMENT_TESTS_BIT;
  start[1].dstAccessMask =
      VK_ACCESS_2_DEPTH_STENCIL_ATTACHMENT_READ_BIT | VK_ACCESS_2_DEPTH_STENCIL_ATTACHMENT_WRITE_BIT;
  barrier(commands, start);

  VkRenderingAttachmentInfo colour_info{};
  colour_info.sType = VK_STRUCTURE_TYPE_RENDERING_ATTACHMENT_INFO;
  colour_info.imageView = colour.view.get();
  colour_info.imageLayout = VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL;
  // The sky covers what nothing else does; only within a body the cleared black stays.
  colour_info.loadOp = geometry->in_the_dark ? VK_ATTACHMENT_LOAD_OP_CLEAR : VK_ATTACHMENT_LOAD_OP_DONT_CARE;
  colour_info.storeOp = VK_ATTACHMENT_STORE_OP_STORE;
  VkRenderingAttachmentInfo depth_info = colour_info;
  depth_info.imageView = depth.view.get();
  depth_info.imageLayout = VK_IMAGE_LAYOUT_DEPTH_ATTACHMENT_OPTIMAL;
  depth_info.loadOp = VK_ATTACHMENT_LOAD_OP_CLEAR;  // to 0: infinitely far
  depth_info.storeOp = VK_ATTACHMENT_STORE_OP_DONT_CARE;
  VkRenderingInfo rendering{};
  rendering.sType = VK_STRUCTURE_TYPE_RENDERING_INFO;
  rendering.renderArea = scissor;
  rendering.layerCount = 1;
  rendering.colorAttachmentCount = 1;
  rendering.pColorAttachments = &colour_info;
  rendering.pDepthAttachment = &depth_info;
  vkCmdBeginRendering(commands, &rendering);
  if (!geometry->in_the_dark) {
    const VkViewport viewport{
        0.0f, 0.0f, static_cast<float>(picture.width_px), static_cast<float>(picture.height_px), 0.0f, 1.0f};
    vkCmdSetViewport(commands, 0, 1, &viewport);
    vkCmdSetScissor(commands, 0, 1, &scissor);
    for (const SurfaceDraw& d : geometry->draws) draw_surface(d);
    if (warm_up)
      for (const auto* variants : {&pipelines.body, &pipelines.board, &pipelines.ground})
        for (const vk::Pipeline& pipeline : *variants)
          if (pipeline) draw_nothing_with(pipeline, variants == &pipelines.ground);
    vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipelines.layout.get(), 0, 1,
                            &pipelines.set, 1, &kNoOffset);
    vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_GRAPHICS, pipelines.sky.get());
    vkCmdDraw(commands, 3, 1, 0, 0);
  }
  vkCmdEndRendering(commands);
}

void Renderer::Impl::record_sensor(const Region& region) {
  const VkCommandBuffer commands = pipelines.commands;
  // The sensor reads what the raster pass wrote.
  VkImageMemoryBarrier2 read =
      image_barrier(colour.handle.get(), VK_IMAGE_ASPECT_COLOR_BIT, VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL,
                    VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL);
  read.srcStageMask = VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT;
  read.srcAccessMask = VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT;
  read.dstStageMask = VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT;
  read.dstAccessMask = VK_ACCESS_2_SHADER_READ_BIT;
  barrier(commands, read);
  vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipelines.sensor.get());
  vkCmdBindDescriptorSets(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipelines.layout.get(), 0, 1,
                          &pipelines.set, 1, &kNoOffset);
  const std::size_t pixels = static_cast<std::size_t>(region.width_px) * region.height_px;
  const std::size_t per_invocation = options.format == PixelFormat::mono12p ? 8 : 4;
  dispatch(commands, (pixels + per_invocation - 1) / per_invocation);
  // The host copies what the sensor wrote.
  memory_barrier(commands, VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT, VK_ACCESS_2_SHADER_WRITE_BIT,
                 VK_PIPELINE_STAGE_2_HOST_BIT, VK_ACCESS_2_HOST_READ_BIT);
}

Renderer::Renderer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Renderer::~Renderer() = default;

Result<std::unique_ptr<Renderer>> Renderer::create(std::shared_ptr<Device> device,
                                                   std::shared_ptr<const world::Scene> scene,
                                                   const RendererOptions& options) {
  if (auto s = options.camera.validate(); !s) return tl::unexpected(s.error());
  if (options.camera.projection != Projection::opencv)
    return fail(ErrorCode::bad_input, "camera model",
                "projection: expected opencv: one pinhole picture holds no fisheye");
  if (!(options.supersampling >= 1.0 && options.supersampling <= 4.0))
    return fail(ErrorCode::bad_input, "supersampling",
                "expected a factor in [1, 4], got " + std::to_string(options.supersampling));
  auto impl = std::make_unique<Impl>();
  impl->device = std::move(device);
  impl->scene = std::move(scene);
  impl->options = options;
  if (auto s = check_limits(*impl->scene, options.camera, impl->gpu().limits.maxStorageBufferRange); !s)
    return tl::unexpected(s.error());
  const CameraModel& c = options.camera;
  const bool mono = is_mono(options.format);
  ChannelResponse response{};
  if (mono)
    response[0] = c.electron_rate_per_radiance(c.optics.mono_efficiency);
  else
    for (std::size_t i = 0; i < 3; ++i)
      response[i] = c.electron_rate_per_radiance(c.optics.colour_efficiency[i]);
  impl->geometry.emplace(*impl->scene, response);
  impl->meshes = make_unit_meshes();

  PipelineOptions wanted;
  wanted.mono = mono;
  wanted.highlights = impl->geometry->bodies_have_highlights();
  wanted.ground_highlights = impl->geometry->ground_has_highlights();
  wanted.ground_noise = impl->scene->ground && impl->scene->ground->noise_contrast > 0.0;
  wanted.boards = std::any_of(impl->scene->bodies.begin(), impl->scene->bodies.end(),
                              [](const world::Body& b) { return b.chessboard.has_value(); });
  wanted.bodies = static_cast<std::uint32_t>(impl->scene->bodies.size());
  wanted.cylinders = static_cast<std::uint32_t>(
      std::count_if(impl->scene->bodies.begin(), impl->scene->bodies.end(),
                    [](const world::Body& b) { return b.shape == world::Shape::cylinder; }));
  wanted.format = layout_of(options.format);
  wanted.shot_noise = options.noise && c.noise.shot_noise;
  wanted.read_noise = options.noise && c.noise.read_noise_e > 0.0;
  wanted.taps = static_cast<int>(std::ceil(options.supersampling));
  auto pipelines = make_pipelines(impl->gpu(), wanted);
  if (!pipelines) return tl::unexpected(pipelines.error());
  impl->pipelines = std::move(*pipelines);
  if (auto s = impl->make_buffers(); !s) return tl::unexpected(s.error());
  if (auto s = impl->make_lens_map(); !s) return tl::unexpected(s.error());
  if (auto s = impl->choose_picture(); !s) return tl::unexpected(s.error());
  if (auto s = impl->make_images(); !s) return tl::unexpected(s.error());

  auto renderer = std::unique_ptr<Renderer>(new Renderer(std::move(impl)));
  // Software drivers compile a shader when it is first drawn with.
  PictureRequest first;
  first.region = {0, 0, c.width_px, c.height_px};
  std::vector<std::byte> pixels(image_bytes(options.format, static_cast<std::size_t>(c.width_px),
                                            static_cast<std::size_t>(c.height_px)));
  renderer->impl_->warm_up = true;
  if (auto s = renderer->draw(first, world::WorldSnapshot(*renderer->impl_->scene), pixels); !s)
    return tl::unexpected(s.error());
  renderer->impl_->warm_up = false;
  return renderer;
}

Status Renderer::draw(const PictureRequest& request, const world::WorldSnapshot& snapshot,
                      std::span<std::byte> pixels_out, StageTimes* times) {
  Impl& m = *impl_;
  if (auto s = m.check(request, snapshot); !s) return s;
  const std::size_t bytes = image_bytes(m.options.format, static_cast<std::size_t>(request.region.width_px),
                                        static_cast<std::size_t>(request.region.height_px));
  if (pixels_out.size() != bytes)
    return fail(ErrorCode::bad_input, "pixels_out",
                "expected " + std::to_string(bytes) + " bytes, got " + std::to_string(pixels_out.size()));
  auto t0 = Clock::now();
  const auto lap = [&](double StageTimes::*stage) {
    if (times != nullptr) times->*stage = ms_since(t0);
    t0 = Clock::now();
  };
  m.prepare(request, snapshot);
  lap(&StageTimes::geometry_ms);
  if (auto s = m.begin(); !s) return s;
  m.record_raster();
  if (times != nullptr) {
    if (auto s = m.submit(); !s) return s;
    lap(&StageTimes::raster_ms);
    if (auto s = m.begin(); !s) return s;
  }
  m.record_sensor(request.region);
  if (auto s = m.submit(); !s) return s;
  lap(&StageTimes::sensor_ms);
  std::memcpy(pixels_out.data(), m.output.data, bytes);
  lap(&StageTimes::copy_ms);
  return {};
}

Result<LinearPicture> Renderer::draw_linear(const PictureRequest& request,
                                            const world::WorldSnapshot& snapshot) {
  Impl& m = *impl_;
  if (auto s = m.check(request, snapshot); !s) return tl::unexpected(s.error());
  LinearPicture out;
  out.width_px = m.picture.width_px;
  out.height_px = m.picture.height_px;
  out.channels = is_mono(m.options.format) ? 1 : 4;
  out.focal_x_px = m.picture.focal_x_px;
  out.focal_y_px = m.picture.focal_y_px;
  out.centre_u_px = m.picture.centre_u_px;
  out.centre_v_px = m.picture.centre_v_px;
  out.electrons_per_second.resize(static_cast<std::size_t>(out.width_px) * out.height_px * out.channels);
  const std::size_t bytes = out.electrons_per_second.size() * sizeof(float);
  auto staging = m.gpu().make_buffer(bytes, VK_BUFFER_USAGE_TRANSFER_DST_BIT);
  if (!staging) return tl::unexpected(staging.error());
  m.prepare(request, snapshot);
  m.scissor = {{0, 0}, {static_cast<std::uint32_t>(out.width_px), static_cast<std::uint32_t>(out.height_px)}};
  m.bounds_of.reset();
  if (auto s = m.begin(); !s) return tl::unexpected(s.error());
  m.record_raster();
  VkImageMemoryBarrier2 read =
      image_barrier(m.colour.handle.get(), VK_IMAGE_ASPECT_COLOR_BIT,
                    VK_IMAGE_LAYOUT_COLOR_ATTACHMENT_OPTIMAL, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL);
  read.srcStageMask = VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT;
  read.srcAccessMask = VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT;
  read.dstStageMask = VK_PIPELINE_STAGE_2_COPY_BIT;
  read.dstAccessMask = VK_ACCESS_2_TRANSFER_READ_BIT;
  barrier(m.pipelines.commands, read);
  VkBufferImageCopy copy{};
  copy.imageSubresource = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
  copy.imageExtent = {static_cast<std::uint32_t>(out.width_px), static_cast<std::uint32_t>(out.height_px), 1};
  vkCmdCopyImageToBuffer(m.pipelines.commands, m.colour.handle.get(), VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL,
                         staging->handle.get(), 1, &copy);
  memory_barrier(m.pipelines.commands, VK_PIPELINE_STAGE_2_COPY_BIT, VK_ACCESS_2_TRANSFER_WRITE_BIT,
                 VK_PIPELINE_STAGE_2_HOST_BIT, VK_ACCESS_2_HOST_READ_BIT);
  if (auto s = m.submit(); !s) return tl::unexpected(s.error());
  std::memcpy(out.electrons_per_second.data(), staging->data, bytes);
  return out;
}

std::vector<std::array<float, 4>> Renderer::lens_map() const {
  std::vector<std::array<float, 4>> out(static_cast<std::size_t>(impl_->options.camera.width_px) *
                                        impl_->options.camera.height_px);
  std::memcpy(out.data(), impl_->map.data, out.size() * sizeof out[0]);
  return out;
}

}  // namespace rigor::render
