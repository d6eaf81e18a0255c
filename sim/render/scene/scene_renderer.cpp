#include "sim/render/scene/scene_renderer.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <optional>
#include <string>

#include "sim/render/scene/lens_sampler.h"
#include "sim/render/scene/scene_frame.h"
#include "sim/render/scene/scene_picture.h"

namespace rigor::render {
namespace {

/// Each body may throw its shadow on each.
constexpr std::size_t kMostBodies = 4096;

template <class F>
void for_rows(int first, int end, const F& body) {
  constexpr int kRowsPerTask = 16;
  tbb::parallel_for(tbb::blocked_range<int>(first, end, kRowsPerTask), [&](const tbb::blocked_range<int>& r) {
    for (int y = r.begin(); y < r.end(); ++y) body(y);
  });
}

}  // namespace

struct SceneRenderer::Impl {
  std::shared_ptr<const world::Scene> scene;
  SceneRendererOptions options;
  LensSampler lens;
  std::optional<SceneFrame> frame;
  int channels = 1;
  std::array<std::vector<float>, 3> picture;
  Region area_of;  ///< the last region and what of the picture it sees
  PictureArea area;

  [[nodiscard]] Status check(const PictureRequest& request, const world::WorldSnapshot& snapshot) const;
  void draw_picture(const PictureRequest& request, const world::WorldSnapshot& snapshot,
                    const PictureArea& what);
};

Status SceneRenderer::Impl::check(const PictureRequest& q, const world::WorldSnapshot& snapshot) const {
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
  if (snapshot.joints.size() != scene->nodes.size())
    return fail(ErrorCode::bad_input, "world",
                "expected a snapshot of this scene with " + std::to_string(scene->nodes.size()) +
                    " nodes, got one with " + std::to_string(snapshot.joints.size()));
  if (!q.T_world_sensor.matrix().allFinite())
    return fail(ErrorCode::bad_input, "T_world_sensor",
                "expected a pose of finite numbers, got one with NaN or infinity");
  return {};
}

void SceneRenderer::Impl::draw_picture(const PictureRequest& q, const world::WorldSnapshot& snapshot,
                                       const PictureArea& what) {
  const PictureGeometry& p = lens.picture();
  frame->build(p, q.T_world_sensor, snapshot, q.t_capture);
  for_rows(what.y0, what.y1, [&](int y) {
    std::array<float*, 3> row{};
    for (std::size_t c = 0; c < static_cast<std::size_t>(channels); ++c)
      row[c] = picture[c].data() + static_cast<std::size_t>(y) * static_cast<std::size_t>(p.width_px) +
               static_cast<std::size_t>(what.x0);
    draw_scene_row(*frame, y, what, channels, row);
  });
}

SceneRenderer::SceneRenderer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
SceneRenderer::~SceneRenderer() = default;

Result<std::unique_ptr<SceneRenderer>> SceneRenderer::create(std::shared_ptr<const world::Scene> scene,
                                                             const SceneRendererOptions& options) {
  const CameraModel& c = options.camera;
  if (auto s = c.validate(); !s) return tl::unexpected(s.error());
  if (c.projection != Projection::opencv)
    return fail(
        ErrorCode::bad_input, "camera model",
        "projection: expected opencv, because one pinhole picture holds no fisheye; got kannala_brandt");
  if (!(options.supersampling >= 1.0 && options.supersampling <= 4.0))
    return fail(ErrorCode::bad_input, "supersampling",
                "expected a factor in [1, 4], got " + std::to_string(options.supersampling));
  if (scene->bodies.size() > kMostBodies)
    return fail(ErrorCode::bad_input, "world",
                "bodies: expected at most " + std::to_string(kMostBodies) +
                    ", which the renderer scene draws, got " + std::to_string(scene->bodies.size()) +
                    "; give the channel `renderer: rays`");
  auto impl = std::make_unique<Impl>();
  auto lens = LensSampler::create(c, options.supersampling);
  if (!lens) return tl::unexpected(lens.error());
  impl->lens = std::move(*lens);
  impl->scene = std::move(scene);
  impl->options = options;
  ChannelResponse response{};
  if (options.colours == SceneColours::mono) {
    response[0] = c.electron_rate_per_radiance(c.optics.mono_efficiency);
  } else {
    impl->channels = 3;
    for (std::size_t i = 0; i < 3; ++i)
      response[i] = c.electron_rate_per_radiance(c.optics.colour_efficiency[i]);
  }
  impl->frame.emplace(*impl->scene, response);
  const PictureGeometry& p = impl->lens.picture();
  for (std::size_t k = 0; k < static_cast<std::size_t>(impl->channels); ++k)
    impl->picture[k].resize(static_cast<std::size_t>(p.width_px) *
                            static_cast<std::size_t>(p.height_px + LensSampler::kDarkRows));
  return std::unique_ptr<SceneRenderer>(new SceneRenderer(std::move(impl)));
}

std::size_t SceneRenderer::planes() const { return impl_->options.colours == SceneColours::rgb ? 3 : 1; }

Status SceneRenderer::draw(const PictureRequest& q, const world::WorldSnapshot& snapshot,
                           std::span<float> electrons_per_second) {
  Impl& m = *impl_;
  if (auto s = m.check(q, snapshot); !s) return s;
  const Region& r = q.region;
  const auto width = static_cast<std::size_t>(r.width_px), height = static_cast<std::size_t>(r.height_px);
  if (electrons_per_second.size() != planes() * width * height)
    return fail(ErrorCode::bad_input, "electrons_per_second",
                "expected " + std::to_string(planes() * width * height) + " numbers, got " +
                    std::to_string(electrons_per_second.size()));
  if (!(m.area_of == r)) {
    m.area = m.lens.seen_by(r.offset_x_px, r.offset_y_px, r.width_px, r.height_px);
    m.area_of = r;
  }
  m.draw_picture(q, snapshot, m.area);
  for_rows(0, r.height_px, [&](int y) {
    const int sensor_y = r.offset_y_px + y;
    for (std::size_t plane = 0; plane < planes(); ++plane) {
      std::size_t even = plane, odd = plane;
      if (m.options.colours == SceneColours::mosaic) {
        even = static_cast<std::size_t>(sensor_y % 2);
        odd = even + 1;
      }
      m.lens.sample(r.offset_x_px, sensor_y, r.width_px, m.picture[even].data(), m.picture[odd].data(),
                    electrons_per_second.data() + (plane * height + static_cast<std::size_t>(y)) * width);
    }
  });
  return {};
}

Result<LinearPicture> SceneRenderer::draw_linear(const PictureRequest& q,
                                                 const world::WorldSnapshot& snapshot) {
  Impl& m = *impl_;
  if (auto s = m.check(q, snapshot); !s) return tl::unexpected(s.error());
  const PictureGeometry& p = m.lens.picture();
  m.draw_picture(q, snapshot, {0, 0, p.width_px, p.height_px});
  LinearPicture out{p.width_px,   p.height_px,   m.picture[0], p.focal_x_px,
                    p.focal_y_px, p.centre_u_px, p.centre_v_px};
  out.electrons_per_second.resize(static_cast<std::size_t>(p.width_px) *
                                  static_cast<std::size_t>(p.height_px));
  return out;
}

std::vector<std::array<float, 2>> SceneRenderer::rays() const { return impl_->lens.rays(); }

}  // namespace rigor::render
