#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/nature/trees/crown_levels.h"

namespace rigor::nature {
namespace {

constexpr float kPi = std::numbers::pi_v<float>;

struct Habit {
  float widest;                  ///< height of the greatest width, share of the crown
  float full_below, full_above;  ///< outline ((…)^power below and above the widest): larger is fuller
  float shell;                   ///< 1: leaves all through the crown; above: towards its surface
  float crooked;                 ///< bends of the limbs
  float rise;                    ///< limbs leave the stem steeply
  float hang;                    ///< twigs hang
  float stem;                    ///< how far the middle stem goes on, share of the crown
  float lumps;                   ///< how deep the hollows between boughs are
  float leafy;                   ///< number of cards, relative
  float path_weight;             ///< long ways are shunned: few long limbs (low) or many from the stem (high)
};
Habit habit_of(TreeForm form) {
  switch (form) {
    case TreeForm::oak:
      return {0.46F, 2.6F, 2.6F, 2.6F, 0.26F, 0.30F, 0.0F, 0.35F, 0.30F, 1.0F, 0.25F};
    case TreeForm::birch:
      return {0.28F, 1.8F, 1.2F, 1.5F, 0.10F, 0.9F, 1.0F, 0.85F, 0.16F, 0.8F, 0.5F};
    case TreeForm::shrub:
      return {0.55F, 1.6F, 2.0F, 1.8F, 0.18F, 0.9F, 0.1F, 0.15F, 0.15F, 1.0F, 0.6F};
    default:
      return {0.36F, 2.1F, 1.8F, 2.2F, 0.13F, 0.7F, 0.05F, 0.6F, 0.10F, 1.0F, 0.4F};
  }
}
/// Reach of the crown over height, 0 base … 1 top.
float outline(const Habit& h, float t) {
  const float x = t < h.widest ? (h.widest - t) / (h.widest + 0.06F) : (t - h.widest) / (1.01F - h.widest);
  const float p = t < h.widest ? h.full_below : h.full_above;
  return std::pow(std::max(0.0F, 1 - std::pow(x, p)), 1 / p);
}

struct Node {
  Vec3 position;
  int parent = -1;
  float way = 0;   ///< along the wood to the ground
  float flow = 0;  ///< twigs that hang on it
  float radius = 0;
  int terminal = -1;
};
struct Limb {
  int from;                ///< node that it leaves
  std::vector<int> nodes;  ///< its own, outwards
};

struct Crown {
  Habit habit;
  ClassSize size;
  Draws draws;
  std::vector<Node> nodes;
  std::vector<Limb> limbs;
  std::vector<int> tips;  ///< node of each cluster of leaves
  float spacing = 1;
  Vec3 middle;

  [[nodiscard]] Vec3 outward(const Vec3& p) const {
    const Vec3 d((p.x() - middle.x()) / size.radius_m, (p.y() - middle.y()) / size.radius_m,
                 (p.z() - middle.z()) / (0.6F * size.crown_m));
    return d.squaredNorm() > 1e-8F ? Vec3(d.normalized()) : Vec3(0, 0, 1);
  }
  [[nodiscard]] float sway(const Vec3& p) const {
    const float out = std::hypot(p.x(), p.y()) / size.radius_m, up = std::max(0.0F, p.z() / size.crown_m);
    return std::clamp(0.2F * up * up + 0.8F * out * (0.3F + 0.7F * up), 0.0F, 1.0F);
  }
};

constexpr int kClusters[kAgeClasses] = {28, 80, 140, 215, 290};

Crown plan(const CrownKey& key) {
  Crown c{habit_of(key.form),
          class_size(key.form, key.age_class),
          Draws("broadleaf_crown", static_cast<std::uint64_t>(key.form) * 64 +
                                       static_cast<std::uint64_t>(key.age_class) * 8 +
                                       static_cast<std::uint64_t>(key.variant)),
          {},
          {},
          {},
          1,
          {}};
  const float length = c.size.crown_m, reach = c.size.radius_m;
  const Habit& h = c.habit;
  c.middle = Vec3(0, 0, 0.40F * length);
  const int clusters = kClusters[key.age_class];
  c.spacing = 0.95F * std::cbrt(2.6F * reach * reach * length / static_cast<float>(clusters));

  const float lobe = 6.28F * c.draws.uniform(1, 0);
  // Leaves gather in boughs with hollows between them: first the middles of the boughs, then clusters about
  // them.
  const auto inside = [&](const Vec3& p) {
    const float t = p.z() / length, a = std::atan2(p.y(), p.x());
    if (t < 0 || t > 1) return 9.0F;
    const float bump =
        1 + h.lumps * (std::sin(3 * a + lobe + 5 * t) + 0.66F * std::sin(5 * a - 9 * t + 2 * lobe));
    return std::hypot(p.x(), p.y()) / std::max(0.02F * reach, reach * outline(h, t) * bump);
  };
  const int boughs = 7 + 4 * key.age_class;
  const float bough_m = 0.92F * std::cbrt(2.6F * reach * reach * length / static_cast<float>(boughs));
  std::vector<Vec3> middles;
  for (int i = 0; i < boughs; ++i) {
    Vec3 best(0, 0, 0.5F * length);
    float best_gap = -1;
    for (int trial = 0; trial < 12; ++trial) {
      const auto n = static_cast<std::uint32_t>(i), m = static_cast<std::uint32_t>(trial);
      const float t = 0.06F + 0.86F * c.draws.uniform(12, n, m), a = 2 * kPi * c.draws.uniform(13, n, m);
      const float r = 0.86F * reach * outline(h, t) * std::pow(c.draws.uniform(14, n, m), 1 / h.shell);
      const Vec3 p(r * std::cos(a), r * std::sin(a), t * length);
      float gap = 1e9F;
      for (const Vec3& q : middles) gap = std::min(gap, (p - q).squaredNorm());
      if (gap > best_gap) best_gap = gap, best = p;
    }
    middles.push_back(best);
  }
  std::vector<Vec3> places;
  for (int i = 0; i < clusters; ++i) {
    Vec3 best = middles[i % boughs];
    float best_gap = -1;
    for (int trial = 0; trial < 8; ++trial) {
      const auto n = static_cast<std::uint32_t>(i), m = static_cast<std::uint32_t>(trial);
      const float a = 2 * kPi * c.draws.uniform(2, n, m), up = c.draws.spread(3, n, m),
                  r = std::cbrt(c.draws.uniform(4, n, m));
      const float flat = std::sqrt(1 - up * up) * r;
      const Vec3 p = middles[i % boughs] +
                     bough_m * Vec3(0.62F * flat * std::cos(a), 0.62F * flat * std::sin(a), 0.42F * r * up);
      if (inside(p) > 1.05F) continue;
      float gap = 1e9F;
      for (const Vec3& q : places) gap = std::min(gap, (p - q).squaredNorm());
      if (gap > best_gap) best_gap = gap, best = p;
    }
    places.push_back(best);
  }

  // The stem within the crown, then the clusters from the inside out, each joined to the wood that makes the
  // shortest and most natural way.
  const float stem = h.stem * length, step = std::max(0.12F, 0.55F * c.spacing);
  const int stem_nodes = std::max(2, static_cast<int>(stem / step));
  for (int i = 0; i <= stem_nodes; ++i) {
    const float z = stem * static_cast<float>(i) / static_cast<float>(stem_nodes);
    Node n;
    n.position = Vec3(0, 0, z);
    if (i > stem_nodes / 2) {
      const float wander = h.crooked * c.spacing * 0.5F * static_cast<float>(i - stem_nodes / 2) /
                           static_cast<float>(stem_nodes);
      n.position += Vec3(wander * c.draws.spread(5, static_cast<std::uint32_t>(i)),
                         wander * c.draws.spread(6, static_cast<std::uint32_t>(i)), 0);
    }
    n.parent = i - 1;
    n.way = z;
    c.nodes.push_back(n);
  }
  Limb trunk{0, {}};
  for (int i = 1; i <= stem_nodes; ++i) trunk.nodes.push_back(i);
  c.limbs.push_back(trunk);
  std::vector<int> order(places.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = static_cast<int>(i);
  const Vec3 root(0, 0, 0.2F * stem);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return (places[a] - root).squaredNorm() < (places[b] - root).squaredNorm();
  });
  for (const int place : order) {
    const Vec3 p = places[place];
    int best = 0;
    float least = 1e9F;
    for (std::size_t k = 0; k < c.nodes.size(); ++k) {
      const Node& n = c.nodes[k];
      const Vec3 d = p - n.position;
      const float away = d.norm();
      // Wood grows out and up: turning back or down is dear.
      const Vec3 was =
          n.parent >= 0 ? Vec3((n.position - c.nodes[n.parent].position).normalized()) : Vec3(0, 0, 1);
      const float back = away > 1e-6F ? std::max(0.0F, 0.35F - d.dot(was) / away) : 0;
      const float down = std::max(0.0F, -d.z()) * (1 - 0.8F * h.hang);
      const float cost = away * (1 + 0.9F * back) + h.path_weight * n.way + 0.9F * down;
      if (cost < least) least = cost, best = static_cast<int>(k);
    }
    const Vec3 from = c.nodes[best].position, d = p - from;
    const int links = std::max(1, static_cast<int>(std::lround(d.norm() / step)));
    Limb limb{best, {}};
    int parent = best;
    // It leaves steeply or level and bends towards its end.
    const Vec3 bend =
        h.rise * 0.16F * d.norm() *
        Vec3(-0.4F * d.x() / std::max(0.1F, d.norm()), -0.4F * d.y() / std::max(0.1F, d.norm()), 1);
    for (int i = 1; i <= links; ++i) {
      const float s = static_cast<float>(i) / static_cast<float>(links);
      const auto id = static_cast<std::uint32_t>(c.nodes.size());
      Node n;
      n.position = from + s * d + 4 * s * (1 - s) * bend * (d.z() > 0 ? 1.0F : 0.4F);
      if (i < links)
        n.position += h.crooked * 0.6F * step *
                      Vec3(c.draws.spread(7, id), c.draws.spread(8, id), c.draws.spread(9, id));
      n.parent = parent;
      n.way = c.nodes[parent].way + (n.position - c.nodes[parent].position).norm();
      if (i == links) n.terminal = place;
      c.nodes.push_back(n);
      parent = static_cast<int>(id);
      limb.nodes.push_back(parent);
    }
    c.limbs.push_back(limb);
    c.tips.push_back(parent);
  }
  // Leonardo's rule, with the exponent that trees keep (about 2.3).
  for (std::size_t k = c.nodes.size(); k-- > 0;) {
    Node& n = c.nodes[k];
    if (n.terminal >= 0) n.flow += 1;
    if (n.parent >= 0) c.nodes[n.parent].flow += n.flow;
  }
  const float twig = 0.0065F + 0.0045F * c.spacing;
  for (Node& n : c.nodes) n.radius = twig * std::pow(std::max(n.flow, 0.5F), 1 / 2.3F);
  return c;
}

void wood_of(MeshBuilder& out, const Crown& c, float thinnest, bool fine) {
  for (std::size_t k = 0; k < c.limbs.size(); ++k) {
    const Limb& limb = c.limbs[k];
    const Node& root = c.nodes[limb.from];
    if (limb.nodes.empty() || c.nodes[limb.nodes.front()].radius < thinnest) continue;
    std::vector<StemPoint> path;
    const float first = c.nodes[limb.nodes.front()].radius;
    path.push_back({root.position, std::min(root.radius, 1.25F * first), c.sway(root.position)});
    for (const int i : limb.nodes)
      path.push_back({c.nodes[i].position, c.nodes[i].radius, c.sway(c.nodes[i].position)});
    if (!fine && path.size() > 3) path = {path.front(), path[path.size() / 2], path.back()};
    path.back().radius *= 0.5F;
    const int sides = fine ? (first > 0.07F ? 6 : first > 0.03F ? 4 : 3) : 3;
    out.tube(path, sides, 1, 0.31F * static_cast<float>(k));
  }
}

struct Leaves {
  int every, cards, cell;  ///< cell −1: the twig pictures
  float length;            ///< of a card / spacing
};
void leaves_of(MeshBuilder& out, const Crown& c, const Leaves& l, float scale) {
  for (std::size_t k = static_cast<std::size_t>(l.every) / 2; k < c.tips.size();
       k += static_cast<std::size_t>(l.every)) {
    const Node& tip = c.nodes[c.tips[k]];
    const Vec3 out_of = c.outward(tip.position);
    const Vec3 along = (tip.position - c.nodes[tip.parent].position).normalized();
    for (int i = 0; i < l.cards; ++i) {
      const auto n = static_cast<std::uint32_t>(k), m = static_cast<std::uint32_t>(i);
      const auto rnd = [&](std::uint32_t stream) { return c.draws.spread(30 + stream, n, m); };
      // Round about the tip, more outwards than back.
      const float z = 1 - 2 * (static_cast<float>(i) + 0.5F) / static_cast<float>(l.cards),
                  a = 2.39996F * static_cast<float>(i) + kPi * rnd(0);
      const float flat = std::sqrt(std::max(0.0F, 1 - z * z));
      Vec3 d(flat * std::cos(a), flat * std::sin(a), 0.75F * z);
      d = (d + 0.45F * out_of + 0.25F * along - Vec3(0, 0, 1.5F * c.habit.hang) +
           0.2F * Vec3(rnd(1), rnd(2), rnd(3)))
              .normalized();
      const float length = l.length * c.spacing * scale * (0.85F + 0.3F * c.draws.uniform(36, n, m));
      const Vec3 base = tip.position - 0.12F * length * d + 0.10F * c.spacing * Vec3(rnd(4), rnd(5), rnd(6));
      // Leaves lie level or face the light, with much scatter.
      const float roll = 0.9F * rnd(7);
      const Vec3 level = (Vec3(0, 0, 1) * (1 - 0.6F * c.habit.hang) + 0.8F * out_of).normalized();
      Vec3 across = d.cross(level);
      across = across.squaredNorm() > 1e-6F ? Vec3(across.normalized()) : square_to(d);
      Vec3 up = (std::cos(roll) * across.cross(d) + std::sin(roll) * across).normalized();
      if (up.dot(out_of) < 0) up = -up;
      const auto normal = [&](const Vec3& p) { return Vec3((c.outward(p) + 0.25F * up).normalized()); };
      const float depth = (tip.position - c.middle)
                              .cwiseQuotient(Vec3(c.size.radius_m, c.size.radius_m, 0.6F * c.size.crown_m))
                              .norm();
      const Vec3 centre = base + 0.5F * length * d;
      const float height = centre.z() / c.size.crown_m;
      const bool shaded = depth + 0.2F * rnd(8) < 0.62F || d.dot(out_of) < -0.35F ||
                          (height + 0.1F * rnd(9) < 0.3F && depth < 0.95F);
      const int cell = l.cell >= 0 ? l.cell : static_cast<int>(4 * c.draws.uniform(37, n, m));
      out.set_inner(shaded);
      out.card(base, length * d, up, 0.27F * length, cell, normal(base), normal(base + length * d),
               c.sway(base), c.sway(base + length * d),
               std::clamp(length / (l.cell >= 0 ? 2.4F : 1.2F), 0.35F, 1.0F));
    }
  }
}

}  // namespace

CrownMeshes make_broadleaf_crown(const CrownKey& key) {
  const Crown c = plan(key);
  const FoliageSurface& foliage = foliage_surface(key.form);
  const auto bark = bark_surface(key.bark);
  CrownMeshes out;
  out.length_m = c.size.crown_m;
  constexpr int kCards[kAgeClasses] = {8, 10, 13, 15, 14};
  const int cards = static_cast<int>(std::lround(static_cast<float>(kCards[key.age_class]) * c.habit.leafy));
  MeshBuilder fine;
  fine.set_coverage(foliage.coverage);
  wood_of(fine, c, 0.0F, true);
  leaves_of(fine, c, {1, cards, -1, 0.80F}, 1);
  const float leaf_area = fine.leaf_area_m2();
  out.half_width_m.push_back(fine.mean_half_width_m());
  out.levels.push_back(fine.finish(bark, foliage.surface, foliage.inner));
  out.length_m = out.levels.front()->bounds.max().z();
  struct Level {
    Leaves leaves;
    float area, thinnest;
  };
  const Level levels[kCrownLevels - 1] = {
      {{1, cards / 2, -1, 1.05F}, 0.95F, 0.022F},
      {{1, std::min(4, cards / 2 - 1), kBoughCell, 1.3F}, 0.85F, 0.035F + 0.01F * c.spacing},
      {{2, 2, kBoughCell, 1.8F}, 0.75F, 0.09F},
      {{5, 1, kBoughCell, 2.6F}, 0.6F, 1e9F}};
  for (const Level& level : levels) {
    MeshBuilder trial, mesh;
    trial.set_coverage(foliage.coverage);
    leaves_of(trial, c, level.leaves, 1);
    wood_of(mesh, c, level.thinnest, false);
    leaves_of(mesh, c, level.leaves,
              std::clamp(std::sqrt(level.area * leaf_area / trial.leaf_area_m2()), 0.6F, 1.6F));
    out.half_width_m.push_back(mesh.mean_half_width_m());
    out.levels.push_back(mesh.finish(bark, foliage.surface, foliage.inner));
  }
  return out;
}

}  // namespace rigor::nature
