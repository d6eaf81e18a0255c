#include <set>
#include <tuple>
#include <unordered_map>

#include "sim/nature/providers.h"
#include "sim/nature/terrain/tile.h"
#include "sim/render/content/surface_library.h"

namespace rigor::nature {
namespace {

using render::Batch;
using render::ContentFrame;
using render::ContentQuery;

/// A texel may subtend this many times the error that is allowed.
constexpr double kTexelsPerError = 2;
/// The finest texel that is baked.
constexpr double kFinestTexel_m = 0.005;
/// Blocks along a tile: at least four, so that a neighbour two levels coarser meets it at common points.
constexpr int kFewestBlocks_log2 = 2, kMostBlocks_log2 = 6;
/// Neighbours differ by this many levels at most.
constexpr int kLevelsApart = kFewestBlocks_log2;
/// With no error allowed, every height is drawn, and between heights the bilinear surface to this error.
constexpr double kFullError_m = 0.005, kFullError_rad = 2e-5, kFullTexel_rad = 1e-3;
/// Tiles that are kept for all who ask, a quarter of a megabyte each, about; those of the last answer always.
constexpr std::size_t kTilesKept = 4096;

struct Key {
  NodeId grid;
  TreeNode node;
  int s = 0;
  bool operator==(const Key&) const = default;
};
struct KeyHash {
  std::size_t operator()(const Key& k) const noexcept {
    std::uint64_t h = k.grid.value;
    for (const std::uint64_t v : {static_cast<std::uint64_t>(k.node.m), static_cast<std::uint64_t>(k.node.i),
                                  static_cast<std::uint64_t>(k.node.j), static_cast<std::uint64_t>(k.s)}) {
      h = (h ^ v) * 0x9E3779B97F4A7C15ULL;
      h ^= h >> 29;
    }
    return static_cast<std::size_t>(h);
  }
};

struct Info {
  float low = 0, high = 0;
  int s = 0;                ///< the coarsest blocks that are as good as the node's texels
  double error_m = 0;       ///< of these
  double cell_error_m = 0;  ///< of whole cells as two triangles
};
struct Tile {
  std::shared_ptr<const Batch> batch;  ///< null: nothing is drawn there
  std::uint64_t used = 0;
};

const std::shared_ptr<const render::Surface>& water_surface() {
  static const std::shared_ptr<const render::Surface> surface = [] {
    auto s = std::make_shared<render::Surface>(*render::SurfaceLibrary::builtin().get("water"));
    s->serial = render::next_serial();
    s->water = true;
    s->takes_snow = false;
    s->porosity = 0;
    return s;
  }();
  return surface;
}

auto water_key(const WaterBody& w) {
  std::uint64_t hash = 0;
  for (const int c : w.cells) hash = (hash ^ static_cast<std::uint64_t>(c)) * 0x9E3779B97F4A7C15ULL;
  for (const double v : w.outline.span())
    hash = (hash ^ std::bit_cast<std::uint64_t>(v)) * 0x9E3779B97F4A7C15ULL;
  return std::tuple(w.node.value, w.bounds.x0, w.bounds.y0, w.bounds.x1, w.bounds.y1, w.level_m, w.follows,
                    hash);
}
using WaterKey = decltype(water_key(WaterBody{}));

class Provider final : public TerrainProvider {
 public:
  explicit Provider(const TerrainOptions& options) : options_(options) {}

  std::string_view name() const override { return "terrain"; }
  std::uint64_t version() const override { return version_; }
  std::vector<std::string> warnings() const override { return warnings_; }

  double height_at(double x, double y) const override { return ground_->height_at(x, y); }
  Eigen::Vector3d normal_at(double x, double y) const override {
    const Eigen::Vector2d s = ground_->slope_at(x, y);
    return Eigen::Vector3d(-s.x(), -s.y(), 1).normalized();
  }

  void rebuild(const world::Snapshot& world) override {
    version_ = render::next_serial();
    warnings_.clear();
    ground_ = std::make_shared<const Ground>(world, warnings_);
    trees_.clear();
    tiles_.clear();
    infos_.clear();
    waters_.clear();
    for (std::size_t i = 0; i < ground_->terrain.size(); ++i) {
      trees_.push_back(std::make_unique<HeightTree>(ground_, i));
    }
  }

  void apply(const world::ChangeSet& set) override {
    const GroundChanges c = ground_changes(set);
    if (!c.terrain && !c.land_cover && !c.imagery && !c.water) return;
    version_ = render::next_serial();
    warnings_.clear();
    const auto before = ground_;
    const bool waters_stand = !c.land_cover && !c.water && !touches_water(*before, c.terrain_rects);
    ground_ = waters_stand ? std::make_shared<const Ground>(set.after, warnings_, *before)
                           : std::make_shared<const Ground>(set.after, warnings_);
    std::vector<Rect> redrawn = c.terrain_rects;
    if (!waters_stand) differing_waters(*before, *ground_, redrawn);
    std::vector<std::unique_ptr<HeightTree>> trees;
    for (std::size_t i = 0; i < ground_->terrain.size(); ++i) {
      const NodeId node = ground_->terrain[i].node;
      const auto old = std::find_if(trees_.begin(), trees_.end(),
                                    [&](const auto& t) { return t && t->grid().node == node; });
      const bool reshaped =
          std::find(c.reshaped_terrain.begin(), c.reshaped_terrain.end(), node) != c.reshaped_terrain.end();
      if (reshaped || old == trees_.end()) {
        trees.push_back(std::make_unique<HeightTree>(ground_, i));
      } else {
        (*old)->update(ground_, i, redrawn);
        trees.push_back(std::move(*old));
      }
    }
    trees_ = std::move(trees);
    forget(c, redrawn);
  }

  void collect(const ContentQuery& query, ContentFrame& frame) override {
    ++now_;
    std::vector<Key> wanted;
    for (const auto& tree : trees_) select(*tree, query, wanted);
    build_missing(wanted);
    for (const Key& k : wanted) {
      Tile& tile = tiles_.at(k);
      tile.used = now_;
      if (tile.batch) frame.batches.push_back(tile.batch);
    }
    collect_waters(query, frame);
    forget_oldest();
  }

 private:
  // -------------------------------------------------------------- selection
  struct NodeHash {
    std::size_t operator()(const TreeNode& n) const noexcept { return KeyHash{}(Key{{}, n, 0}); }
  };
  using Leaves = std::unordered_map<TreeNode, int, NodeHash>;  // → s; looked up, and put in order below

  static double texel_m(const HeightTree& tree, int m) {
    return std::ldexp(tree.grid().frame.spacing_m, m) / (kTileTexels - 1);
  }
  static int finest_level(const HeightTree& tree) {
    return static_cast<int>(
        std::ceil(std::log2(kFinestTexel_m * (kTileTexels - 1) / tree.grid().frame.spacing_m)));
  }

  const Info& info(const HeightTree& tree, const TreeNode& n) {
    const auto [it, fresh] = infos_.try_emplace(Key{tree.grid().node, n, 0});
    Info& out = it->second;
    if (!fresh) return out;
    const auto range = tree.range_m(n);
    out.low = range.low;
    out.high = range.high;
    const double tolerance = texel_m(tree, n.m) / kTexelsPerError;
    for (int k = kFewestBlocks_log2; k <= kMostBlocks_log2; ++k) {
      out.s = n.m - k;
      out.error_m = tree.error_m(n, out.s);
      if (out.error_m <= tolerance) break;
    }
    if (tree.ground().river_near(tree.rect(n))) {  // its banks are drawn by blocks: as fine as may be
      out.s = n.m - kMostBlocks_log2;
      out.error_m = tree.error_m(n, out.s);
    }
    if (n.m <= kMostBlocks_log2) {  // wider nodes are never drawn cell by cell
      out.cell_error_m = tree.error_m(n, std::min(0, n.m));
      if (n.m < 0) out.cell_error_m = std::ldexp(out.cell_error_m, -2 * n.m);
    }
    return out;
  }

  static Eigen::AlignedBox3d box(const HeightTree& tree, const TreeNode& n, const Info& i) {
    const Rect r = tree.rect(n);
    return {Eigen::Vector3d(r.x0, r.y0, i.low), Eigen::Vector3d(r.x1, r.y1, i.high)};
  }

  bool matters(const HeightTree& tree, const TreeNode& n, const ContentQuery& query) {
    if (tree.span(n).empty() || tree.drawn(n) == Share::none) return false;
    const Info& i = info(tree, n);
    return i.low <= i.high && query.may_matter(box(tree, n, i));
  }

  /// The size of blocks with which a node may be drawn, or nothing where it must be split.
  std::optional<int> blocks_for(const HeightTree& tree, const TreeNode& n, const ContentQuery& query) {
    const Info& i = info(tree, n);
    const double d = query.distance_m(box(tree, n, i));
    const bool finest = n.m <= finest_level(tree);
    const double texel = texel_m(tree, n.m) / kTexelsPerError;
    if (query.allowed_error_rad > 0 && d >= query.full_within_m) {
      if (finest || std::max(i.error_m, texel) <= query.allowed_error_rad * d) return i.s;
      return std::nullopt;
    }
    const double tolerance = std::max(kFullError_m, kFullError_rad * d);
    int s = std::min(0, n.m - kFewestBlocks_log2);
    while (std::ldexp(i.cell_error_m, 2 * s) > tolerance && n.m - s < kMostBlocks_log2) --s;
    if (finest) return s;
    const bool full = n.m - s <= kMostBlocks_log2 && std::ldexp(i.cell_error_m, 2 * s) <= tolerance;
    return full && texel <= kFullTexel_rad * d ? std::optional(s) : std::nullopt;
  }

  void refine(const HeightTree& tree, const TreeNode& n, const ContentQuery& query, Leaves& leaves) {
    if (!matters(tree, n, query)) return;
    if (const auto s = blocks_for(tree, n, query)) {
      leaves.emplace(n, *s);
      return;
    }
    for (int k = 0; k < 4; ++k) refine(tree, {n.m - 1, 2 * n.i + (k & 1), 2 * n.j + (k >> 1)}, query, leaves);
  }

  void select(const HeightTree& tree, const ContentQuery& query, std::vector<Key>& wanted) {
    Leaves leaves;
    refine(tree, tree.root(), query, leaves);
    std::vector<TreeNode> open;
    for (const auto& [n, s] : leaves) open.push_back(n);
    const auto by_place = [](const TreeNode& a, const TreeNode& b) {
      return std::tie(a.m, a.j, a.i) < std::tie(b.m, b.j, b.i);
    };
    std::sort(open.begin(), open.end(), by_place);
    while (!open.empty()) {
      const TreeNode n = open.back();
      open.pop_back();
      if (!leaves.contains(n)) continue;
      for (int side = 0; side < 4; ++side) {
        const TreeNode beside{n.m, n.i + (side == 1) - (side == 0), n.j + (side == 3) - (side == 2)};
        if (beside.i < 0 || beside.j < 0) continue;
        for (int up = kLevelsApart + 1; n.m + up <= tree.root().m; ++up) {
          const TreeNode wide{n.m + up, beside.i >> up, beside.j >> up};
          if (!leaves.contains(wide)) continue;
          leaves.erase(wide);
          for (int k = 0; k < 4; ++k) {
            const TreeNode part{wide.m - 1, 2 * wide.i + (k & 1), 2 * wide.j + (k >> 1)};
            if (!matters(tree, part, query)) continue;
            leaves.emplace(part, blocks_for(tree, part, query).value_or(info(tree, part).s));
            open.push_back(part);
          }
          open.push_back(n);
          break;
        }
      }
    }
    std::vector<Key> keys;
    for (const auto& [n, s] : leaves) keys.push_back({tree.grid().node, n, s});
    std::sort(keys.begin(), keys.end(), [&](const Key& a, const Key& b) { return by_place(a.node, b.node); });
    wanted.insert(wanted.end(), keys.begin(), keys.end());
  }

  // -------------------------------------------------------------- tiles
  [[nodiscard]] const HeightTree& tree_of(NodeId grid) const {
    return **std::find_if(trees_.begin(), trees_.end(),
                          [&](const auto& t) { return t->grid().node == grid; });
  }

  std::shared_ptr<Batch> build(const Key& k, double low, double high) const {
    const HeightTree& tree = tree_of(k.grid);
    const Rect r = tree.rect(k.node);
    const Eigen::Vector3d origin((r.x0 + r.x1) / 2, (r.y0 + r.y1) / 2, std::floor((low + high) / 2));
    const TileMesh tile = tile_mesh(tree, k.node, k.s, origin);
    const auto& mesh = tile.mesh;
    if (!mesh) return nullptr;
    const auto all = static_cast<std::uint32_t>(mesh->indices.size());
    mesh->parts = {{0, tile.first_river_index, tile_surface(tree, k.node, options_.plain_imagery)}};
    if (tile.first_river_index < all) {
      mesh->parts.push_back({tile.first_river_index, all - tile.first_river_index, water_surface()});
    }
    auto prototype = std::make_shared<render::Prototype>();
    prototype->name = "ground";
    prototype->levels = {{mesh, static_cast<float>(tree.error_m(k.node, k.s))}};
    prototype->occludes = true;
    auto batch = std::make_shared<Batch>();
    batch->prototype = std::move(prototype);
    batch->origin = origin;
    batch->instances.resize(1);
    batch->node = k.grid;
    batch->bounds = {mesh->bounds.min().cast<double>() + origin, mesh->bounds.max().cast<double>() + origin};
    return batch;
  }

  void build_missing(const std::vector<Key>& wanted) {
    std::vector<Key> missing;
    for (const Key& k : wanted) {
      if (!tiles_.contains(k)) missing.push_back(k);
    }
    std::vector<std::shared_ptr<Batch>> made(missing.size());
    std::vector<Info> of(missing.size());
    for (std::size_t i = 0; i < missing.size(); ++i) of[i] = info(tree_of(missing[i].grid), missing[i].node);
    const auto make = [&](std::size_t i) { made[i] = build(missing[i], of[i].low, of[i].high); };
    render::make_in_parallel(missing.size(), make);
    for (std::size_t i = 0; i < missing.size(); ++i) tiles_[missing[i]] = {made[i], now_};
  }

  void forget_oldest() {
    if (infos_.size() > 64 * kTilesKept) infos_.clear();
    if (tiles_.size() <= kTilesKept) return;
    std::vector<std::pair<std::uint64_t, Key>> old;
    for (const auto& [k, t] : tiles_) {
      if (t.used != now_) old.emplace_back(t.used, k);
    }
    std::sort(old.begin(), old.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    const std::size_t drop = std::min(tiles_.size() - kTilesKept * 3 / 4, old.size());
    for (std::size_t i = 0; i < drop; ++i) tiles_.erase(old[i].second);
  }

  // -------------------------------------------------------------- changes
  static bool touches_water(const Ground& ground, const std::vector<Rect>& rects) {
    for (const auto& w : ground.waters) {
      for (const Rect& r : rects) {
        if (r.overlaps(w.bounds)) return true;
      }
    }
    return false;
  }

  static void differing_waters(const Ground& before, const Ground& after, std::vector<Rect>& out) {
    std::set<WaterKey> a, b;
    for (const auto& w : before.waters) a.insert(water_key(w));
    for (const auto& w : after.waters) b.insert(water_key(w));
    for (const auto& w : before.waters) {
      if (!b.contains(water_key(w))) out.push_back(w.bounds);
    }
    for (const auto& w : after.waters) {
      if (!a.contains(water_key(w))) out.push_back(w.bounds);
    }
  }

  void forget(const GroundChanges& c, const std::vector<Rect>& redrawn) {
    const auto hits = [](const std::vector<Rect>& rects, const Rect& tile, double margin) {
      return std::any_of(rects.begin(), rects.end(),
                         [&](const Rect& r) { return r.grown(margin).overlaps(tile); });
    };
    double cover_margin = 0, picture_margin = 0;
    for (const auto& g : ground_->covers) cover_margin = std::max(cover_margin, g.frame.spacing_m);
    for (const auto& g : ground_->pictures) picture_margin = std::max(picture_margin, g.frame.spacing_m);
    const auto find_tree = [&](NodeId grid) -> const HeightTree* {
      for (const auto& t : trees_) {
        if (t->grid().node == grid) return t.get();
      }
      return nullptr;
    };
    const auto reshaped = [&](NodeId grid) {
      return std::find(c.reshaped_terrain.begin(), c.reshaped_terrain.end(), grid) !=
             c.reshaped_terrain.end();
    };
    std::erase_if(infos_, [&](const auto& entry) {
      const HeightTree* tree = find_tree(entry.first.grid);
      return !tree || reshaped(entry.first.grid) ||
             hits(redrawn, tree->rect(entry.first.node), tree->grid().frame.spacing_m);
    });
    std::erase_if(tiles_, [&](const auto& entry) {
      const HeightTree* tree = find_tree(entry.first.grid);
      if (!tree || reshaped(entry.first.grid)) return true;
      const Rect rect = tree->rect(entry.first.node);
      // A height counts for the slopes at its neighbours, and these for the cells beside.
      return hits(redrawn, rect, 1.999 * tree->grid().frame.spacing_m) ||
             hits(c.land_cover_rects, rect, cover_margin) ||
             (options_.plain_imagery && hits(c.imagery_rects, rect, picture_margin));
    });
    std::set<WaterKey> now;
    for (const auto& w : ground_->waters) now.insert(water_key(w));
    std::erase_if(waters_, [&](const auto& entry) {
      const Rect bounds{std::get<1>(entry.first), std::get<2>(entry.first), std::get<3>(entry.first),
                        std::get<4>(entry.first)};
      return !now.contains(entry.first) || hits(c.terrain_rects, bounds, 0);
    });
  }

  // -------------------------------------------------------------- water
  void collect_waters(const ContentQuery& query, ContentFrame& frame) {
    for (const auto& body : ground_->waters) {
      if (body.bounds.empty()) continue;
      const auto [it, fresh] = waters_.try_emplace(water_key(body));
      if (fresh) it->second = build_water(body);
      if (it->second && query.may_matter(it->second->bounds)) frame.batches.push_back(it->second);
    }
  }

  std::shared_ptr<const Batch> build_water(const WaterBody& body) const {
    const Eigen::Vector3d origin((body.bounds.x0 + body.bounds.x1) / 2, (body.bounds.y0 + body.bounds.y1) / 2,
                                 body.level_m);
    auto mesh = water_mesh(*ground_, body, origin);
    if (!mesh) return nullptr;
    mesh->parts = {{0, static_cast<std::uint32_t>(mesh->indices.size()), water_surface()}};
    auto prototype = std::make_shared<render::Prototype>();
    prototype->name = "water";
    prototype->levels = {{mesh, 0.0F}};
    prototype->casts_shadow = false;
    auto batch = std::make_shared<Batch>();
    batch->prototype = std::move(prototype);
    batch->origin = origin;
    batch->instances.resize(1);
    batch->node = body.node;
    batch->bounds = {mesh->bounds.min().cast<double>() + origin, mesh->bounds.max().cast<double>() + origin};
    return batch;
  }

  TerrainOptions options_;
  std::shared_ptr<const Ground> ground_ = std::make_shared<const Ground>();
  std::vector<std::unique_ptr<HeightTree>> trees_;
  std::unordered_map<Key, Tile, KeyHash> tiles_;
  std::unordered_map<Key, Info, KeyHash> infos_;
  std::map<WaterKey, std::shared_ptr<const Batch>> waters_;
  std::vector<std::string> warnings_;
  std::uint64_t now_ = 0, version_ = render::next_serial();
};

}  // namespace

std::shared_ptr<TerrainProvider> make_terrain_provider(const TerrainOptions& options) {
  return std::make_shared<Provider>(options);
}

}  // namespace rigor::nature
