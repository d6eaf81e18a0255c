#include "sim/render/view/raster_engine.h"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "rt-core/stage_time.h"
#include "sim/render/view/draw_context.h"
#include "sim/render/view/range_sampler.h"
#include "sim/render/view/view_frame.h"

namespace rigor::render {
namespace {

using Clock = std::chrono::steady_clock;
/// Of a range view: three pictures of it take 400 megabytes.
constexpr int kLargestSide_px = 2048;
/// A direction may be off unit length by this much, squared: twice 1 %.
constexpr float kUnit = 0.02F;

bool can_be_cast(const Ray& r) {
  const float* const d = r.direction;
  const float length2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
  return std::isfinite(r.origin[0] + r.origin[1] + r.origin[2]) && std::abs(length2 - 1.0F) <= kUnit &&
         std::isfinite(r.time) && r.far_m > 0;
}

/// Two halves, as packHalf2x16 writes them.
std::array<float, 2> halves(std::uint32_t bits) {
  std::array<float, 2> out{};
  for (std::size_t i = 0; i < 2; ++i) {
    const std::uint32_t h = bits >> (16 * i) & 0xFFFFU;
    const auto mantissa = static_cast<float>(h & 0x3FFU);
    const int exponent = static_cast<int>(h >> 10 & 0x1FU);
    const float v = exponent == 0 ? std::ldexp(mantissa, -24) : std::ldexp(1024 + mantissa, exponent - 25);
    out[i] = (h & 0x8000U) != 0 ? -v : v;
  }
  return out;
}

}  // namespace

struct RasterEngine::Impl : DrawContext {
  Impl(std::shared_ptr<Device> d, const RasterOptions& o)
      : DrawContext(std::move(d)), options(o), targets(gpu()), sampler(gpu(), pipelines) {}

  /// A frame of the window that is drawn, and what of it is resident.
  struct Instant {
    const ContentFrame* frame = nullptr;
    float time = 0;
    std::vector<const ResidentBatch*> batches;
  };

  Status prepare(std::shared_ptr<const ContentWindow> next);
  Status cast(const RayQuery& query, std::span<Hit> hits);

  RasterOptions options;
  EngineStatistics statistics;
  std::shared_ptr<const ContentWindow> window;

 private:
  Status draw(const RayQuery& query, const Instant& instant, const RayFace& face, std::span<Hit> hits);

  RangeTargets targets;
  RangeSampler sampler;
  std::vector<Instant> instants;
};

Status RasterEngine::Impl::prepare(std::shared_ptr<const ContentWindow> next) {
  if (!next || next->frames.empty() ||
      std::any_of(next->frames.begin(), next->frames.end(), [](const auto& f) { return f == nullptr; }))
    return fail(ErrorCode::bad_input, "window", "expected at least one frame, and none that is null");
  const auto begun = Clock::now();
  const std::size_t meshes_before = content->meshes();
  ++frame_number;
  instants.clear();
  const auto count = static_cast<std::ptrdiff_t>(next->frames.size());
  const std::ptrdiff_t drawn = std::clamp<std::ptrdiff_t>(options.instants, 1, count);
  for (std::ptrdiff_t k = 0; k < drawn; ++k) {
    const std::ptrdiff_t i =
        drawn == 1 ? (count - 1) / 2 : (k * (count - 1) * 2 + drawn - 1) / (2 * (drawn - 1));
    instants.push_back({next->frames[static_cast<std::size_t>(i)].get(),
                        count > 1 ? static_cast<float>(i) / static_cast<float>(count - 1) : 0.0F,
                        {}});
  }
  EngineStatistics s;
  for (Instant& instant : instants) {
    ViewStatistics taken;
    if (auto ok = take_over(*instant.frame, instant.batches, taken); !ok) {
      instants.clear();
      window.reset();
      return ok;
    }
  }
  std::vector<const ResidentPrototype*> prototypes;
  for (const ResidentBatch* b : instants.front().batches) {
    s.instances += b->spheres.size();
    prototypes.push_back(b->prototype);
    if (!b->prototype->levels.empty() && b->prototype->levels.front() != nullptr)
      s.triangles += b->spheres.size() * b->prototype->levels.front()->triangles;
  }
  std::sort(prototypes.begin(), prototypes.end());
  s.prototypes = static_cast<std::size_t>(
      std::distance(prototypes.begin(), std::unique(prototypes.begin(), prototypes.end())));
  s.rebuilt = content->meshes() - meshes_before;
  window = std::move(next);
  drop_unseen();
  s.prepare_ms = ms_since(begun);
  s.cast_ms = statistics.cast_ms;
  statistics = s;
  return {};
}

Status RasterEngine::Impl::cast(const RayQuery& query, std::span<Hit> hits) {
  const auto bad = [](const char* where, const std::string& message) {
    return fail(ErrorCode::bad_input, where, message);
  };
  if (hits.size() != query.rays.size())
    return bad("hits", "expected " + std::to_string(query.rays.size()) + ", one for each ray, got " +
                           std::to_string(hits.size()));
  if (query.band < 0 || query.band >= static_cast<int>(kBandCount))
    return bad("band",
               "expected 0 to " + std::to_string(kBandCount - 1) + ", got " + std::to_string(query.band));
  if (!query.origin.allFinite()) return bad("origin", "expected finite coordinates");
  if (!(query.near_m >= 0) || !std::isfinite(query.near_m))
    return bad("near_m", "expected a length, got " + std::to_string(query.near_m));
  if (instants.empty()) return bad("window", "expected content to have been prepared");
  const auto begun = Clock::now();
  std::fill(hits.begin(), hits.end(), Hit{});
  std::vector<std::vector<std::uint32_t>> of_instant(instants.size());
  for (std::size_t i = 0; i < query.rays.size(); ++i) {
    const Ray& r = query.rays[i];
    if (!can_be_cast(r)) continue;
    std::size_t nearest = 0;
    for (std::size_t k = 1; k < instants.size(); ++k)
      if (std::abs(instants[k].time - r.time) < std::abs(instants[nearest].time - r.time)) nearest = k;
    of_instant[nearest].push_back(static_cast<std::uint32_t>(i));
  }
  const int side = std::min(kLargestSide_px, static_cast<int>(gpu().limits.maxImageDimension2D));
  for (std::size_t k = 0; k < instants.size(); ++k) {
    if (instants[k].batches.empty()) continue;
    for (const RayFace& face :
         faces_for(query.rays, of_instant[k],
                   {options.pixels_per_rad, std::max(static_cast<double>(query.near_m), 1e-5), side}))
      if (auto s = draw(query, instants[k], face, hits); !s) return s;
  }
  statistics.cast_ms = ms_since(begun);
  return {};
}

Status RasterEngine::Impl::draw(const RayQuery& query, const Instant& instant, const RayFace& face,
                                std::span<Hit> hits) {
  const ContentFrame& frame = *instant.frame;
  ViewRequest request;
  request.T_world_camera.linear() = face.R_world_face;
  request.T_world_camera.translation() = query.origin;
  request.pinhole = face.pinhole;
  request.t =
      window->begin +
      Duration(static_cast<std::int64_t>(std::llround(
          static_cast<double>(instant.time) * static_cast<double>((window->end - window->begin).ns()))));
  request.bands = {query.band, query.band, query.band, query.band};
  textures->set_bands(request.bands);
  const ViewCamera camera(request);
  const FrameNumbers numbers = place_numbers(frame, request, camera);
  CullOptions cull_options;
  cull_options.impostors = false;
  cull_options.allowed_error_px = options.allowed_error_rad * camera.focal_px;
  cull_options.sway_factor = 1.5 * numbers.sway_factor;
  std::vector<Bucket> buckets = cull(camera, instant.batches, cull_options);
  if (buckets.empty()) return {};
  sort_by_distance(buckets);
  FrameFeatures features;
  features.snow = frame.surface.snow_depth_m > 0;
  features.wet = frame.surface.wetness > 0;
  features.sway = numbers.sway_factor > 0;
  if (features.wet) features.all |= kFeatureWet;
  std::size_t count = 0;
  for (const Bucket& b : buckets) count += b.instances.size();

  const std::size_t n = face.rays.size();
  if (auto ok = targets.prepare(face.pinhole.width_px, face.pinhole.height_px); !ok) return ok;
  if (auto ok = sampler.prepare(n); !ok) return ok;
  const auto rays = sampler.rays(n);
  for (std::size_t i = 0; i < n; ++i) {
    const Ray& r = query.rays[face.rays[i]];
    rays[i].direction = {r.direction[0], r.direction[1], r.direction[2], r.far_m};
    rays[i].at = {face.at_px[i][0], face.at_px[i][1], 0, 0};
  }
  if (auto ok = lists.begin(count); !ok) return ok;
  resources.write(numbers.uniforms);
  if (auto ok = begin(); !ok) return ok;
  uploads.record(commands);
  resources.record_begin(commands);
  auto calls = lists.add_ranges(buckets, camera.eye, features);
  if (!calls) return tl::unexpected(calls.error());
  if (auto ok = lists.record_gather(commands, *content); !ok) return ok;
  targets.begin(commands, face.pinhole.width_px, face.pinhole.height_px);
  bind_frame();
  lists.record(commands, *calls, true);
  targets.end(commands);
  if (auto ok = sampler.record(commands, targets, face, static_cast<double>(query.near_m), n); !ok) return ok;
  if (auto ok = submit(); !ok) return ok;

  const auto found = sampler.hits(n);
  for (std::size_t i = 0; i < n; ++i) {
    const view_gpu::HitData& f = found[i];
    if (f.what.x == 0) continue;
    const Ray& r = query.rays[face.rays[i]];
    Hit& h = hits[face.rays[i]];
    h.range_m = f.normal.w;
    h.normal[0] = f.normal.x;
    h.normal[1] = f.normal.y;
    h.normal[2] = f.normal.z;
    h.cos_incidence =
        std::clamp(-(f.normal.x * r.direction[0] + f.normal.y * r.direction[1] + f.normal.z * r.direction[2]),
                   0.0F, 1.0F);
    const auto [transmittance, metallic] = halves(f.what.z);
    h.reflectance = f.rest.x;
    h.transmittance = transmittance;
    h.roughness = f.rest.y;
    h.metallic = metallic;
    h.uv[0] = f.rest.z;
    h.uv[1] = f.rest.w;
    h.node = lists.node(f.what.x);
    h.surface = lists.surface(f.what.y);
    if (h.surface != nullptr) {
      h.retro_reflection = h.surface->retro_reflection;
      h.water = h.surface->water;
    }
  }
  return {};
}

RasterEngine::RasterEngine() = default;
RasterEngine::~RasterEngine() = default;

Result<std::shared_ptr<RasterEngine>> RasterEngine::create(std::shared_ptr<Device> device,
                                                           const RasterOptions& options) {
  if (!device) return fail(ErrorCode::unavailable, "vulkan", "expected a device, got none");
  std::shared_ptr<RasterEngine> engine(new RasterEngine());
  engine->impl_ = std::make_unique<Impl>(std::move(device), options);
  if (auto s = engine->impl_->create(); !s) return tl::unexpected(s.error());
  return engine;
}

void RasterEngine::set_options(const RasterOptions& options) { impl_->options = options; }
Status RasterEngine::prepare(std::shared_ptr<const ContentWindow> window) {
  return impl_->prepare(std::move(window));
}
Status RasterEngine::cast(const RayQuery& query, std::span<Hit> hits) { return impl_->cast(query, hits); }
EngineStatistics RasterEngine::statistics() const { return impl_->statistics; }

}  // namespace rigor::render
