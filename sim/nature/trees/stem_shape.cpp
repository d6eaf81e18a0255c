#include "sim/nature/trees/stem_shape.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/nature/trees/draws.h"

namespace rigor::nature {

ShownTree shown_tree(const world::Snapshot& world, const world::types::Tree& types, world::NodeId node) {
  ShownTree t;
  const SpeciesMatch match = find_species(world.get_or_default(node, types.species));
  const Species& species = *match.species;
  t.species = match.species;
  t.known = match.known;
  t.dead = world.get_or_default(node, types.dead);
  const Draws draws("tree", node.value);
  const TreeMeasure measure{
      world.get_or_default(node, types.dbh_m), world.get_or_default(node, types.height_m),
      world.get_or_default(node, types.crown_radius_m), world.get_or_default(node, types.crown_base_m)};
  t.size = size_of(species, measure);
  TreeSize& size = t.size;
  if (t.dead && !(measure.height_m > 0))
    size.height_m *= 0.5 + 0.4 * static_cast<double>(draws.uniform(1, 0));

  // Inventories seldom know which way a tree faces: 0 leaves it to the lot.
  const double heading = world.get_or_default(node, types.heading_rad);
  const double turn = std::isfinite(heading) && heading != 0
                          ? heading
                          : 2 * std::numbers::pi * static_cast<double>(draws.uniform(2, 0));
  t.age_class = age_class_of(size.height_m);
  t.upright.rotation[2] = static_cast<float>(std::sin(0.5 * turn));
  t.upright.rotation[3] = static_cast<float>(std::cos(0.5 * turn));
  t.upright.phase = 2 * std::numbers::pi_v<float> * draws.uniform(3, 0);
  t.light = 1 + 0.10F * draws.spread(4, 0);

  t.trunk = {t.dead                     ? TrunkKind::snag
             : is_conifer(species.form) ? TrunkKind::conifer
                                        : TrunkKind::broadleaf,
             species.bark, t.age_class,
             static_cast<int>(draws.uniform(5, 0) * static_cast<float>(kTrunkVariants))};
  const TrunkPrototype& trunk = trunk_prototype(t.trunk);
  const double crown_m = size.height_m - size.crown_base_m;
  const double top = t.dead ? size.height_m
                     : is_conifer(species.form)
                         ? 0.985 * size.height_m
                         : size.crown_base_m + trunk_share_of_crown(species.form) * crown_m;
  t.stem = t.upright;
  t.stem.scale[2] = static_cast<float>(top / trunk.length_m);
  const double breast = std::min(1.3, 0.4 * top);
  const float girth = trunk.radius_at(static_cast<float>(breast) / t.stem.scale[2]);
  t.stem.scale[0] = t.stem.scale[1] = static_cast<float>(0.5 * size.dbh_m) / std::max(girth, 1e-4F);
  for (int k = 0; k < 3; ++k) t.stem.tint[k] = species.bark_tint[k] * (t.dead ? 1.25F : 1.0F) * t.light;
  return t;
}

std::optional<StemSection> stem_section(const world::Snapshot& world, const world::types::Tree& types,
                                        world::NodeId node, double height_m) {
  const Eigen::Vector3d* at = world.get(node, types.position);
  if (!at || !std::isfinite(at->x() + at->y()) || std::isinf(at->z())) return std::nullopt;
  const ShownTree t = shown_tree(world, types, node);
  const TrunkPrototype& trunk = trunk_prototype(t.trunk);
  const float z = static_cast<float>(height_m) / t.stem.scale[2];
  if (!(height_m >= 0) || z > trunk.length_m) return std::nullopt;
  const Eigen::Vector2f axis = trunk.axis_at(z) * t.stem.scale[0];
  const double s = static_cast<double>(t.stem.rotation[2]), c = static_cast<double>(t.stem.rotation[3]);
  const double cosine = c * c - s * s, sine = 2 * s * c;
  const double x = static_cast<double>(axis.x()), y = static_cast<double>(axis.y());
  return StemSection{at->x() + cosine * x - sine * y, at->y() + sine * x + cosine * y,
                     2 * static_cast<double>(trunk.radius_at(z) * t.stem.scale[0])};
}

}  // namespace rigor::nature
