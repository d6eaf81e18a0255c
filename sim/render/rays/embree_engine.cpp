#include "sim/render/rays/embree_engine.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <list>
#include <new>
#include <unordered_map>
#include <unordered_set>

#include "rt-core/stage_time.h"
#include "sim/render/rays/embree_engine_impl.h"
#include "sim/render/rays/embree_placement.h"
#include "sim/world/semantic_types.h"

namespace rigor::render {
namespace {

constexpr double kCell_m = 256;
constexpr std::size_t kCells = 2;  ///< scenes that are kept: a sensor at a cell's edge goes to and fro
constexpr std::size_t kContentsKept = 4;

Eigen::Vector3d cell_of(const Eigen::Vector3d& p) {
  return {std::round(p.x() / kCell_m) * kCell_m, std::round(p.y() / kCell_m) * kCell_m,
          std::round(p.z() / kCell_m) * kCell_m};
}

/// The coarsest level whose error is allowed there, as the Vulkan engine chooses (culling.cpp).
std::size_t level_for(const Prototype& p, double scale, double distance_m, double allowed_rad) {
  std::size_t best = 0;
  const double allowed_m = allowed_rad * std::max(distance_m, 0.0);
  for (std::size_t i = 1; i < p.levels.size(); ++i)
    if (static_cast<double>(p.levels[i].error_m) * scale <= allowed_m) best = i;
  return best;
}

/// The same things in the same places, though content was asked for anew: as of two cameras that measure at
/// one instant.
bool alike(const Batch& a, const Batch& b) {
  if (&a == &b) return true;
  static_assert(sizeof(Instance) == 14 * sizeof(float));  // nothing in between
  return a.prototype == b.prototype && a.origin == b.origin && a.node == b.node && a.nodes == b.nodes &&
         a.instances.size() == b.instances.size() &&
         std::memcmp(a.instances.data(), b.instances.data(), a.instances.size() * sizeof(Instance)) == 0;
}
bool alike(const std::vector<WantedBatch>& a, const std::vector<WantedBatch>& b) {
  return std::ranges::equal(a, b, [](const WantedBatch& x, const WantedBatch& y) {
    return std::ranges::equal(x.frames, y.frames,
                              [](const Batch* s, const Batch* t) { return alike(*s, *t); });
  });
}

struct Engine final : EmbreeEngine::Impl {
  Engine(std::shared_ptr<MeshCache> c, const EmbreeOptions& o) : cache(std::move(c)) { set(o); }

  void set(const EmbreeOptions& o) {
    const int most = o.threads > 0 ? o.threads : tbb::task_arena::automatic;
    if (!tasks || options.threads != o.threads) tasks = std::make_unique<tbb::task_arena>(most);
    options = o;
  }

  /// Levels, structures and batches of what is wanted; what `before` has of it already is taken from there.
  [[nodiscard]] Status make(std::vector<WantedBatch>& batches, const std::vector<WantedBatch>& before,
                            EngineStatistics& made_now) {
    std::unordered_map<std::uint64_t, const WantedBatch*> known;
    for (const WantedBatch& b : before) known.emplace(b.frames.front()->serial, &b);
    tbb::parallel_for(std::size_t{0}, batches.size(), [&](std::size_t i) {
      WantedBatch& batch = batches[i];
      if (const auto it = known.find(batch.frames.front()->serial);
          it != known.end() && it->second->frames == batch.frames)
        batch = *it->second;
      else
        choose_levels(batch);
    });
    std::vector<std::shared_ptr<const Mesh>> needed;
    std::unordered_set<std::uint64_t> seen;
    for (const WantedBatch& batch : batches)
      for (const LevelOfDetail& l : batch.frames.front()->prototype->levels)
        if (l.mesh && !seen.contains(l.mesh->serial) &&
            std::find(batch.choice.begin(), batch.choice.end(), l.mesh.get()) != batch.choice.end()) {
          seen.insert(l.mesh->serial);
          needed.push_back(l.mesh);
        }
    std::vector<std::shared_ptr<const RayMesh>> made(needed.size());
    std::vector<std::uint8_t> built(needed.size());
    std::vector<std::string> wrong(needed.size());
    tbb::parallel_for(std::size_t{0}, needed.size(), [&](std::size_t i) {
      bool fresh = false;
      auto m = cache->get(needed[i], fresh);
      if (m)
        made[i] = *m;
      else
        wrong[i] = m.error().text();
      built[i] = fresh ? 1 : 0;
    });
    made_now = {};
    std::unordered_map<std::uint64_t, std::shared_ptr<const RayMesh>> by_serial;
    for (std::size_t i = 0; i < needed.size(); ++i) {
      if (!made[i]) return fail(ErrorCode::unavailable, "rays", wrong[i]);
      by_serial.emplace(needed[i]->serial, made[i]);
      made_now.triangles += made[i]->triangles;
      made_now.left_out += made[i]->left_out;
      made_now.rebuilt += built[i];
    }
    made_now.prototypes = by_serial.size();
    tbb::parallel_for(std::size_t{0}, batches.size(), [&](std::size_t i) {
      WantedBatch& batch = batches[i];
      if (batch.made) return;
      for (const LevelOfDetail& l : batch.frames.front()->prototype->levels)
        if (l.mesh)
          if (const auto it = by_serial.find(l.mesh->serial); it != by_serial.end())
            batch.meshes.push_back(it->second);
      batch.made = cache->get(batch);
    });
    for (const WantedBatch& batch : batches) {
      made_now.left_out += batch.made->left_out;
      made_now.instances += batch.made->present;
    }
    return {};
  }

  void choose_levels(WantedBatch& batch) const {
    const Batch& b = *batch.frames.front();
    const auto& all = b.prototype->levels;
    if (all.size() < 2 || !coarse(options)) {
      batch.choice = {all.empty() ? nullptr : all.front().mesh.get()};
      return;
    }
    const PrototypeSphere s = cache->sphere(*b.prototype);
    const Eigen::Vector3d origin = b.origin - options.eye;
    bool one = true;
    batch.choice.reserve(b.instances.size());
    for (const Instance& n : b.instances) {
      const Eigen::Quaterniond q(n.rotation[3], n.rotation[0], n.rotation[1], n.rotation[2]);
      const Eigen::Vector3d scale(n.scale[0], n.scale[1], n.scale[2]);
      const Eigen::Vector3d c = origin + Eigen::Vector3d(n.position[0], n.position[1], n.position[2]) +
                                q.normalized() * scale.cwiseProduct(s.centre);
      const double largest = scale.cwiseAbs().maxCoeff();
      const std::size_t l =
          level_for(*b.prototype, largest, c.norm() - options.eye_reach_m - s.radius_m * largest,
                    options.allowed_error_rad);
      batch.choice.push_back(all[l].mesh.get());
      one = one && batch.choice.back() == batch.choice.front();
    }
    if (one) batch.choice.resize(1);
  }

  static bool coarse(const EmbreeOptions& o) { return o.allowed_error_rad > 0 && o.eye.allFinite(); }
  /// The options choose the levels that were chosen last.
  [[nodiscard]] bool same_choice() const {
    if (!coarse(options) && !coarse(chosen)) return true;
    return options.allowed_error_rad == chosen.allowed_error_rad && options.eye == chosen.eye &&
           options.eye_reach_m == chosen.eye_reach_m;
  }

  [[nodiscard]] Status prepare(std::shared_ptr<const ContentWindow> w) {
    const auto start = std::chrono::steady_clock::now();
    if (!w || w->frames.empty())
      return fail(ErrorCode::bad_input, "rays", "expected a window with at least one frame");
    for (const auto& f : w->frames)
      if (!f) return fail(ErrorCode::bad_input, "rays", "expected frames, got a null one");
    Status done{};
    try {
      tasks->execute([&] { done = take_over(std::move(w)); });
    } catch (const std::bad_alloc&) {
      done = fail(ErrorCode::unavailable, "rays", "out of memory");
    }
    if (!done) {
      scenes.clear();
      wanted = {};
      standing.clear();
      return done;
    }
    statistics.instances = still_made.instances + moving_made.instances;
    statistics.prototypes = still_made.prototypes + moving_made.prototypes;
    statistics.triangles = still_made.triangles + moving_made.triangles;
    statistics.rebuilt = still_made.rebuilt + moving_made.rebuilt;
    statistics.left_out = still_made.left_out + moving_made.left_out;
    statistics.prepare_ms = ms_since(start);
    return {};
  }

  [[nodiscard]] Status take_over(std::shared_ptr<const ContentWindow> w) {
    SplitWindow next = split(*w);
    const bool stands = wanted.window && same_choice() && next.still == standing;
    still_made.rebuilt = moving_made.rebuilt = 0;
    if (stands && alike(next.moving, wanted.moving)) {
      // What stands still is held by the new window as by the old one.
      for (std::size_t i = 0; i < next.moving.size(); ++i)
        wanted.moving[i].frames = std::move(next.moving[i].frames);
      wanted.window = std::move(w);
      return scenes.front()->place(wanted);
    }
    // What was placed points into the meshes that were: they go after the scenes have changed.
    const std::vector<WantedBatch> moved = std::exchange(wanted.moving, std::move(next.moving));
    static const std::vector<WantedBatch> none;
    const bool same = same_choice();
    if (!stands) {
      std::vector<WantedBatch> still(next.still.size());
      for (std::size_t i = 0; i < still.size(); ++i) still[i].frames = {next.still[i]};
      chosen = options;
      if (auto s = make(still, same ? wanted.still : none, still_made); !s) return s;
      // Who goes to and fro between two places finds its structures again.
      std::vector<std::shared_ptr<const RayBatch>> past;
      past.reserve(wanted.still.size());
      for (WantedBatch& b : wanted.still) past.push_back(std::move(b.made));
      kept.push_front(std::move(past));
      if (kept.size() > kContentsKept) kept.pop_back();
      wanted.still = std::move(still);
      standing = std::move(next.still);
      wanted.still_version = ++versions;
    }
    if (auto s = make(wanted.moving, same ? moved : none, moving_made); !s) return s;
    wanted.moving_version = ++versions;
    wanted.window = std::move(w);
    if (scenes.empty()) {
      const Eigen::Vector3d eye = options.eye.allFinite() ? options.eye : Eigen::Vector3d::Zero();
      scenes.push_back(std::make_unique<PlacedScene>(cache, cell_of(eye)));
    }
    // The one that was asked last; another only when it is asked again.
    scenes.resize(1);
    return scenes.front()->place(wanted);
  }

  [[nodiscard]] Result<const RayScene*> scene_at(const Eigen::Vector3d& p) override {
    if (!wanted.window) return fail(ErrorCode::bad_input, "rays", "expected prepare() before a cast");
    if (!p.allFinite()) return fail(ErrorCode::bad_input, "rays", "expected an origin that is finite");
    const Eigen::Vector3d cell = cell_of(p);
    for (std::size_t i = 0; i < scenes.size(); ++i)
      if (scenes[i]->origin() == cell) {
        std::swap(scenes[0], scenes[i]);
        if (auto s = scenes[0]->place(wanted); !s) return tl::unexpected(s.error());  // the weather alone
        scenes[0]->set_profile(profile.get());
        return scenes[0].get();
      }
    if (scenes.size() == kCells) scenes.pop_back();
    Status done{};
    try {
      scenes.insert(scenes.begin(), std::make_unique<PlacedScene>(cache, cell));
      tasks->execute([&] { done = scenes.front()->place(wanted); });
    } catch (const std::bad_alloc&) {
      done = fail(ErrorCode::unavailable, "rays", "out of memory");
    }
    if (!done) {
      scenes.erase(scenes.begin());
      return tl::unexpected(done.error());
    }
    scenes[0]->set_profile(profile.get());
    return scenes[0].get();
  }
  [[nodiscard]] const WantedContent& content() const noexcept override { return wanted; }
  [[nodiscard]] tbb::task_arena& arena() noexcept override { return *tasks; }

  std::shared_ptr<MeshCache> cache;
  EmbreeOptions options, chosen;  ///< chosen: under which the levels of `wanted` were
  std::unique_ptr<tbb::task_arena> tasks;
  WantedContent wanted;
  std::vector<const Batch*> standing;  ///< those of wanted.still
  std::list<std::vector<std::shared_ptr<const RayBatch>>> kept;
  std::uint64_t versions = 0;
  std::vector<std::unique_ptr<PlacedScene>>
      scenes;  ///< the one that was asked last comes first; before `wanted` they go
  EngineStatistics statistics, still_made, moving_made;
  std::shared_ptr<RayProfile> profile;
};

std::int64_t process_cpu_ns() {
  timespec t{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return std::int64_t{t.tv_sec} * 1'000'000'000 + t.tv_nsec;
}

Engine& of(EmbreeEngine::Impl& impl) { return static_cast<Engine&>(impl); }

/// Rays of a chunk, shot; coherent where neighbours go much the same way.
void load(RayPackets& rays, const RayQuery& q, std::size_t begin, unsigned n, const Eigen::Vector3d& start) {
  for (unsigned i = 0; i < n; ++i) {
    const Ray& r = q.rays[begin + i];
    const float o[3] = {static_cast<float>(start.x() + static_cast<double>(r.origin[0])),
                        static_cast<float>(start.y() + static_cast<double>(r.origin[1])),
                        static_cast<float>(start.z() + static_cast<double>(r.origin[2]))};
    rays.set(i, o, r.direction, q.near_m, r.far_m, r.time);
  }
}

void shade(const RayScene& scene, const RayQuery& q, const Ray& ray, const Eigen::Vector3d& start,
           const Intersection& met, Hit& hit) {
  hit = Hit{};
  if (met.nothing()) return;
  const double o[3] = {start.x() + static_cast<double>(ray.origin[0]),
                       start.y() + static_cast<double>(ray.origin[1]),
                       start.z() + static_cast<double>(ray.origin[2])};
  const SurfacePoint p = scene.point(o, ray.direction, ray.time, met);
  const int band[1] = {q.band};
  const PointOptics s = optics_at(*p.surface, p.uv, p.tint, p.normal, p.place, scene.weather(), band,
                                  &hit.reflectance, &hit.transmittance);
  hit.range_m = static_cast<float>(p.range_m);
  const float along =
      p.normal[0] * ray.direction[0] + p.normal[1] * ray.direction[1] + p.normal[2] * ray.direction[2];
  const float turn = along > 0 ? -1.0F : 1.0F;
  for (int k = 0; k < 3; ++k) hit.normal[k] = turn * p.normal[k];
  hit.cos_incidence = std::min(std::abs(along), 1.0F);
  hit.roughness = s.roughness;
  hit.metallic = s.metallic;
  hit.retro_reflection = s.retro_reflection;
  hit.water = s.water;
  hit.uv[0] = p.uv[0];
  hit.uv[1] = p.uv[1];
  hit.node = p.node;
  hit.surface = p.surface->surface.get();
}

[[nodiscard]] Status check(const RayQuery& q, std::size_t out) {
  if (q.rays.size() != out)
    return fail(
        ErrorCode::bad_input, "rays",
        "expected as many hits as rays, " + std::to_string(q.rays.size()) + ", got " + std::to_string(out));
  if (q.band < 0 || q.band >= static_cast<int>(kBandCount))
    return fail(ErrorCode::bad_input, "rays",
                "band: expected 0 to " + std::to_string(kBandCount - 1) + ", got " + std::to_string(q.band));
  if (!(q.near_m >= 0) || !std::isfinite(q.near_m))
    return fail(ErrorCode::bad_input, "rays", "near_m: expected 0 or more");
  return {};
}

}  // namespace

EmbreeEngine::EmbreeEngine() = default;
EmbreeEngine::~EmbreeEngine() = default;

Result<std::shared_ptr<EmbreeEngine>> EmbreeEngine::create(std::shared_ptr<EmbreeCache> cache,
                                                           const EmbreeOptions& options) {
  auto meshes = std::dynamic_pointer_cast<MeshCache>(cache);
  if (!meshes) return fail(ErrorCode::unavailable, "rays", "expected a cache made by EmbreeCache::create");
  std::shared_ptr<EmbreeEngine> engine(new EmbreeEngine);
  engine->impl_ = std::make_unique<Engine>(std::move(meshes), options);
  return engine;
}

void EmbreeEngine::set_options(const EmbreeOptions& options) { of(*impl_).set(options); }
void EmbreeEngine::set_profile(std::shared_ptr<RayProfile> profile) {
  of(*impl_).profile = std::move(profile);
}

Status EmbreeEngine::prepare(std::shared_ptr<const ContentWindow> window) {
  Engine& e = of(*impl_);
  if (!e.profile) return e.prepare(std::move(window));
  const std::int64_t begun_ns = process_cpu_ns();
  const Status done = e.prepare(std::move(window));
  e.profile->prepare_ns += process_cpu_ns() - begun_ns;
  return done;
}

namespace {

/// work(scene, start, rays, begin, n): n rays from `begin` on are loaded. Any number of threads at once.
template <class Work>
Status in_chunks(Engine& e, const RayQuery& query, std::size_t answers, Work&& work) {
  const auto began = std::chrono::steady_clock::now();
  if (auto s = check(query, answers); !s) return s;
  const auto scene = e.scene_at(query.origin);
  if (!scene) return tl::unexpected(scene.error());
  const RayScene& s = **scene;
  const Eigen::Vector3d start = query.origin - s.origin();
  const std::size_t chunks = (query.rays.size() + kPacketRays - 1) / kPacketRays;
  e.arena().execute([&] {
    tbb::parallel_for(
        tbb::blocked_range<std::size_t>(0, chunks, 1), [&](const tbb::blocked_range<std::size_t>& range) {
          RayPackets rays;
          for (std::size_t c = range.begin(); c != range.end(); ++c) {
            const std::size_t begin = c * kPacketRays;
            const auto n =
                static_cast<unsigned>(std::min<std::size_t>(kPacketRays, query.rays.size() - begin));
            load(rays, query, begin, n, start);
            work(s, start, rays, begin, n);
          }
        });
  });
  e.statistics.cast_ms = ms_since(began);
  return {};
}

}  // namespace

Status EmbreeEngine::cast(const RayQuery& query, std::span<Hit> hits) {
  return in_chunks(
      of(*impl_), query, hits.size(),
      [&](const RayScene& s, const Eigen::Vector3d& start, RayPackets& rays, std::size_t begin, unsigned n) {
        s.intersect(rays, n, true);
        s.fetch(rays, n);
        for (unsigned i = 0; i < n; ++i)
          shade(s, query, query.rays[begin + i], start, rays.intersection(i), hits[begin + i]);
      });
}

Status EmbreeEngine::cast_layers(const RayQuery& query, LayeredHits& hits) {
  if (!(query.half_width_m >= 0) || !(query.half_width_per_m >= 0) || !std::isfinite(query.half_width_m) ||
      !std::isfinite(query.half_width_per_m))
    return fail(ErrorCode::bad_input, "rays", "half widths: expected 0 or more");
  std::array<float, kPacketRays> half_width_m;
  half_width_m.fill(query.half_width_m);
  const WideRays wide{half_width_m.data(), query.half_width_per_m};
  return in_chunks(
      of(*impl_), query, hits.rays(),
      [&](const RayScene& s, const Eigen::Vector3d& start, RayPackets& rays, std::size_t begin, unsigned n) {
        LayerWalk walk(wide);
        s.intersect(rays, n, true, walk);
        s.fetch(rays, n);
        for (unsigned i = 0; i < n; ++i) {
          const Ray& ray = query.rays[begin + i];
          const Intersection last = rays.intersection(i);
          hits.clear(begin + i);
          float left = 1;
          const auto tell = [&](const Intersection& met, float share) {
            PartialHit& to = hits.add(begin + i);
            shade(s, query, ray, start, met, to.hit);
            to.share = share;
          };
          unsigned k = 0;
          for (; k < walk.count[i] && LayerWalk::key(walk.layers[i][k].met) < LayerWalk::key(last); ++k) {
            const LayerWalk::Layer& layer = walk.layers[i][k];
            // Whatever is behind these is not known, or does not count.
            const bool ends = k + 1 == LayerWalk::kMost || left * (1 - layer.cover) < LayerWalk::kLeast;
            tell(layer.met, ends ? left : left * layer.cover);
            left *= ends ? 0 : 1 - layer.cover;
            if (ends) break;
          }
          if (left > 0 && !last.nothing()) tell(last, left);
        }
      });
}

Status EmbreeEngine::occluded(const RayQuery& query, std::span<std::uint8_t> occluded) {
  return in_chunks(of(*impl_), query, occluded.size(),
                   [&](const RayScene& s, const Eigen::Vector3d&, RayPackets& rays, std::size_t begin,
                       unsigned n) { s.occluded(rays, n, true, &occluded[begin]); });
}

EngineStatistics EmbreeEngine::statistics() const { return of(*impl_).statistics; }
const ContentWindow* EmbreeEngine::window() const noexcept { return impl_->content().window.get(); }

}  // namespace rigor::render
