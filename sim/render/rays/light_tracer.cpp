#include "sim/render/rays/light_tracer.h"

#include <tbb/parallel_for.h>

#include <atomic>
#include <cmath>
#include <list>
#include <numbers>

#include "rt-core/stage_time.h"
#include "sim/render/rays/embree_engine_impl.h"
#include "sim/render/rays/light_keeping.h"

namespace rigor::render {

struct LightTracer::Impl {
  struct Sky {
    std::shared_ptr<const SkyMap> map;
    std::array<int, 4> bands{};
    std::shared_ptr<const light::SkyTables> tables;
  };
  explicit Impl(std::shared_ptr<EmbreeEngine> e) : engine(std::move(e)) {}
  Status trace(const LightQuery& q, std::span<LightSample> samples);
  std::shared_ptr<const light::SkyTables> tables(const std::shared_ptr<const SkyMap>& map,
                                                 const std::array<int, 4>& bands);
  /// What a query is answered from; brings the surfaces up to date.
  struct Input {
    const RayScene* scene;
    light::LightFrame frame;
    Eigen::Vector3d origin;  ///< of the query, relative to the scene's cell
  };
  Result<Input> input(const LightQuery& q);
  Status gather(const LightQuery& q);

  std::shared_ptr<EmbreeEngine> engine;
  std::list<Sky> skies;  ///< the last ones that were asked for
  light::LightSurfaces surfaces;
  light::KeptLight kept;
  light::KeptSun kept_sun;
  const light::GatheredLight nothing_gathered{1};
  const light::GatheredLight* gathered = &nothing_gathered;  ///< in `kept`
  LightStatistics statistics;
};

namespace {

constexpr std::size_t kSkiesKept = 4;

/// Second word of the draw of a gathering point: nobody else's effect.
constexpr std::uint32_t kGatherPoints = 0x4C490004U;

Status check(const LightQuery& q, std::size_t samples) {
  const auto bad = [](const char* where, const std::string& message) {
    return fail(ErrorCode::bad_input, where, message);
  };
  if (samples != q.rays.size())
    return bad("light query", "expected as many samples as rays (" + std::to_string(q.rays.size()) +
                                  "), got " + std::to_string(samples));
  if (!q.numbers.empty() && q.numbers.size() != q.rays.size())
    return bad("numbers", "expected none, or one for each of " + std::to_string(q.rays.size()) +
                              " rays, got " + std::to_string(q.numbers.size()));
  for (const int b : q.bands)
    if (b < 0 || b >= static_cast<int>(kBandCount))
      return bad("bands", "expected 0 to " + std::to_string(kBandCount - 1) + ", got " + std::to_string(b));
  if (!q.origin.allFinite()) return bad("origin", "expected a finite place");
  if (!(q.near_m >= 0) || !std::isfinite(q.near_m)) return bad("near_m", "expected 0 or more");
  if (!(q.spread_rad >= 0) || !(q.spread_rad <= 1)) return bad("spread_rad", "expected 0 to 1");
  if (q.sky_rays < 0 || q.sky_rays > 65536) return bad("sky_rays", "expected 0 to 65536");
  if (q.bounces < 0 || q.bounces > 64) return bad("bounces", "expected 0 to 64");
  return {};
}

}  // namespace

std::shared_ptr<const light::SkyTables> LightTracer::Impl::tables(const std::shared_ptr<const SkyMap>& map,
                                                                  const std::array<int, 4>& bands) {
  for (auto it = skies.begin(); it != skies.end(); ++it)
    if (it->map == map && it->bands == bands) {
      skies.splice(skies.begin(), skies, it);
      return skies.front().tables;
    }
  skies.push_front({map, bands, std::make_shared<const light::SkyTables>(map.get(), bands)});
  if (skies.size() > kSkiesKept) skies.pop_back();
  return skies.front().tables;
}

Result<LightTracer::Impl::Input> LightTracer::Impl::input(const LightQuery& q) {
  auto found = engine->impl().scene_at(q.origin);
  if (!found) return tl::unexpected(found.error());
  const RayScene& scene = **found;
  const WantedContent& content = engine->impl().content();
  surfaces.update(content, q.bands);
  const ContentFrame& frame = content.window->first();
  return Input{&scene, light::light_frame(frame, scene.origin(), q.bands, tables(frame.light.sky, q.bands)),
               Eigen::Vector3d(q.origin - scene.origin())};
}

Status LightTracer::Impl::trace(const LightQuery& q, std::span<LightSample> samples) {
  if (auto s = check(q, samples.size()); !s) return s;
  auto lit = input(q);
  if (!lit) return tl::unexpected(lit.error());
  light::ChunkInput in{*lit->scene, surfaces, lit->frame, q, lit->origin};
  std::atomic<std::size_t> shadow_rays{0}, sky_rays{0};
  if (q.gathered && q.shadows && q.sky_rays == 0) in.gathered = gathered;
  if (q.sun_rays == SunRays::wide && q.shadows && lit->frame.sun && lit->scene->holes_shade()) {
    if (!kept_sun.about(lit->scene->still_serial(), lit->frame.to_sun, lit->frame.sun_radius_rad))
      return fail(ErrorCode::unavailable, "rays", "out of memory");
    in.kept_sun = &kept_sun;
  }
  const std::size_t chunks = (q.rays.size() + light::kChunk - 1) / light::kChunk;
  engine->impl().arena().execute([&] {
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, chunks, 4), [&](const auto& range) {
      light::Chunk chunk(in);
      for (std::size_t c = range.begin(); c != range.end(); ++c) {
        const std::size_t first = c * light::kChunk, n = std::min(light::kChunk, q.rays.size() - first);
        chunk.trace(first, samples.subspan(first, n));
      }
      shadow_rays += chunk.shadow_rays;
      sky_rays += chunk.sky_rays;
    });
  });
  statistics.rays = q.rays.size();
  statistics.shadow_rays = shadow_rays;
  statistics.sky_rays = sky_rays;
  return {};
}

Status LightTracer::Impl::gather(const LightQuery& q) {
  if (auto s = check(q, q.rays.size()); !s) return s;
  gathered = &nothing_gathered;
  if (q.rays.empty()) return {};
  auto lit = input(q);
  if (!lit) return tl::unexpected(lit.error());
  const WantedContent& content = engine->impl().content();
  gathered = &kept.about({*lit->scene, content.still_version, content.moving_version, surfaces, lit->frame},
                         q, engine->impl().arena());
  statistics.gathered_sectors = kept.traced();
  statistics.moved_sectors = kept.moved();
  return {};
}

GatheringPixel gathering_pixel(int block_column, int block_row) noexcept {
  const auto w = models::philox(
      {static_cast<std::uint32_t>(block_column), static_cast<std::uint32_t>(block_row), kGatherPoints, 0},
      {});
  return {block_column * kGatherWidth_px + static_cast<int>(w[0] % kGatherWidth_px),
          block_row * kGatherHeight_px + static_cast<int>(w[1] % kGatherHeight_px)};
}

LightTracer::LightTracer(std::shared_ptr<EmbreeEngine> engine)
    : impl_(std::make_unique<Impl>(std::move(engine))) {}
LightTracer::~LightTracer() = default;

Status LightTracer::gather(const LightQuery& query) { return impl_->gather(query); }
Status LightTracer::trace(const LightQuery& query, std::span<LightSample> samples) {
  return impl_->trace(query, samples);
}
LightStatistics LightTracer::statistics() const noexcept { return impl_->statistics; }

}  // namespace rigor::render
