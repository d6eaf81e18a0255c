#include <atomic>
#include <limits>
#include <thread>
#include <unordered_map>

#include "sim/nature/providers.h"
#include "sim/nature/terrain/vegetation.h"

namespace rigor::nature {
namespace {

using render::Batch;
using render::ContentFrame;
using render::ContentQuery;

/// Plants may be thinned until the way from one to the next subtends this many times the error allowed.
constexpr double kSpacingPerError = 6;
/// A plant that is not this many times as high as the error allowed is not drawn: its cover's colour is on
/// the ground.
constexpr double kLeastHeightPerError = 1.0;
/// More plants than these are never given for one query; the nearest are.
constexpr double kMostPlants = 2e6;
/// Plants that are kept for all who ask, 64 bytes each; those of the last answer always.
constexpr std::size_t kPlantsKept = 4'000'000;

struct CellHash {
  std::size_t operator()(const PlantCell& c) const noexcept {
    std::uint64_t h =
        c.layer * 64 + static_cast<std::uint64_t>(c.size) * 8 + static_cast<std::uint64_t>(c.thinned);
    for (const std::int64_t v : {c.i, c.j}) {
      h = (h ^ static_cast<std::uint64_t>(v)) * 0x9E3779B97F4A7C15ULL;
      h ^= h >> 29;
    }
    return static_cast<std::size_t>(h);
  }
};

class Provider final : public render::ContentProvider {
 public:
  explicit Provider(std::shared_ptr<const render::GroundHeights> heights) : heights_(std::move(heights)) {}

  std::string_view name() const override { return "ground vegetation"; }
  std::uint64_t version() const override { return version_; }
  std::vector<std::string> warnings() const override {
    auto all = warnings_;
    if (!cap_warning_.empty()) all.push_back(cap_warning_);
    return all;
  }

  void rebuild(const world::Snapshot& world) override {
    version_ = render::next_serial();
    warnings_.clear();
    cap_warning_.clear();
    cells_.clear();
    infos_.clear();
    kept_ = 0;
    read_ground(world, nullptr);
    layers_ = read_layers(world, warnings_);
  }

  void apply(const world::ChangeSet& set) override {
    const GroundChanges c = ground_changes(set);
    if (!c.any()) return;
    if (c.plants) {
      rebuild(set.after);
      return;
    }
    if (!c.terrain && !c.land_cover && !c.water && !c.roads) return;
    version_ = render::next_serial();
    std::vector<std::string> ignored;  // the terrain's provider tells of the grids
    read_ground(set.after, c.terrain || c.land_cover || c.water ? nullptr : ground_.get());
    std::vector<Rect> touched;
    double margin = 0;
    for (const auto* rects : {&c.terrain_rects, &c.land_cover_rects, &c.water_rects, &c.road_rects}) {
      touched.insert(touched.end(), rects->begin(), rects->end());
    }
    for (const auto& g : ground_->ground.terrain) margin = std::max(margin, 2 * g.frame.spacing_m);
    for (const auto& g : ground_->ground.covers) margin = std::max(margin, g.frame.spacing_m);
    const auto hit = [&](const PlantCell& cell) {
      const Rect rect = rect_of(layers_[cell.layer], cell).grown(margin);
      return std::any_of(touched.begin(), touched.end(), [&](const Rect& r) { return r.overlaps(rect); });
    };
    std::erase_if(infos_, [&](const auto& e) { return hit(e.first); });
    std::erase_if(cells_, [&](const auto& e) {
      if (!hit(e.first)) return false;
      kept_ -= e.second.plants;
      return true;
    });
  }

  void collect(const ContentQuery& query, ContentFrame& frame) override {
    ++now_;
    cap_warning_.clear();
    std::vector<Wanted> wanted;
    for (std::size_t k = 0; k < layers_.size(); ++k) select(k, query, wanted);
    std::sort(wanted.begin(), wanted.end(), [](const Wanted& a, const Wanted& b) {
      return std::tie(a.way_m, a.cell.layer, a.cell.size, a.cell.j, a.cell.i) <
             std::tie(b.way_m, b.cell.layer, b.cell.size, b.cell.j, b.cell.i);
    });
    double plants = 0;
    for (std::size_t i = 0; i < wanted.size(); ++i) {
      plants += wanted[i].expected;
      if (plants <= kMostPlants) continue;
      cap_warning_ = "ground vegetation: more than " + std::to_string(static_cast<long>(kMostPlants)) +
                     " plants matter; those beyond " + std::to_string(static_cast<long>(wanted[i].way_m)) +
                     " m are left out. Allow an error, or a nearer far_m";
      wanted.resize(i);
    }
    build_missing(wanted);
    for (const auto& w : wanted) {
      Cell& cell = cells_.at(w.cell);
      cell.used = now_;
      for (const auto& batch : cell.batches) {
        if (batch) frame.batches.push_back(batch);
      }
    }
    forget_oldest();
  }

 private:
  struct Wanted {
    PlantCell cell;
    double way_m = 0, expected = 0;
  };
  struct Cell {
    std::array<std::shared_ptr<const Batch>, 2> batches;
    std::size_t plants = 0;
    std::uint64_t used = 0;
  };
  struct Info {
    double share = 0;           ///< of the layer's cover
    double low = 0, high = -1;  ///< of the ground, about; inverted: no ground
  };

  void read_ground(const world::Snapshot& world, const PlantGround* same_ground) {
    auto ground = std::make_shared<PlantGround>();
    std::vector<std::string> ignored;  // the terrain's provider tells of them
    ground->ground = same_ground ? same_ground->ground : Ground(world, ignored);
    ground->heights = heights_;
    ground->tracks = read_tracks(world);
    ground_ = std::move(ground);
  }

  const Info& info(const PlantCell& cell) {
    PlantCell key = cell;
    key.thinned = 0;
    const auto [it, fresh] = infos_.try_emplace(key);
    Info& out = it->second;
    if (!fresh) return out;
    const auto& layer = layers_[cell.layer];
    const Rect rect = rect_of(layer, cell);
    out.share = cover_share(*ground_, rect, layer.cover);
    if (out.share <= 0) return out;
    double low = std::numeric_limits<double>::infinity(), high = -low;
    constexpr int kSamples = 5;
    for (int j = 0; j < kSamples; ++j) {
      for (int i = 0; i < kSamples; ++i) {
        const double z = heights_->height_at(rect.x0 + (rect.x1 - rect.x0) * i / (kSamples - 1),
                                             rect.y0 + (rect.y1 - rect.y0) * j / (kSamples - 1));
        if (std::isnan(z)) continue;
        low = std::min(low, z);
        high = std::max(high, z);
      }
    }
    if (low > high) {
      out.share = 0;
      return out;
    }
    // The samples do not see what lies between them: as much again on both sides.
    const double slack = 0.5 * (high - low) + 0.1 * (rect.x1 - rect.x0);
    out.low = low - slack;
    out.high = high + slack + 2 * layer.height_m;
    return out;
  }

  void select(std::size_t k, const ContentQuery& query, std::vector<Wanted>& wanted) {
    const auto& layer = layers_[k];
    const double allowed = query.allowed_error_rad;
    double far = query.far_m;
    if (allowed > 0) {
      far = std::min(far,
                     std::max(layer.height_m * (1 + layer.height_spread) / (kLeastHeightPerError * allowed),
                              query.full_within_m));
    }
    Rect reach;  // of the covers, around the eye
    for (const auto& g : ground_->ground.covers) {
      const Rect r = g.frame.cells();
      reach.add(r.x0, r.y0);
      reach.add(r.x1, r.y1);
    }
    if (reach.empty()) return;
    const double around = far + query.eye_reach_m;
    reach = {std::max(reach.x0, query.eye.x() - around), std::max(reach.y0, query.eye.y() - around),
             std::min(reach.x1, query.eye.x() + around), std::min(reach.y1, query.eye.y() + around)};
    if (reach.empty()) return;
    const double size = std::ldexp(layer.cell_m, kMostThinned);
    const auto cell = [&](double v) { return static_cast<std::int64_t>(std::floor(v / size)); };
    for (std::int64_t j = cell(reach.y0); j <= cell(reach.y1); ++j) {
      for (std::int64_t i = cell(reach.x0); i <= cell(reach.x1); ++i) {
        refine({k, kMostThinned, 0, i, j}, query, far, wanted);
      }
    }
  }

  void refine(PlantCell cell, const ContentQuery& query, double far, std::vector<Wanted>& wanted) {
    const auto& layer = layers_[cell.layer];
    const Info& i = info(cell);
    if (i.share <= 0) return;
    const Rect r = rect_of(layer, cell);
    const double reach = 2 * layer.height_m;  // of a plant beyond its cell
    const Eigen::AlignedBox3d box(Eigen::Vector3d(r.x0 - reach, r.y0 - reach, i.low),
                                  Eigen::Vector3d(r.x1 + reach, r.y1 + reach, i.high));
    const double way = query.distance_m(box);
    const bool shadows = layer.prototypes[0]->casts_shadow;
    if (way > far || !(shadows ? query.may_matter(box) : query.may_see(box))) return;
    const double allowed = way < query.full_within_m ? 0 : query.allowed_error_rad;
    // How far this distance lets plants be thinned; cells are as large as the thinning allows.
    int thinned = 0;
    while (allowed > 0 && thinned < kMostThinned &&
           std::ldexp(layer.spacing_m, thinned + 1) <= kSpacingPerError * allowed * way) {
      ++thinned;
    }
    const bool whole = allowed <= 0 || thinned >= cell.size;
    if (!whole && cell.size > 0) {
      for (int part = 0; part < 4; ++part) {
        refine({cell.layer, cell.size - 1, 0, 2 * cell.i + (part & 1), 2 * cell.j + (part >> 1)}, query, far,
               wanted);
      }
      return;
    }
    cell.thinned = allowed > 0 ? cell.size : 0;
    const double area = (r.x1 - r.x0) * (r.y1 - r.y0);
    wanted.push_back({cell, way, layer.per_m2 * area * i.share * std::ldexp(1.0, -2 * cell.thinned)});
  }

  void build_missing(const std::vector<Wanted>& wanted) {
    std::vector<PlantCell> missing;
    for (const auto& w : wanted) {
      if (!cells_.contains(w.cell)) missing.push_back(w.cell);
    }
    std::vector<std::array<std::shared_ptr<Batch>, 2>> made(missing.size());
    std::atomic<std::size_t> next{0};
    const auto work = [&] {
      for (std::size_t i; (i = next.fetch_add(1)) < missing.size();) {
        made[i] = plant_cell(*ground_, layers_[missing[i].layer], missing[i]);
      }
    };
    const std::size_t helpers =
        missing.size() < 4 ? 0
                           : std::min<std::size_t>(std::max(1U, std::thread::hardware_concurrency()), 8) - 1;
    {
      std::vector<std::jthread> threads;
      for (std::size_t i = 0; i < helpers; ++i) threads.emplace_back(work);
      work();
    }
    for (std::size_t i = 0; i < missing.size(); ++i) {
      Cell& cell = cells_[missing[i]];
      for (std::size_t k = 0; k < 2; ++k) {
        if (!made[i][k]) continue;
        made[i][k]->serial = render::next_serial();  // in the order of cells, whichever thread was first
        cell.plants += made[i][k]->instances.size();
        cell.batches[k] = made[i][k];
      }
      kept_ += cell.plants;
    }
  }

  void forget_oldest() {
    if (infos_.size() > 1'000'000) infos_.clear();
    if (kept_ <= kPlantsKept && cells_.size() < 200'000) return;
    std::vector<std::pair<std::uint64_t, PlantCell>> old;
    for (const auto& [k, c] : cells_) {
      if (c.used != now_) old.emplace_back(c.used, k);
    }
    std::sort(old.begin(), old.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    for (const auto& [used, k] : old) {
      if (kept_ <= kPlantsKept * 3 / 4 && cells_.size() < 100'000) break;
      const auto it = cells_.find(k);
      kept_ -= it->second.plants;
      cells_.erase(it);
    }
  }

  std::shared_ptr<const render::GroundHeights> heights_;
  std::shared_ptr<const PlantGround> ground_ = std::make_shared<const PlantGround>();
  std::vector<PlantLayer> layers_;
  std::unordered_map<PlantCell, Cell, CellHash> cells_;
  std::unordered_map<PlantCell, Info, CellHash> infos_;
  std::vector<std::string> warnings_;
  std::string cap_warning_;
  std::size_t kept_ = 0;
  std::uint64_t now_ = 0, version_ = render::next_serial();
};

}  // namespace

std::unique_ptr<render::ContentProvider> make_ground_vegetation_provider(
    std::shared_ptr<const render::GroundHeights> ground) {
  return std::make_unique<Provider>(std::move(ground));
}

}  // namespace rigor::nature
