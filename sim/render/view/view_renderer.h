// The headless Vulkan engine: radiance pictures of a world's content (sim/render/content/), in linear light
// and physical units, with depth and identity. Relative to the camera in float, reversed infinite depth, sun
// with shadow maps, sky light, haze, precipitation, wet and snowy surfaces.
//
// Only passes that the frame asks for are run, and only shaders that it needs are compiled. The same frame,
// request and switches give the same picture, whatever was drawn before (same binary, driver and CPU type).
//
// A ViewRenderer belongs to one thread at a time.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sim/render/content/provider.h"
#include "sim/render/device.h"

namespace rigor::render {

/// A pinhole, pixel centres at integers: u = fx·x/z + cx in the optical frame (x right, y down, z forward).
struct Pinhole {
  int width_px = 640, height_px = 480;
  double fx_px = 500, fy_px = 500, cx_px = 319.5, cy_px = 239.5;
  double near_m = 0.05;
};

/// What makes drawing cheap. All off: everything is drawn in full, the reference that errors are measured
/// against.
struct ViewSwitches {
  bool frustum_culling = true, occlusion_culling = true, levels_of_detail = true, impostors = true,
       instancing = true;
  bool shadows = true;
  bool sky_cover = true;  ///< with shadows: guess what hides the sky
};

struct ViewRequest {
  Eigen::Isometry3d T_world_camera = Eigen::Isometry3d::Identity();
  Pinhole pinhole{};
  BenchTime t{};
  /// Which bands the picture's four channels hold (index of world::kBandWavelength_nm): red, green, blue, 850
  /// nm.
  std::array<int, 4> bands{0, 1, 2, 3};
  double allowed_error_px = 1.0;
  int samples = 4;  ///< per pixel: 1 or 4
  ViewSwitches switches{};
  bool normals = false;  ///< ViewPicture::normals is wanted; costs nothing where it is not
  /// Told on the calling thread how much of the triangles is drawn, 0 to 1. The picture is the same, in more
  /// submissions to the device.
  std::function<void(double share)> progress{};
};

/// With 4 samples radiance is their mean; depth, node and normal are those of one and the same sample, which
/// lies within the pixel but not at its centre. With 1 sample all are those of the pixel's centre.
struct ViewPicture {
  int width_px = 0, height_px = 0;
  std::vector<float> radiance;       ///< 4 per pixel, W/(m² sr)
  std::vector<float> depth_m;        ///< along the optical axis, infinity: nothing there
  std::vector<std::uint64_t> nodes;  ///< NodeId of what is seen; 0: none
  /// 3 per pixel, unit length within 6e-5 rad: that with which it was shaded (normal map applied), optical
  /// frame. 0 0 0 where nothing is. Empty unless asked for.
  std::vector<float> normals;
};

struct ViewStatistics {
  std::size_t batches = 0, instances = 0, instances_drawn = 0, triangles_drawn = 0, draw_calls = 0,
              impostors_drawn = 0;
  std::size_t instances_skipped = 0;  ///< not drawn because a number of theirs is not finite
  std::size_t instances_hidden = 0;   ///< left out because solid things stand in front of them
  double collect_ms = 0, cull_ms = 0, upload_ms = 0, draw_ms = 0;
  std::size_t uploaded_bytes = 0;
};

class ViewRenderer {
 public:
  /// Setup. Errors: unavailable (the device).
  [[nodiscard]] static Result<std::unique_ptr<ViewRenderer>> create(std::shared_ptr<Device> device);
  ~ViewRenderer();
  ViewRenderer(const ViewRenderer&) = delete;
  ViewRenderer& operator=(const ViewRenderer&) = delete;

  /// The query that a provider should be asked for this picture.
  [[nodiscard]] static ContentQuery query_for(const ViewRequest& request);
  /// Blocks. Errors: bad_input (sizes, a pose or pinhole that is not finite), unavailable (the device).
  [[nodiscard]] Status draw(const ContentFrame& frame, const ViewRequest& request, ViewPicture& out,
                            ViewStatistics* statistics = nullptr);
  /// Names of the pipelines that have been built so far.
  [[nodiscard]] std::vector<std::string> pipelines() const;

  struct Impl;

 private:
  explicit ViewRenderer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::render
