#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/nature/trees/crown_levels.h"

namespace rigor::nature {
namespace {

constexpr float kPi = std::numbers::pi_v<float>, kGoldenAngle = 2.39996323F;

/// How a kind of conifer carries its branches. Angles in radians above the level.
struct Habit {
  float (*outline)(float t);        ///< reach of the branches over height, 0 base … 1 top; at most about 1
  float low = 0, high = 0.7F;       ///< a branch's direction at the trunk, lowest and topmost
  float droop = 0.3F, rise = 0.2F;  ///< how far it sinks along its way, and how far its tip rises again
  float fan = 0.26F;                ///< half width of a bough / its length
  float lateral_angle = 0.95F, lateral_fall = 0.2F, roll = 0.3F;  ///< of the twigs on a branch
  float bare = 0.16F;    ///< share of a branch near the trunk without leaves (old trees)
  float ragged = 0.15F;  ///< spread of the branches' lengths
  int whorl = 1;         ///< branches at one height
  float density = 1.0F;  ///< number of branches, relative
  float twig_size = 1.0F;
  float leader_bend = 0.0F;
  float second_layer = 0.0F;  ///< share of twigs doubled by a hanging or rising one
};

float spire(float t) { return std::pow(1 - t, 0.76F) * (0.88F + 0.12F * std::min(1.0F, t / 0.12F)); }
float narrow_column(float t) { return std::pow(1 - t, 0.62F); }
float soft_cone(float t) { return std::pow(1 - t, 0.78F) * (0.82F + 0.18F * std::min(1.0F, t / 0.18F)); }
float broad_column(float t) { return std::pow(1 - t, 0.55F) * (0.72F + 0.28F * std::min(1.0F, t / 0.3F)); }
float dome(float t) {
  return std::sqrt(std::max(0.0F, 1 - std::pow((t - 0.38F) / (t < 0.38F ? 0.62F : 0.66F), 2.0F)));
}
float low_bush(float t) { return std::pow(std::max(0.0F, 1 - t), 0.5F); }

Habit habit_of(TreeForm form, int age_class) {
  Habit h{};
  const float old = static_cast<float>(age_class) / (kAgeClasses - 1);
  switch (form) {
    case TreeForm::spruce:
      h.outline = spire, h.low = -0.25F, h.high = 0.75F, h.droop = 0.35F, h.rise = 0.75F, h.fan = 0.20F;
      h.lateral_fall = 0.75F, h.roll = 0.45F, h.whorl = 5, h.second_layer = 0.3F, h.density = 1.05F;
      break;
    case TreeForm::fir:
      h.outline = narrow_column, h.low = -0.22F - 0.15F * old, h.high = 0.55F, h.droop = 0.22F,
      h.rise = 0.35F;
      h.fan = 0.25F, h.lateral_fall = 0.05F, h.roll = 0.28F, h.whorl = 5, h.ragged = 0.12F, h.density = 1.1F;
      h.second_layer = 0.25F;
      break;
    case TreeForm::hemlock:
      h.outline = soft_cone, h.low = 0.12F, h.high = 0.75F, h.droop = 1.0F, h.rise = 0.0F, h.fan = 0.22F;
      h.lateral_angle = 0.9F, h.lateral_fall = 0.35F, h.roll = 0.5F, h.ragged = 0.28F, h.leader_bend = 1.75F;
      h.second_layer = 0.35F, h.density = 1.1F, h.twig_size = 0.95F;
      break;
    case TreeForm::douglas_fir:
      h.outline = age_class >= 3 ? broad_column : spire, h.low = -0.15F - 0.1F * old, h.high = 0.8F,
      h.droop = 0.2F;
      h.rise = 0.35F, h.fan = 0.20F, h.lateral_fall = 0.45F, h.roll = 0.9F, h.ragged = 0.18F + 0.25F * old;
      h.second_layer = 0.5F, h.density = 0.95F;
      break;
    case TreeForm::cedar:
      h.outline = age_class >= 4 ? soft_cone : spire, h.low = 0.1F, h.high = 0.8F, h.droop = 1.15F,
      h.rise = 1.25F;
      h.fan = 0.20F, h.lateral_angle = 0.8F, h.lateral_fall = 0.95F, h.roll = 0.5F, h.ragged = 0.22F;
      h.second_layer = 0.4F, h.leader_bend = 0.5F;
      break;
    case TreeForm::yew:
      h.outline = low_bush, h.low = 0.15F, h.high = 0.8F, h.droop = 0.35F, h.rise = 0.1F, h.fan = 0.34F;
      h.roll = 0.7F, h.ragged = 0.35F, h.density = 0.82F, h.second_layer = 0.35F;
      break;
    case TreeForm::pine:
      h.outline = age_class >= 3 ? dome : soft_cone, h.low = -0.05F, h.high = 0.9F, h.droop = 0.1F,
      h.rise = 0.65F;
      h.fan = 0.24F, h.lateral_fall = -0.25F, h.roll = 1.2F, h.bare = 0.35F, h.ragged = 0.2F + 0.15F * old;
      h.whorl = 5, h.density = 0.62F, h.twig_size = 1.1F, h.second_layer = 0.8F;
      break;
    default:  // larch
      h.outline = soft_cone, h.low = -0.1F, h.high = 0.7F, h.droop = 0.15F, h.rise = 0.4F, h.fan = 0.20F;
      h.lateral_fall = 0.65F, h.roll = 0.6F, h.ragged = 0.3F, h.density = 0.85F, h.second_layer = 0.3F;
      break;
  }
  h.bare *= 0.35F + 0.65F * old;
  return h;
}

struct Branch {
  std::vector<Vec3> path;  ///< from the axis outwards
  Vec3 side, up;           ///< at its middle
  float length, thickness, t;
  std::uint32_t index;
};

/// Young branches are wide for their length.
float fan_of(const Habit& h, const Branch& b) {
  return h.fan * (1 + 0.9F * std::max(0.0F, 1 - b.length / 3.0F));
}

constexpr int kPathPoints = 6;

/// Runs a branch from the axis: its direction sinks and rises again, and it reaches `reach` from the axis.
Branch make_branch(const Habit& h, float t, float z, float azimuth, float reach, float tilt, float length_m,
                   const Draws& draws, std::uint32_t index) {
  Branch b;
  b.t = t, b.index = index;
  const float start = h.low + (h.high - h.low) * std::pow(t, 1.6F) + tilt;
  // Short branches near the top are young and have had no time to sink.
  const float age = std::min(1.0F, 0.25F + 1.1F * (1 - t));
  const float turn = 0.25F * draws.spread(11, index);
  Vec3 p(0, 0, 0);
  b.path.push_back(p);
  float level = 0;
  for (int i = 1; i < kPathPoints; ++i) {
    const float s = (static_cast<float>(i) - 0.5F) / (kPathPoints - 1);
    const float e =
        std::clamp(start - h.droop * age * std::pow(s, 1.1F) + h.rise * age * s * s, -1.35F, 1.4F);
    const float a = azimuth + turn * s;
    p += Vec3(std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e)) / (kPathPoints - 1);
    level = std::hypot(p.x(), p.y());
    b.path.push_back(p);
  }
  const float scale = reach / std::max(level, 0.45F);
  // A low branch does not sink into the ground.
  float deepest = 0;
  for (const Vec3& q : b.path) deepest = std::min(deepest, q.z() * scale);
  const float flatten =
      deepest < -0.6F * z - 0.06F * length_m ? (0.6F * z + 0.06F * length_m) / -deepest : 1.0F;
  for (Vec3& q : b.path) {
    q *= scale;
    if (q.z() < 0) q.z() *= flatten;
    q.z() += z;
  }
  b.length = 0;
  for (int i = 1; i < kPathPoints; ++i) b.length += (b.path[i] - b.path[i - 1]).norm();
  const Vec3 along = (b.path.back() - b.path.front()).normalized();
  const float roll = 0.25F * draws.spread(12, index);
  const Vec3 level_side = Vec3(std::sin(azimuth), -std::cos(azimuth), 0);
  b.up = level_side.cross(along).normalized();
  b.side = (std::cos(roll) * level_side + std::sin(roll) * b.up).normalized();
  b.up = b.side.cross(along).normalized();
  b.thickness = 0.006F + 0.0085F * b.length;
  return b;
}

Vec3 on_path(const Branch& b, float s) {
  const float f = std::clamp(s, 0.0F, 1.0F) * (kPathPoints - 1);
  const int i = std::min(kPathPoints - 2, static_cast<int>(f));
  return b.path[i] + (f - static_cast<float>(i)) * (b.path[i + 1] - b.path[i]);
}
Vec3 along_path(const Branch& b, float s) {
  const int i = std::min(kPathPoints - 2, static_cast<int>(std::clamp(s, 0.0F, 1.0F) * (kPathPoints - 1)));
  return (b.path[i + 1] - b.path[i]).normalized();
}

struct Crown {
  Habit habit;
  ClassSize size;
  int age_class;
  std::vector<Branch> branches;
  Branch leader;
  Draws draws;

  /// Which way the foliage around `p` faces: out of the crown, and up.
  [[nodiscard]] Vec3 outward(const Vec3& p, const Vec3& facing) const {
    const float r = std::hypot(p.x(), p.y());
    const float top = std::clamp(p.z() / size.crown_m, 0.0F, 1.0F);
    const Vec3 out = r > 1e-4F ? Vec3(p.x() / r, p.y() / r, 0.45F + 1.2F * top * top * top) : Vec3(0, 0, 1);
    return (0.72F * out.normalized() + 0.5F * facing).normalized();
  }
  [[nodiscard]] float sway(const Vec3& p) const {
    const float out = std::hypot(p.x(), p.y()) / size.radius_m, up = p.z() / size.crown_m;
    return std::clamp(0.35F * std::max(0.0F, up) * std::max(0.0F, up) + 0.65F * out, 0.0F, 1.0F);
  }
};

Crown plan(const CrownKey& key) {
  Crown c{habit_of(key.form, key.age_class),
          class_size(key.form, key.age_class),
          key.age_class,
          {},
          {},
          Draws("conifer_crown", static_cast<std::uint64_t>(key.form) * 64 +
                                     static_cast<std::uint64_t>(key.age_class) * 8 +
                                     static_cast<std::uint64_t>(key.variant))};
  const Habit& h = c.habit;
  constexpr int kBranches[kAgeClasses] = {30, 72, 120, 170, 220};
  const int n = static_cast<int>(static_cast<float>(kBranches[key.age_class]) * h.density);
  const float length = c.size.crown_m, leader = std::min(1.6F, 0.09F * length + 0.12F);
  const float stem = length - leader * (h.leader_bend > 1.5F ? 0.55F : 0.95F);
  for (int i = 0; i < n; ++i) {
    const auto k = static_cast<std::uint32_t>(i);
    const int whorl = i / h.whorl, arm = i % h.whorl;
    const float whorls = std::ceil(static_cast<float>(n) / static_cast<float>(h.whorl));
    const float u = (static_cast<float>(whorl) + 0.5F) / whorls;
    const float jitter = (h.whorl > 1 ? 0.35F : 0.9F) / whorls * c.draws.spread(1, k);
    const float t = std::clamp(1 - std::pow(1 - u, 1.3F) + jitter * (1 - 0.7F * u), 0.0F, 0.99F);
    const float azimuth = h.whorl > 1
                              ? kGoldenAngle * static_cast<float>(whorl) +
                                    2 * kPi * (static_cast<float>(arm) + 0.35F * c.draws.spread(2, k)) /
                                        static_cast<float>(h.whorl)
                              : kGoldenAngle * static_cast<float>(i) + 0.6F * c.draws.spread(2, k);
    // Raggedness: single branches, and whole sides at some heights.
    const float side = std::sin(azimuth + 7.0F * t + 6.28F * c.draws.uniform(90, 0)) *
                       std::sin(11.0F * t + 6.28F * c.draws.uniform(90, 1));
    float reach =
        c.size.radius_m * h.outline(t) * (1 + h.ragged * (0.8F * c.draws.spread(3, k) + 0.5F * side));
    reach = std::max(reach, 0.07F * c.size.radius_m + 0.07F);
    c.branches.push_back(
        make_branch(h, t, t * stem, azimuth, reach, 0.16F * c.draws.spread(4, k), length, c.draws, k));
  }
  // The leader: straight up, or nodding.
  Branch& l = c.leader;
  l.index = 5000, l.t = 1;
  Vec3 p(0, 0, 0);
  l.path.push_back(p);
  const float a = 2 * kPi * c.draws.uniform(5, 0);
  for (int i = 1; i < kPathPoints; ++i) {
    const float e =
        0.5F * kPi - h.leader_bend * std::pow((static_cast<float>(i) - 0.5F) / (kPathPoints - 1), 1.2F);
    p += Vec3(std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e)) * leader / (kPathPoints - 1);
    l.path.push_back(p);
  }
  float highest = 0;
  for (const Vec3& q : l.path) highest = std::max(highest, q.z());
  for (Vec3& q : l.path) q.z() += length - highest;
  l.length = leader, l.thickness = 0.012F;
  l.side = Vec3(-std::sin(a), std::cos(a), 0), l.up = Vec3(std::cos(a), std::sin(a), 0);
  return c;
}

void wood_of(MeshBuilder& out, const Crown& c, const Branch& b, int points) {
  std::vector<StemPoint> path;
  for (int i = 0; i < points; ++i) {
    const float s = static_cast<float>(i) / static_cast<float>(points - 1) * 0.92F;
    const Vec3 p = on_path(b, s);
    path.push_back({p, b.thickness * (1 - 0.9F * s), c.sway(p)});
  }
  out.tube(path, 3, 1.0F, 0.37F * static_cast<float>(b.index));
}

/// In the lowest third all but a branch's end lies in the shade of those above.
bool lower(const Crown& c, const Branch& b, float q) {
  return b.index != 5000 && b.t < 0.3F && q < 0.6F + 0.3F * c.draws.spread(29, b.index);
}

/// Foliage twig by twig on either side of a branch. `thin`: draws every so many-th pair alone, as much wider.
void twigs_of(MeshBuilder& out, const Crown& c, const Branch& b, float spacing_m, int most, int thin) {
  const float wider = thin > 1 ? (c.age_class == 0 ? 2.1F : c.habit.density < 0.7F ? 1.85F : 1.55F) : 1.0F;
  const Habit& h = c.habit;
  const float first = b.index == 5000 ? 0.1F : h.bare;
  const int pairs = std::clamp(static_cast<int>(std::lround(b.length * (1 - first) / spacing_m)), 3, most);
  for (int i = b.index % static_cast<unsigned>(thin); i < pairs; i += thin) {
    for (int arm = 0; arm < 2; ++arm) {
      const std::uint32_t item = static_cast<std::uint32_t>(2 * i + arm);
      const auto rnd = [&](std::uint32_t stream) { return c.draws.spread(20 + stream, b.index, item); };
      const float q = (static_cast<float>(i) + 0.5F + 0.45F * rnd(0)) / static_cast<float>(pairs);
      const float s = first + (1 - first) * q;
      const Vec3 base = on_path(b, s), along = along_path(b, s);
      const float f = arm ? 1.0F : -1.0F;
      const float lance = std::pow(std::sin(kPi * std::clamp(0.20F + 0.74F * q, 0.0F, 1.0F)), 0.7F);
      float length = h.twig_size * 1.4F * fan_of(h, b) * b.length * lance * (1 + 0.4F * rnd(1));
      length = std::max(length, std::min(b.index == 5000 ? 0.14F : 0.24F, 0.55F * b.length));
      const float angle = h.lateral_angle * (1 + 0.18F * rnd(2)) * (1 - 0.35F * q);
      Vec3 d = std::cos(angle) * along + f * std::sin(angle) * b.side;
      const float fall = h.lateral_fall * (0.7F + 0.6F * c.draws.uniform(24, b.index, item));
      d = (d - Vec3(0, 0, fall)).normalized();
      const float roll = h.roll * rnd(3);
      const Vec3 across = d.cross(b.up).normalized();
      const Vec3 up = (std::cos(roll) * across.cross(d) + std::sin(roll) * across).normalized();
      const Vec3 facing = up.dot(c.outward(base, Vec3(0, 0, 0.3F))) < 0 ? Vec3(-up) : up;
      const Vec3 tip = base + length * d;
      // Twigs in the shade, near the trunk and low under the bough, wear the darker pictures.
      const bool shaded = b.index != 5000 && q < 0.38F + 0.15F * rnd(4);
      const int cell = static_cast<int>(4 * c.draws.uniform(25, b.index, item));
      out.set_inner(shaded || lower(c, b, q));
      out.card(base, length * d, facing, 0.205F * wider * length, cell, c.outward(base, facing),
               c.outward(tip, facing), c.sway(base), c.sway(tip));
      if (c.draws.uniform(26, b.index, item) < h.second_layer / static_cast<float>(thin)) {
        // A second spray from the same place, hanging under the first or standing on it.
        const float drop = 0.55F + 0.5F * c.draws.uniform(27, b.index, item);
        Vec3 e = (d + (h.lateral_fall >= 0 ? -drop : drop) * Vec3(0, 0, 1) + 0.5F * along).normalized();
        const float l = 0.75F * length;
        const Vec3 cross = e.cross(d).squaredNorm() > 1e-4F ? e.cross(d).normalized() : square_to(e);
        const Vec3 face2 = cross.dot(c.outward(base, Vec3::Zero())) < 0 ? Vec3(-cross) : cross;
        out.set_inner(b.index != 5000 && q < 0.75F);
        out.card(base, l * e, face2, 0.27F * l, 2 + static_cast<int>(2 * c.draws.uniform(28, b.index, item)),
                 c.outward(base, face2), c.outward(base + l * e, face2), c.sway(base), c.sway(base + l * e));
      }
    }
  }
  out.set_inner(false);
  const Vec3 end = on_path(b, 0.86F), along = along_path(b, 0.95F);
  const float length = 0.14F * b.length + std::max(0.12F, 0.9F * h.fan * 0.3F * b.length);
  for (int k = 0; k < 2; ++k) {
    const Vec3 up = k ? b.side : b.up;
    const Vec3 facing = up.dot(c.outward(end, Vec3(0, 0, 0.2F))) < 0 ? Vec3(-up) : up;
    if (k && b.index != 5000 && b.length > 1.0F) break;
    out.card(end, length * along, facing, (b.index == 5000 ? 0.13F : 0.25F) * length, k,
             c.outward(end, facing), c.outward(end + length * along, facing), c.sway(end),
             c.sway(end + length * along));
  }
}

/// Coarse foliage: one picture of a whole bough, bent along the branch.
void bough_of(MeshBuilder& out, const Crown& c, const Branch& b, int segments, float width_scale) {
  const Habit& h = c.habit;
  const float first = 0.6F * h.bare;
  out.set_inner(b.index % 2 == 1 && lower(c, b, 0.5F));
  if (segments == 0) {
    const Vec3 base = on_path(b, first), along = 1.06F * (b.path.back() - base),
               up = b.up.z() < 0 ? Vec3(-b.up) : b.up;
    const float half = std::max(0.05F, 1.15F * fan_of(h, b) * b.length) * width_scale;
    // Tilted a little to one side or the other: from the side a level card is not there.
    const Vec3 leaning = (up + (b.index % 3 ? 0.6F : -0.6F) * b.side).normalized();
    out.card(base, along, leaning, half, kBoughCell, c.outward(base, up), c.outward(base + along, up),
             c.sway(base), c.sway(base + along));
    return;
  }
  std::vector<MeshBuilder::BoughPoint> path;
  for (int i = 0; i <= segments; ++i) {
    const float s = first + (1.06F - first) * static_cast<float>(i) / static_cast<float>(segments);
    Vec3 p = on_path(b, s);
    if (s > 1) p += (s - 1) * b.length * along_path(b, 1);
    const Vec3 normal = c.outward(p, b.up.z() < 0 ? Vec3(-b.up) : b.up);
    path.push_back(
        {p, b.side, b.up, normal, std::max(0.05F, 1.15F * fan_of(h, b) * b.length) * width_scale, c.sway(p)});
  }
  out.bough(path, std::clamp(0.25F + 0.7F * h.lateral_fall + 0.25F * h.second_layer, 0.15F, 1.0F), kBoughCell,
            b.index % 2 == 1);
}

}  // namespace

CrownMeshes make_conifer_crown(const CrownKey& key) {
  const Crown c = plan(key);
  const FoliageSurface& foliage = foliage_surface(key.form);
  const auto bark = bark_surface(key.bark);
  CrownMeshes out;
  out.length_m = c.size.crown_m;

  constexpr float kSpacing_m[kAgeClasses] = {0.08F, 0.11F, 0.15F, 0.19F, 0.23F};
  constexpr int kMostPairs[kAgeClasses] = {5, 8, 11, 13, 11};
  MeshBuilder fine;
  fine.set_coverage(foliage.coverage);
  for (const Branch& b : c.branches) {
    wood_of(fine, c, b, b.length > 0.9F ? 3 : 2);
    twigs_of(fine, c, b, kSpacing_m[key.age_class], kMostPairs[key.age_class], 1);
  }
  wood_of(fine, c, c.leader, 4);
  twigs_of(fine, c, c.leader, 0.5F * kSpacing_m[key.age_class], 6, 1);
  const float leaf_area = fine.leaf_area_m2();
  out.half_width_m.push_back(fine.mean_half_width_m());
  out.levels.push_back(fine.finish(bark, foliage.surface, foliage.inner));

  MeshBuilder half;
  for (const Branch& b : c.branches) {
    if (b.length > 1.0F) wood_of(half, c, b, 2);
    twigs_of(half, c, b, kSpacing_m[key.age_class], kMostPairs[key.age_class], 2);
  }
  twigs_of(half, c, c.leader, 0.5F * kSpacing_m[key.age_class], 6, 2);
  out.half_width_m.push_back(half.mean_half_width_m());
  out.levels.push_back(half.finish(bark, foliage.surface, foliage.inner));

  struct Level {
    int every, segments;  ///< 0: one flat card
    float area;           ///< share of the leaf area that it keeps: larger cards hide less of one another
  };
  constexpr Level kLevels[kCrownLevels - 2] = {{1, 2, 0.8F}, {2, 1, 0.95F}, {4, 0, 1.7F}};
  // Where branches hide little of one another, less must not be left out.
  const float sparse = key.age_class == 0 || key.form == TreeForm::pine ? 1.4F : 1.0F;
  for (const Level& level : kLevels) {
    const auto build = [&](MeshBuilder& mesh, float width_scale) {
      mesh.set_coverage(foliage.coverage);
      // One of each few, by lot: at equal steps the spiral of the branches would show.
      // A sapling or a pine has few branches to leave out.
      const int most =
          std::min(key.age_class, c.habit.density < 0.7F ? 0 : kAgeClasses) + 1 + (level.segments == 0);
      const auto step = static_cast<std::size_t>(std::min(level.every, most));
      for (std::size_t i = 0; i < c.branches.size(); i += step) {
        const auto lot = static_cast<std::size_t>(c.draws.uniform(50, static_cast<std::uint32_t>(i)) *
                                                  static_cast<float>(step));
        bough_of(mesh, c, c.branches[std::min(i + lot, c.branches.size() - 1)], level.segments, width_scale);
      }
      bough_of(mesh, c, c.leader, std::min(2, level.segments), 1.0F);
    };
    MeshBuilder trial;
    build(trial, 1.0F);
    MeshBuilder mesh;
    build(mesh, std::clamp(sparse * level.area * leaf_area / trial.leaf_area_m2(), 0.6F,
                           level.segments > 0 ? 2.4F : 4.0F));
    out.half_width_m.push_back(mesh.mean_half_width_m());
    out.levels.push_back(mesh.finish(bark, foliage.surface, foliage.inner));
  }
  return out;
}

}  // namespace rigor::nature
