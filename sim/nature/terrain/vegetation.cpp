#include "sim/nature/terrain/vegetation.h"

#include <numbers>

#include "sim/world/pose.h"

namespace rigor::nature {
namespace {

constexpr std::uint32_t kPlaceStream = 1001, kLookStream = 1002, kCountStream = 1003;
/// Plants in a finest cell, about.
constexpr double kPlantsPerCell = 200;
/// Nothing grows on ground steeper than this.
constexpr double kSteepest_cos = 0.62;

double squared_way_to_line(std::span<const double> xy, double x, double y) {
  double best = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i + 3 < xy.size(); i += 2) {
    const double ax = xy[i], ay = xy[i + 1], dx = xy[i + 2] - ax, dy = xy[i + 3] - ay;
    const double length2 = dx * dx + dy * dy;
    const double t = length2 > 0 ? std::clamp(((x - ax) * dx + (y - ay) * dy) / length2, 0.0, 1.0) : 0.0;
    best = std::min(best, (x - ax - t * dx) * (x - ax - t * dx) + (y - ay - t * dy) * (y - ay - t * dy));
  }
  return best;
}

}  // namespace

Rect rect_of(const PlantLayer& layer, const PlantCell& c) {
  const double size = std::ldexp(layer.cell_m, c.size), x = static_cast<double>(c.i) * size,
               y = static_cast<double>(c.j) * size;
  return {x, y, x + size, y + size};
}

std::vector<PlantLayer> read_layers(const world::Snapshot& world, std::vector<std::string>& warnings) {
  std::vector<PlantLayer> out;
  if (!world.schema().find_type("GroundVegetation")) return out;
  const world::types::GroundVegetation type(world.schema());
  auto nodes = world.nodes(type.type);
  std::sort(nodes.begin(), nodes.end());
  for (const NodeId node : nodes) {
    PlantLayer l;
    l.node = node;
    const std::string& cover = world.get_or_default(node, type.cover);
    const std::string& plant = world.get_or_default(node, type.plant);
    l.cover = cover_index(cover);
    l.per_m2 = world.get_or_default(node, type.per_m2);
    l.height_m = world.get_or_default(node, type.height_m);
    l.height_spread = world.get_or_default(node, type.height_spread);
    if (l.cover == kNoCover || !plant_from_word(plant, l.plant)) {
      warnings.push_back("GroundVegetation " + std::to_string(node.value) + ": '" + plant + "' on '" + cover +
                         "': expected a plant and a cover word; it is not shown");
      continue;
    }
    if (cover == "water" || cover == "rock") {
      warnings.push_back("GroundVegetation " + std::to_string(node.value) + ": nothing grows on " + cover);
      continue;
    }
    if (!(l.per_m2 > 0) || !(l.height_m > 0)) continue;
    const auto key = place_words(static_cast<std::uint64_t>(world.get_or_default(node, type.seed)), 1000,
                                 l.cover, static_cast<int>(l.plant));
    l.seed = (static_cast<std::uint64_t>(key[0]) << 32) | key[1];
    l.spacing_m = 1 / std::sqrt(l.per_m2);
    l.cell_m =
        std::exp2(std::clamp(std::round(std::log2(l.spacing_m * std::sqrt(kPlantsPerCell))), -1.0, 8.0));
    for (int v = 0; v < 2; ++v) l.prototypes[v] = plant_prototype(l.plant, l.height_m, v);
    out.push_back(std::move(l));
  }
  return out;
}

std::vector<Track> read_tracks(const world::Snapshot& world) {
  std::vector<Track> out;
  if (!world.schema().find_type("Road")) return out;
  const world::types::Road type(world.schema());
  auto nodes = world.nodes(type.type);
  std::sort(nodes.begin(), nodes.end());
  for (const NodeId node : nodes) {
    Track t;
    t.line = world.get_or_default(node, type.line);
    t.half_width_m = world.get_or_default(node, type.width_m) / 2;
    t.bounds = bounds_of(t.line.span()).grown(t.half_width_m);
    if (t.line.size() >= 4 && t.half_width_m > 0) out.push_back(std::move(t));
  }
  return out;
}

double cover_share(const PlantGround& g, const Rect& rect, std::uint8_t cover) {
  // A cell of a finer grid counts before those of coarser ones; where none says anything, nothing grows.
  double best = 0;
  for (const auto& grid : g.ground.covers) {
    const auto& f = grid.frame;
    if (!f.cells().overlaps(rect)) continue;
    const auto cell = [](double v, int most) {
      return static_cast<int>(std::clamp(std::floor(v), 0.0, most - 1.0));
    };
    const int c0 = cell(f.u(rect.x0) - 0.5, f.columns), c1 = cell(f.u(rect.x1) + 1.5, f.columns);
    const int r0 = cell(f.v(rect.y1) - 0.5, f.rows), r1 = cell(f.v(rect.y0) + 1.5, f.rows);
    std::size_t same = 0, all = 0;
    for (int r = r0; r <= r1; ++r) {
      for (int c = c0; c <= c1; ++c, ++all) same += grid.cover(c, r) == cover;
    }
    best = std::max(best, static_cast<double>(same) / static_cast<double>(std::max<std::size_t>(all, 1)));
  }
  return best;
}

std::array<std::shared_ptr<render::Batch>, 2> plant_cell(const PlantGround& g, const PlantLayer& l,
                                                         const PlantCell& cell) {
  const Rect rect = rect_of(l, cell);
  std::vector<const Track*> tracks;
  for (const auto& t : g.tracks) {
    if (t.bounds.overlaps(rect)) tracks.push_back(&t);
  }
  const bool wet = std::any_of(g.ground.waters.begin(), g.ground.waters.end(),
                               [&](const WaterBody& w) { return w.bounds.overlaps(rect); });
  std::array<std::shared_ptr<render::Batch>, 2> out;
  Eigen::Vector3d origin((rect.x0 + rect.x1) / 2, (rect.y0 + rect.y1) / 2, 0);
  bool has_origin = false;
  const double wide = std::ldexp(1.0, cell.thinned);
  const double expected = l.per_m2 * l.cell_m * l.cell_m * std::ldexp(1.0, -2 * cell.thinned);
  const std::int64_t n = std::int64_t{1} << cell.size;
  for (std::int64_t bj = cell.j * n; bj < (cell.j + 1) * n; ++bj) {
    for (std::int64_t bi = cell.i * n; bi < (cell.i + 1) * n; ++bi) {
      const double chance = unit_from_word(place_words(l.seed, kCountStream, bi, bj)[0]);
      const auto count = static_cast<std::uint32_t>(std::floor(expected + chance));
      for (std::uint32_t k = 0; k < count; ++k) {
        const auto place = place_words(l.seed, kPlaceStream, bi, bj, k);
        const double x = (static_cast<double>(bi) + unit_from_word(place[0])) * l.cell_m;
        const double y = (static_cast<double>(bj) + unit_from_word(place[1])) * l.cell_m;
        if (g.ground.cover_at(x, y) != l.cover) continue;
        const double z = g.heights->height_at(x, y);
        if (std::isnan(z) || (wet && g.ground.under_water(x, y, z))) continue;
        const Eigen::Vector3d normal = g.heights->normal_at(x, y);
        if (!(normal.z() >= kSteepest_cos)) continue;
        const bool on_track = std::any_of(tracks.begin(), tracks.end(), [&](const Track* t) {
          return squared_way_to_line(t->line.span(), x, y) < t->half_width_m * t->half_width_m;
        });
        if (on_track) continue;
        if (!has_origin) {
          origin.z() = std::floor(z);
          has_origin = true;
        }
        const auto look = place_words(l.seed, kLookStream, bi, bj, k);
        auto& batch = out[place[3] & 1];
        if (!batch) {
          batch = std::make_shared<render::Batch>();
          batch->prototype = l.prototypes[place[3] & 1];
          batch->node = l.node;
        }
        render::Instance plant;
        plant.position[0] = static_cast<float>(x - origin.x());
        plant.position[1] = static_cast<float>(y - origin.y());
        plant.position[2] = static_cast<float>(z - origin.z());
        // Three uniform numbers add up to something near a normal one, without its tails.
        const double normal_draw =
            2 * (unit_from_word(look[0]) + unit_from_word(look[1]) + unit_from_word(look[2]) - 1.5);
        const double tall = std::max(0.3, 1 + l.height_spread * normal_draw);
        plant.scale[2] = static_cast<float>(tall);
        plant.scale[0] = plant.scale[1] = static_cast<float>(std::sqrt(tall) * wide);
        const double heading = 2 * std::numbers::pi * unit_from_word(place[2]);
        // What lies follows the ground; what grows stands up.
        const Eigen::Quaterniond lie = l.plant == Plant::litter
                                           ? rotation_between(Eigen::Vector3d::UnitZ(), normal)
                                           : Eigen::Quaterniond::Identity();
        const Eigen::Quaterniond q = lie * Eigen::AngleAxisd(heading, Eigen::Vector3d::UnitZ());
        plant.rotation[0] = static_cast<float>(q.x());
        plant.rotation[1] = static_cast<float>(q.y());
        plant.rotation[2] = static_cast<float>(q.z());
        plant.rotation[3] = static_cast<float>(q.w());
        // Some are drier, some lusher, around a mean of 1.
        const double dry = 2 * unit_from_word(look[3]) - 1,
                     light = 1 + 0.14 * (2 * unit_from_word(look[2]) - 1);
        plant.tint[0] = static_cast<float>(light * (1 + 0.18 * dry));
        plant.tint[1] = static_cast<float>(light * (1 + 0.02 * dry));
        plant.tint[2] = static_cast<float>(light * (1 - 0.10 * dry));
        plant.phase = static_cast<float>(2 * std::numbers::pi * unit_from_word(look[1]));
        batch->instances.push_back(plant);
      }
    }
  }
  for (auto& batch : out) {
    if (!batch) continue;
    batch->origin = origin;
    const auto& mesh_bounds = batch->prototype->levels[0].mesh->bounds;
    Eigen::AlignedBox3f widest = mesh_bounds;
    for (const auto& level : batch->prototype->levels) widest.extend(level.mesh->bounds);
    const float reach =
        std::max(widest.max().head<2>().cwiseAbs().maxCoeff(), widest.min().head<2>().cwiseAbs().maxCoeff()) *
        1.42F;
    for (const auto& i : batch->instances) {
      const double r = reach * i.scale[0], h = widest.max().z() * i.scale[2];
      const Eigen::Vector3d p = origin + Eigen::Vector3d(i.position[0], i.position[1], i.position[2]);
      const double lean = l.plant == Plant::litter ? r : 0;
      batch->bounds.extend(Eigen::Vector3d(p.x() - r, p.y() - r, p.z() - lean - 0.02));
      batch->bounds.extend(Eigen::Vector3d(p.x() + r, p.y() + r, p.z() + h + lean));
    }
  }
  return out;
}

}  // namespace rigor::nature
