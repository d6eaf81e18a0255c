#include "sim/render/rays/embree_engine.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <chrono>
#include <cmath>
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

/// What stands there is the same, object by object: no more than light, lamps or air may differ.
bool same_standing(const ContentWindow& a, const ContentWindow& b) {
  if (a.frames.size() != b.frames.size()) return false;
  for (std::size_t i = 0; i < a.frames.size(); ++i) {
    if (a.frames[i] == b.frames[i]) continue;
    const ContentFrame &p = *a.frames[i], &q = *b.frames[i];
    if (p.batches != q.batches || p.surface.wetness != q.surface.wetness ||
        p.surface.snow_depth_m != q.surface.snow_depth_m)
      return false;
  }
  return true;
}

struct Engine final : EmbreeEngine::Impl {
  Engine(std::shared_ptr<MeshCache> c, const EmbreeOptions& o) : cache(std::move(c)) { set(o); }

  void set(const EmbreeOptions& o) {
    const int most = o.threads > 0 ? o.threads : tbb::task_arena::automatic;
    if (!tasks || options.threads != o.threads) tasks = std::make_unique<tbb::task_arena>(most);
    options = o;
  }

  /// Which level of which batch's instances; the first pass names meshes, the second finds their structures.
  [[nodiscard]] Result<WantedContent> want(const std::shared_ptr<const ContentWindow>& w) {
    WantedContent out;
    out.window = w;
    out.batches = match_frames(*w);
    std::vector<std::shared_ptr<const Mesh>> needed;
    std::unordered_set<std::uint64_t> seen;
    const auto need = [&](const std::shared_ptr<const Mesh>& m) {
      if (m && seen.insert(m->serial).second) needed.push_back(m);
    };
    const bool coarse = options.allowed_error_rad > 0 && options.eye.allFinite();
    // What was wanted last time under the same options has its levels already.
    std::unordered_map<std::uint64_t, const WantedBatch*> before;
    if (same_choice())
      for (const WantedBatch& b : wanted.batches) before.emplace(b.frames.front()->serial, &b);
    chosen = options;
    tbb::parallel_for(std::size_t{0}, out.batches.size(), [&](std::size_t i) {
      WantedBatch& batch = out.batches[i];
      if (const auto it = before.find(batch.frames.front()->serial);
          it != before.end() && it->second->frames == batch.frames) {
        batch = *it->second;
        return;
      }
      const Batch& b = *batch.frames.front();
      const auto& all = b.prototype->levels;
      if (all.size() < 2 || !coarse) {
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
            level_for(*b.prototype, largest, c.norm() - s.radius_m * largest, options.allowed_error_rad);
        batch.choice.push_back(all[l].mesh.get());
        one = one && batch.choice.back() == batch.choice.front();
      }
      if (one) batch.choice.resize(1);
    });
    for (const WantedBatch& batch : out.batches)
      for (const LevelOfDetail& l : batch.frames.front()->prototype->levels)
        if (l.mesh && !seen.contains(l.mesh->serial) &&
            std::find(batch.choice.begin(), batch.choice.end(), l.mesh.get()) != batch.choice.end())
          need(l.mesh);
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
    std::unordered_map<std::uint64_t, std::shared_ptr<const RayMesh>> by_serial;
    for (std::size_t i = 0; i < needed.size(); ++i) {
      if (!made[i]) return fail(ErrorCode::unavailable, "rays", wrong[i]);
      by_serial.emplace(needed[i]->serial, made[i]);
      statistics.triangles += made[i]->triangles;
      statistics.left_out += made[i]->left_out;
      statistics.rebuilt += built[i];
    }
    tbb::parallel_for(std::size_t{0}, out.batches.size(), [&](std::size_t i) {
      WantedBatch& batch = out.batches[i];
      if (batch.made) return;
      for (const LevelOfDetail& l : batch.frames.front()->prototype->levels)
        if (l.mesh)
          if (const auto it = by_serial.find(l.mesh->serial); it != by_serial.end())
            batch.meshes.push_back(it->second);
      batch.made = cache->get(batch);
    });
    for (const WantedBatch& batch : out.batches) {
      statistics.left_out += batch.made->left_out;
      statistics.instances += batch.made->present;
    }
    statistics.prototypes = by_serial.size();
    return out;
  }

  /// The options choose the levels that were chosen last.
  [[nodiscard]] bool same_choice() const {
    const auto coarse = [](const EmbreeOptions& o) { return o.allowed_error_rad > 0 && o.eye.allFinite(); };
    if (!coarse(options) && !coarse(chosen)) return true;
    return options.allowed_error_rad == chosen.allowed_error_rad && options.eye == chosen.eye;
  }

  [[nodiscard]] Status prepare(std::shared_ptr<const ContentWindow> w) {
    const auto start = std::chrono::steady_clock::now();
    if (!w || w->frames.empty())
      return fail(ErrorCode::bad_input, "rays", "expected a window with at least one frame");
    for (const auto& f : w->frames)
      if (!f) return fail(ErrorCode::bad_input, "rays", "expected frames, got a null one");
    if (wanted.window && same_choice() && same_standing(*wanted.window, *w)) {
      // Nothing to place. Batches are held by the new window as by the old one.
      wanted.window = std::move(w);
      statistics.rebuilt = 0;
      statistics.prepare_ms = ms_since(start);
      return {};
    }
    statistics = {.cast_ms = statistics.cast_ms};
    Status done{};
    try {
      tasks->execute([&] {
        auto next = want(w);
        if (!next) {
          done = tl::unexpected(next.error());
          return;
        }
        // What was placed points into the meshes that were: they go after the scenes have changed.
        const WantedContent last = std::exchange(wanted, std::move(*next));
        ++version;
        if (scenes.empty()) {
          const Eigen::Vector3d eye = options.eye.allFinite() ? options.eye : Eigen::Vector3d::Zero();
          scenes.push_back({std::make_unique<PlacedScene>(cache, cell_of(eye)), 0});
        }
        // The one that was asked last; another only when it is asked again.
        scenes.resize(1);
        done = bring_up(scenes.front());
      });
    } catch (const std::bad_alloc&) {
      done = fail(ErrorCode::unavailable, "rays", "out of memory");
    }
    if (!done) {
      scenes.clear();
      wanted = {};
      return done;
    }
    statistics.prepare_ms = ms_since(start);
    return {};
  }

  struct Cell {
    std::unique_ptr<PlacedScene> scene;
    std::uint64_t version = 0;
  };
  [[nodiscard]] Status bring_up(Cell& c) {
    if (c.version == version) return {};
    auto s = c.scene->place(wanted);
    if (s) c.version = version;
    return s;
  }

  [[nodiscard]] Result<const RayScene*> scene_at(const Eigen::Vector3d& p) override {
    if (!wanted.window) return fail(ErrorCode::bad_input, "rays", "expected prepare() before a cast");
    if (!p.allFinite()) return fail(ErrorCode::bad_input, "rays", "expected an origin that is finite");
    const Eigen::Vector3d cell = cell_of(p);
    for (std::size_t i = 0; i < scenes.size(); ++i)
      if (scenes[i].scene->origin() == cell) {
        std::swap(scenes[0], scenes[i]);
        return scenes[0].scene.get();
      }
    if (scenes.size() == kCells) scenes.pop_back();
    Status done{};
    try {
      scenes.insert(scenes.begin(), Cell{std::make_unique<PlacedScene>(cache, cell), 0});
      tasks->execute([&] { done = bring_up(scenes.front()); });
    } catch (const std::bad_alloc&) {
      done = fail(ErrorCode::unavailable, "rays", "out of memory");
    }
    if (!done) {
      scenes.erase(scenes.begin());
      return tl::unexpected(done.error());
    }
    return scenes[0].scene.get();
  }
  [[nodiscard]] const ContentWindow* window() const noexcept override { return wanted.window.get(); }
  [[nodiscard]] tbb::task_arena& arena() noexcept override { return *tasks; }

  std::shared_ptr<MeshCache> cache;
  EmbreeOptions options, chosen;  ///< chosen: under which the levels of `wanted` were
  std::unique_ptr<tbb::task_arena> tasks;
  WantedContent wanted;
  std::uint64_t version = 0;
  std::vector<Cell> scenes;  ///< the one that was asked last comes first; before `wanted` they go
  EngineStatistics statistics;
};

Engine& of(EmbreeEngine::Impl& impl) { return static_cast<Engine&>(impl); }

/// Rays of a chunk, shot; coherent where neighbours go much the same way.
void load(Shots& shots, const RayQuery& q, std::size_t begin, unsigned n, const Eigen::Vector3d& start) {
  for (unsigned i = 0; i < n; ++i) {
    const Ray& r = q.rays[begin + i];
    const float o[3] = {static_cast<float>(start.x() + static_cast<double>(r.origin[0])),
                        static_cast<float>(start.y() + static_cast<double>(r.origin[1])),
                        static_cast<float>(start.z() + static_cast<double>(r.origin[2]))};
    shots.set(i, o, r.direction, q.near_m, r.far_m, r.time);
  }
}

void shade(const RayScene& scene, const RayQuery& q, const Ray& ray, const Eigen::Vector3d& start,
           const Meeting& met, Hit& hit) {
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

Status EmbreeEngine::prepare(std::shared_ptr<const ContentWindow> window) {
  return of(*impl_).prepare(std::move(window));
}

namespace {

/// work(scene, start, shots, begin, n): n rays from `begin` on are loaded. Any number of threads at once.
template <class Work>
Status in_chunks(Engine& e, const RayQuery& query, std::size_t answers, Work&& work) {
  const auto began = std::chrono::steady_clock::now();
  if (auto s = check(query, answers); !s) return s;
  const auto scene = e.scene_at(query.origin);
  if (!scene) return tl::unexpected(scene.error());
  const RayScene& s = **scene;
  const Eigen::Vector3d start = query.origin - s.origin();
  const std::size_t chunks = (query.rays.size() + kShots - 1) / kShots;
  e.arena().execute([&] {
    tbb::parallel_for(
        tbb::blocked_range<std::size_t>(0, chunks, 1), [&](const tbb::blocked_range<std::size_t>& range) {
          Shots shots;
          for (std::size_t c = range.begin(); c != range.end(); ++c) {
            const std::size_t begin = c * kShots;
            const auto n = static_cast<unsigned>(std::min<std::size_t>(kShots, query.rays.size() - begin));
            load(shots, query, begin, n, start);
            work(s, start, shots, begin, n);
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
      [&](const RayScene& s, const Eigen::Vector3d& start, Shots& shots, std::size_t begin, unsigned n) {
        s.meet(shots, n, true);
        s.fetch(shots, n);
        for (unsigned i = 0; i < n; ++i)
          shade(s, query, query.rays[begin + i], start, shots.meeting(i), hits[begin + i]);
      });
}

Status EmbreeEngine::occluded(const RayQuery& query, std::span<std::uint8_t> occluded) {
  return in_chunks(of(*impl_), query, occluded.size(),
                   [&](const RayScene& s, const Eigen::Vector3d&, Shots& shots, std::size_t begin,
                       unsigned n) { s.hide(shots, n, true, &occluded[begin]); });
}

EngineStatistics EmbreeEngine::statistics() const { return of(*impl_).statistics; }
const ContentWindow* EmbreeEngine::window() const noexcept { return impl_->window(); }

}  // namespace rigor::render
