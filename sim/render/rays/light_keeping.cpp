#include "sim/render/rays/light_keeping.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace rigor::render::light {
namespace {

/// Side of a cell of the world in which an eye sees the same gathered light.
constexpr double kEyeCell_m = 1;
/// Rays of a sector: one chunk, on a grid.
constexpr int kSectorSide = 8;
static_assert(kSectorSide * kSectorSide == kChunk);
/// Paths of a gathering point; of a leaf, one on each side.
constexpr unsigned kPathsOfAPoint = 3;
static_assert(kPathsOfAPoint <= Chunk::kMostPaths && kChunk <= 256);
/// One ray of a sector gathers for so many pixels, about.
constexpr float kPixelsOfARay = 32;
/// Side of a cell in which gathered light is shared: so many pixels.
constexpr float kCell_px = 64;
/// Sectors along a face of the cube: powers of two between these.
constexpr int kFewest = 8, kMost = 32;
/// Angle between neighbouring pixels where the query does not say.
constexpr float kSpread_rad = 1e-3F;
/// A rig's cameras may stand in several cells; a sensor at a cell's edge goes to and fro.
constexpr std::size_t kRegionsKept = 4;
constexpr std::size_t kKept_bytes = 160'000'000;
/// Second word of the draws' counters: nobody else's effect.
constexpr std::uint32_t kSectorDraws = 0x4C490005U;

/// Angle between neighbouring pixels that have `side` sectors along a face.
float spread_of(int side) {
  constexpr float kOfSphere = 4 * kPi / (6 * kSectorSide * kSectorSide * kPixelsOfARay);
  return std::sqrt(kOfSphere) / static_cast<float>(side);
}
int side_for(float spread_rad) {
  const float wanted = spread_of(1) / (spread_rad > 0 ? spread_rad : kSpread_rad);
  int side = kFewest;
  while (side < kMost && static_cast<float>(side) * std::numbers::sqrt2_v<float> < wanted) side *= 2;
  return side;
}

/// What was gathered, less the sky that something that moves hides; null where nothing does.
std::unique_ptr<Gathered> with_less_sky(const LitScene& lit, const Gathered& kept, float time) {
  std::unique_ptr<Gathered> out;
  RayPackets rays;
  std::array<std::uint8_t, kPacketRays> hidden;
  struct Asked {
    std::size_t sky;
    unsigned ray;
  };
  std::array<Asked, kPacketRays> asked;
  unsigned n = 0;
  const auto ask = [&] {
    lit.scene.occluded_by_fronts(rays, n, hidden.data(), RayScene::Part::moving);
    for (unsigned i = 0; i < n; ++i) {
      if (hidden[i] == 0) continue;
      if (!out) out = std::make_unique<Gathered>(kept);
      GatheredSky& sky = out->skies[asked[i].sky];
      sky.free &= ~(1U << asked[i].ray);
      sky.sky = not_negative(sky.sky - lit.frame.surroundings(sky.direction[asked[i].ray]));
    }
    n = 0;
  };
  for (std::size_t s = 0; s < kept.skies.size(); ++s) {
    const GatheredSky& sky = kept.skies[s];
    const float o[3] = {sky.start.x, sky.start.y, sky.start.z};
    for (unsigned k = 0; k < sky.rays; ++k) {
      if ((sky.free >> k & 1U) == 0) continue;
      const float d[3] = {sky.direction[k].x, sky.direction[k].y, sky.direction[k].z};
      rays.set(n, o, d, 0, std::numeric_limits<float>::infinity(), time, kShadowMask);
      asked[n++] = {s, k};
      if (n == kPacketRays) ask();
    }
  }
  ask();
  return out;
}

bool same(Bands4 a, Bands4 b) { return a[0] == b[0] && a[1] == b[1] && a[2] == b[2] && a[3] == b[3]; }
bool same(Vec3 a, Vec3 b) { return a.x == b.x && a.y == b.y && a.z == b.z; }

}  // namespace

int Sectors::of(Vec3 d) const noexcept {
  const float v[3] = {d.x, d.y, d.z};
  int axis = 0;
  for (int k = 1; k < 3; ++k)
    if (std::abs(v[k]) > std::abs(v[axis])) axis = k;
  const auto place = [&](float a) {
    const float t = (4 / kPi) * std::atan(a / std::abs(v[axis]));
    return std::clamp(static_cast<int>(0.5F * (t + 1) * static_cast<float>(side_)), 0, side_ - 1);
  };
  const int face = 2 * axis + (v[axis] < 0 ? 1 : 0);
  return (face * side_ + place(v[(axis + 2) % 3])) * side_ + place(v[(axis + 1) % 3]);
}

Vec3 Sectors::direction(int sector, float x, float y) const noexcept {
  const int face = sector / (side_ * side_), axis = face / 2;
  const auto along = [&](int i, float part) {
    return std::tan(0.25F * kPi * (2 * (static_cast<float>(i) + part) / static_cast<float>(side_) - 1));
  };
  float v[3];
  v[axis] = face % 2 == 1 ? -1.0F : 1.0F;
  v[(axis + 1) % 3] = along(sector % side_, x);
  v[(axis + 2) % 3] = along(sector / side_ % side_, y);
  return unit({v[0], v[1], v[2]}, {0, 0, 1});
}

bool KeptLight::Key::operator==(const Key& o) const noexcept {
  return cell == o.cell && side == o.side && still_version == o.still_version &&
         scene_origin == o.scene_origin && bands == o.bands && same(to_sun, o.to_sun) &&
         same(sun_irradiance, o.sun_irradiance) && same(ground, o.ground) && sky == o.sky &&
         wetness == o.wetness && snow_depth_m == o.snow_depth_m;
}

Eigen::Vector3d KeptLight::Key::centre() const noexcept {
  return kEyeCell_m * (Eigen::Vector3d(static_cast<double>(cell[0]), static_cast<double>(cell[1]),
                                       static_cast<double>(cell[2])) +
                       Eigen::Vector3d::Constant(0.5));
}

/// The rays of a sector, and the query that they make.
struct KeptLight::SectorRays {
  std::array<Ray, kChunk> rays;
  LightQuery query;
  SectorRays(const Key& key, int sector, float time) {
    // The same in each cell: wherever in the world it lies, the same things have the same light.
    const std::uint64_t seed = static_cast<std::uint64_t>(sector) * 0xD1342543DE82EF95ULL;
    const models::PhiloxKey draws{static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32U)};
    const Sectors sectors(key.side);
    for (std::uint32_t i = 0; i < kChunk; ++i) {
      const auto a = models::philox({i, kSectorDraws, 0, 0}, draws),
                 b = models::philox({i, kSectorDraws, 1, 0}, draws);
      const auto part = [&](std::uint32_t k, std::uint32_t word) {
        return (static_cast<float>(k) + unit_draw(word)) / kSectorSide;
      };
      // Twos of twos: neighbours follow each other, so that packets stay together.
      const std::uint32_t column = (i & 1U) | (i >> 1U & 2U) | (i >> 2U & 4U),
                          row = (i >> 1U & 1U) | (i >> 2U & 2U) | (i >> 3U & 4U);
      const Vec3 d = sectors.direction(sector, part(column, a[0]), part(row, a[1]));
      Ray& r = rays[i];
      for (std::uint32_t k = 0; k < 3; ++k)
        r.origin[k] = static_cast<float>(kEyeCell_m) * (unit_draw(b[k]) - 0.5F);
      r.direction[0] = d.x, r.direction[1] = d.y, r.direction[2] = d.z;
      r.far_m = std::numeric_limits<float>::infinity();
      r.time = time;
    }
    query.origin = key.centre();
    query.bands = key.bands;
    query.rays = rays;
    query.seed = seed;
    query.spread_rad = spread_of(key.side);
  }
};

std::vector<int> KeptLight::looked_at(const LightQuery& query, const Sectors& sectors) {
  const Sectors quarters(2 * sectors.side());
  std::vector<std::uint8_t> hit(static_cast<std::size_t>(quarters.count())),
      about(static_cast<std::size_t>(sectors.count()));
  for (const Ray& r : query.rays) {
    const Vec3 d = from(r.direction);
    if (finite(d) && dot(d, d) > 0) hit[static_cast<std::size_t>(quarters.of(d))] = 1;
  }
  std::vector<int> out;
  for (int q = 0; q < quarters.count(); ++q) {
    if (hit[static_cast<std::size_t>(q)] == 0) continue;
    // The quarters about it.
    for (const float y : {-0.5F, 0.5F, 1.5F})
      for (const float x : {-0.5F, 0.5F, 1.5F})
        about[static_cast<std::size_t>(sectors.of(quarters.direction(q, x, y)))] = 1;
  }
  for (int s = 0; s < sectors.count(); ++s)
    if (about[static_cast<std::size_t>(s)] != 0) out.push_back(s);
  return out;
}

KeptLight::Region& KeptLight::region(const Key& key) {
  const auto it =
      std::find_if(regions_.begin(), regions_.end(), [&](const Region& r) { return r.key == key; });
  if (it != regions_.end()) {
    regions_.splice(regions_.begin(), regions_, it);
  } else {
    regions_.push_front({key, {}, {}, nullptr, {}});
    regions_.front().sectors.resize(static_cast<std::size_t>(Sectors(key.side).count()));
    if (regions_.size() > kRegionsKept) regions_.pop_back();
  }
  return regions_.front();
}

void KeptLight::forget(const std::vector<int>& seen) {
  const auto held = [](const Region& r) {
    std::size_t bytes = 0;
    for (const auto& s : r.sectors)
      if (s) bytes += s->paths.size() * sizeof(GatheredPath) + s->skies.size() * sizeof(GatheredSky);
    return bytes;
  };
  std::size_t bytes = 0;
  for (const Region& r : regions_) bytes += held(r);
  while (bytes > kKept_bytes && regions_.size() > 1) {
    bytes -= held(regions_.back());
    regions_.pop_back();
  }
  if (bytes <= kKept_bytes) return;
  auto& sectors = regions_.front().sectors;
  for (std::size_t s = 0; s < sectors.size(); ++s)
    if (!std::binary_search(seen.begin(), seen.end(), static_cast<int>(s))) sectors[s].reset();
}

const GatheredLight& KeptLight::about(const LitScene& lit, const LightQuery& q, tbb::task_arena& arena) {
  Key key;
  for (int k = 0; k < 3; ++k)
    key.cell[static_cast<std::size_t>(k)] = static_cast<std::int64_t>(std::floor(q.origin[k] / kEyeCell_m));
  key.side = side_for(q.spread_rad);
  key.still_version = lit.still_version;
  key.scene_origin = lit.scene.origin();
  key.bands = q.bands;
  key.to_sun = lit.frame.to_sun;
  key.sun_irradiance = lit.frame.sun_irradiance;
  key.ground = lit.frame.ground;
  key.sky = lit.frame.sky;
  key.wetness = lit.frame.wetness;
  key.snow_depth_m = lit.frame.snow_depth_m;
  const std::vector<int> seen = looked_at(q, Sectors(key.side));
  Region& r = region(key);
  forget(seen);
  std::vector<int> missing;
  for (const int s : seen)
    if (!r.sectors[static_cast<std::size_t>(s)]) missing.push_back(s);
  traced_ = missing.size();
  moved_ = 0;
  arena.execute([&] {
    tbb::parallel_for(std::size_t{0}, missing.size(), [&](std::size_t i) {
      const SectorRays rays(key, missing[i], 0);
      Chunk chunk({lit.scene, lit.surfaces, lit.frame, rays.query, rays.query.origin - lit.scene.origin(),
                   nullptr, RayScene::Part::still, RayScene::Part::still});
      auto gathered = std::make_unique<Gathered>();
      chunk.gather(0, kChunk, kPathsOfAPoint, *gathered);
      r.sectors[static_cast<std::size_t>(missing[i])] = std::move(gathered);
    });
  });
  if (lit.scene.anything_moves() && !q.rays.empty()) return with_moving(lit, q, r, seen, arena);
  if (!r.light || r.shared != seen) {
    r.light = std::make_unique<GatheredLight>(kCell_px * spread_of(key.side));
    for (const int s : seen) r.light->add(*r.sectors[static_cast<std::size_t>(s)]);
    r.shared = seen;
  }
  return *r.light;
}

std::unique_ptr<Gathered> KeptLight::gather_about_moving(const LitScene& lit, const Region& r, int sector,
                                                         float time) {
  const Gathered& kept = *r.sectors[static_cast<std::size_t>(sector)];
  const std::vector<GatheredPath>& paths = kept.paths;
  std::vector<std::uint8_t> blocked(paths.size());
  RayPackets rays;
  for (std::size_t begin = 0; begin < paths.size(); begin += kPacketRays) {
    const auto n = static_cast<unsigned>(std::min<std::size_t>(kPacketRays, paths.size() - begin));
    for (unsigned k = 0; k < n; ++k) {
      const GatheredPath& p = paths[begin + k];
      const float o[3] = {p.start.x, p.start.y, p.start.z},
                  d[3] = {p.direction.x, p.direction.y, p.direction.z};
      rays.set(k, o, d, 0, p.first_m, time, kShadowMask);
    }
    lit.scene.occluded(rays, n, false, &blocked[begin], RayScene::Part::moving);
  }
  std::unique_ptr<Gathered> anew = with_less_sky(lit, kept, time);
  std::array<bool, kChunk> wanted{};
  for (std::size_t i = 0; i < paths.size(); ++i)
    if (blocked[i] != 0) wanted[paths[i].ray] = true;
  if (std::find(wanted.begin(), wanted.end(), true) == wanted.end()) return anew;
  SectorRays again(r.key, sector, time);
  for (std::size_t i = 0; i < kChunk; ++i)
    if (!wanted[i]) std::fill_n(again.rays[i].direction, 3, 0.0F);  // no ray
  Chunk chunk({lit.scene, lit.surfaces, lit.frame, again.query, again.query.origin - lit.scene.origin(),
               nullptr, RayScene::Part::still, RayScene::Part::all});
  if (!anew) anew = std::make_unique<Gathered>(kept);
  chunk.gather(0, kChunk, kPathsOfAPoint, *anew, blocked);
  return anew;
}

const GatheredLight& KeptLight::with_moving(const LitScene& lit, const LightQuery& q, Region& r,
                                            const std::vector<int>& seen, tbb::task_arena& arena) {
  constexpr auto kMoving = RayScene::Part::moving;
  const float time = q.rays.front().time;
  for (Region& other : regions_)
    if (other.moved.version != lit.moving_version || other.moved.time != time) other.moved = {};
  Region::Moved& moved = r.moved;
  moved.version = lit.moving_version;
  moved.time = time;
  moved.sectors.resize(r.sectors.size());
  std::vector<int> unknown;
  for (const int s : seen)
    if (!moved.sectors[static_cast<std::size_t>(s)]) unknown.push_back(s);
  moved_ = unknown.size();
  const std::size_t chunks = (q.rays.size() + kChunk - 1) / kChunk;
  std::vector<Gathered> on_it(chunks);
  arena.execute([&] {
    tbb::parallel_for(std::size_t{0}, unknown.size(), [&](std::size_t i) {
      moved.sectors[static_cast<std::size_t>(unknown[i])] = gather_about_moving(lit, r, unknown[i], time);
    });
    // Of the query's own rays, those that meet what moves.
    LightQuery own = q;
    own.seed = 0;
    own.numbers = {};
    own.sun_rays = SunRays::to_middle;
    tbb::parallel_for(std::size_t{0}, chunks, [&](std::size_t c) {
      const std::size_t first = c * kChunk, n = std::min(kChunk, q.rays.size() - first);
      RayPackets rays;
      const Eigen::Vector3f base = (q.origin - lit.scene.origin()).cast<float>();
      for (unsigned k = 0; k < n; ++k) {
        const Ray& ray = q.rays[first + k];
        const float o[3] = {base.x() + ray.origin[0], base.y() + ray.origin[1], base.z() + ray.origin[2]};
        rays.set(k, o, ray.direction, q.near_m, ray.far_m, ray.time);
      }
      std::array<std::uint8_t, kChunk> meets;
      lit.scene.occluded(rays, static_cast<unsigned>(n), true, meets.data(), kMoving);
      if (std::find(meets.begin(), meets.begin() + static_cast<std::ptrdiff_t>(n), 1) ==
          meets.begin() + static_cast<std::ptrdiff_t>(n))
        return;
      std::array<Ray, kChunk> on;
      std::copy_n(&q.rays[first], n, on.begin());
      for (std::size_t k = 0; k < n; ++k)
        if (meets[k] == 0) std::fill_n(on[k].direction, 3, 0.0F);  // no ray
      LightQuery mine = own;
      mine.rays = std::span<const Ray>(on.data(), n);
      mine.seed = c;  // other draws in each chunk
      Chunk chunk({lit.scene, lit.surfaces, lit.frame, mine, q.origin - lit.scene.origin()});
      chunk.gather(0, n, kPathsOfAPoint, on_it[c]);
    });
  });
  with_moving_ = std::make_unique<GatheredLight>(kCell_px * spread_of(r.key.side));
  for (const int s : seen) {
    const auto sector = static_cast<std::size_t>(s);
    const std::unique_ptr<Gathered>& anew = *moved.sectors[sector];
    with_moving_->add(anew ? *anew : *r.sectors[sector]);
  }
  for (const Gathered& g : on_it) with_moving_->add(g);
  return *with_moving_;
}

}  // namespace rigor::render::light
