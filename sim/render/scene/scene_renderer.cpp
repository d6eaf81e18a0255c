#include "sim/render/scene/scene_renderer.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <optional>
#include <string>

#include "sensor-hal/models/wide.h"
#include "sim/render/scene/lens_rays.h"
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

/// Most pixels are not at an edge: so many at a time are passed over.
constexpr int kSkip = 16;
inline bool any_edge(const std::int32_t* marks) {
  std::int32_t any = 0;
  for (int k = 0; k < kSkip; ++k) any |= marks[k];
  return any != 0;
}

/// Whether a pixel has a neighbour that met something else: those beside it are at -1 and +1 of `here`.
RIGOR_WIDE void mark_edges(const std::int32_t* here, const std::int32_t* above, const std::int32_t* below,
                           int count, std::int32_t* __restrict edge) {
  for (int x = 0; x < count; ++x)
    edge[x] = (here[x] ^ here[x - 1]) | (here[x] ^ here[x + 1]) | (here[x] ^ above[x]) | (here[x] ^ below[x]);
}

}  // namespace

struct SceneRenderer::Impl {
  std::shared_ptr<const world::Scene> scene;
  SceneRendererOptions options;
  LensRays lens;
  Eigen::AlignedBox2f field;  ///< of all rays
  std::optional<SceneFrame> frame;
  std::size_t channels = 1;
  std::array<std::vector<float>, 3> light;  ///< of each pixel of the sensor
  /// What each pixel's ray met, as draw_row has it; the outermost columns stand twice.
  std::vector<std::int32_t> met;

  [[nodiscard]] Status check(const PictureRequest& request, const world::WorldSnapshot& snapshot) const;
  [[nodiscard]] std::size_t at(int x, int y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(options.camera.width_px) +
           static_cast<std::size_t>(x);
  }
  [[nodiscard]] std::int32_t* met_at(int x, int y) {
    return met.data() + (static_cast<std::ptrdiff_t>(y) * (options.camera.width_px + 2) + x + 1);
  }
  void draw_row(int y, int x0, int x1);
  void average_edges(int y, int x0, int x1);
};

/// One ray for each pixel.
void SceneRenderer::Impl::draw_row(int y, int x0, int x1) {
  std::array<float*, 3> out{};
  for (std::size_t c = 0; c < channels; ++c) out[c] = light[c].data() + at(x0, y);
  render::draw_row(*frame, lens.row(x0, y, x1 - x0), static_cast<int>(channels), out, met_at(x0, y));
  if (x0 == 0) *met_at(-1, y) = *met_at(0, y);
  if (x1 == options.camera.width_px) *met_at(x1, y) = *met_at(x1 - 1, y);
  if (lens.all_lit()) return;
  for (int x = x0; x < x1; ++x)
    if (!lens.lit(x, y))
      for (std::size_t c = 0; c < channels; ++c) light[c][at(x, y)] = 0;
}

/// Several rays for the pixels beside which something else is met.
void SceneRenderer::Impl::average_edges(int y, int x0, int x1) {
  constexpr int kFine = LensRays::kFine, kPixels = 64;
  constexpr auto kRays = static_cast<std::size_t>(kPixels * kFine);
  thread_local std::vector<std::int32_t> edge;
  thread_local std::vector<int> columns;
  edge.assign(static_cast<std::size_t>((x1 - x0 + kSkip - 1) / kSkip * kSkip), 0);
  const std::int32_t* here = met_at(x0, y);
  mark_edges(here, y > 0 ? met_at(x0, y - 1) : here,
             y + 1 < options.camera.height_px ? met_at(x0, y + 1) : here, x1 - x0, edge.data());
  columns.clear();
  for (int x = x0; x < x1; x += kSkip) {
    const std::int32_t* mark = edge.data() + (x - x0);
    if (!any_edge(mark)) continue;
    for (int k = 0; k < kSkip; ++k)
      if (mark[k] != 0 && lens.lit(x + k, y)) columns.push_back(x + k);
  }
  alignas(32) float u[kRays + kRayPadding], v[kRays + kRayPadding], width_u[kRays + kRayPadding],
      width_v[kRays + kRayPadding], fine[3][kRays];
  for (std::size_t first = 0; first < columns.size(); first += kPixels) {
    const std::span<const int> pixels(columns.data() + first,
                                      std::min<std::size_t>(kPixels, columns.size() - first));
    std::array<Eigen::AlignedBox2f, kRays / kRayTile> tiles;
    std::size_t rays = 0;
    for (const int x : pixels) {
      lens.fine(x, y, u + rays, v + rays, width_u + rays, width_v + rays, tiles[rays / kRayTile]);
      rays += kFine;
    }
    for (float* row : {u, v, width_u, width_v}) std::fill_n(row + rays, kRayPadding, row[rays - 1]);
    draw_rays(*frame, {u, v, width_u, width_v, static_cast<int>(rays), tiles.data()},
              static_cast<int>(channels),
              {fine[0], channels > 1 ? fine[1] : nullptr, channels > 1 ? fine[2] : nullptr});
    for (std::size_t c = 0; c < channels; ++c) {
      const float* ray = fine[c];
      for (const int x : pixels) {
        float sum = 0;
        for (int i = 0; i < kFine; ++i) sum += *ray++;
        light[c][at(x, y)] = sum / kFine;
      }
    }
  }
}

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

SceneRenderer::SceneRenderer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
SceneRenderer::~SceneRenderer() = default;

Result<std::unique_ptr<SceneRenderer>> SceneRenderer::create(std::shared_ptr<const world::Scene> scene,
                                                             const SceneRendererOptions& options) {
  const CameraModel& c = options.camera;
  if (auto s = c.validate(); !s) return tl::unexpected(s.error());
  if (c.projection != Projection::opencv)
    return fail(
        ErrorCode::bad_input, "camera model",
        "projection: expected opencv, because this renderer draws no fisheye; got kannala_brandt; give the "
        "channel `renderer: rays`");
  if (scene->bodies.size() > kMostBodies)
    return fail(ErrorCode::bad_input, "world",
                "bodies: expected at most " + std::to_string(kMostBodies) +
                    ", which the renderer scene draws, got " + std::to_string(scene->bodies.size()) +
                    "; give the channel `renderer: rays`");
  auto impl = std::make_unique<Impl>();
  auto lens = LensRays::create(c);
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
  const auto pixels = static_cast<std::size_t>(c.width_px) * static_cast<std::size_t>(c.height_px);
  for (std::size_t k = 0; k < impl->channels; ++k) impl->light[k].resize(pixels);
  impl->met.resize(pixels + 2 * static_cast<std::size_t>(c.height_px));
  impl->field = impl->lens.field();
  // What the rays of a finer average reach beyond those of the outermost pixels.
  const auto beyond = Eigen::Vector2f(static_cast<float>(2 / c.fx_px), static_cast<float>(2 / c.fy_px));
  impl->field = {impl->field.min() - beyond, impl->field.max() + beyond};
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
  m.frame->build(q.T_world_sensor, m.field, snapshot, q.t_capture);
  // A pixel more on each side, so that the same pixel has the same light whatever the region.
  const int x0 = std::max(0, r.offset_x_px - 1) / kRayTile * kRayTile,
            x1 = std::min(m.options.camera.width_px, r.offset_x_px + r.width_px + 1);
  const int y0 = std::max(0, r.offset_y_px - 1),
            y1 = std::min(m.options.camera.height_px, r.offset_y_px + r.height_px + 1);
  for_rows(y0, y1, [&](int y) { m.draw_row(y, x0, x1); });
  for_rows(r.offset_y_px, r.offset_y_px + r.height_px, [&](int y) {
    m.average_edges(y, r.offset_x_px, r.offset_x_px + r.width_px);
    const std::size_t first = m.at(r.offset_x_px, y);
    for (std::size_t plane = 0; plane < planes(); ++plane) {
      float* to = electrons_per_second.data() +
                  (plane * height + static_cast<std::size_t>(y - r.offset_y_px)) * width;
      if (m.options.colours != SceneColours::mosaic) {
        std::copy_n(m.light[plane].data() + first, width, to);
        continue;
      }
      const auto even = static_cast<std::size_t>(y % 2);
      for (std::size_t i = 0; i < width; ++i)
        to[i] = m.light[even + (static_cast<std::size_t>(r.offset_x_px) + i) % 2][first + i];
    }
  });
  return {};
}

std::vector<std::array<float, 2>> SceneRenderer::rays() const { return impl_->lens.rays(); }

}  // namespace rigor::render
