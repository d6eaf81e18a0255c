#include <algorithm>
#include <cmath>
#include <map>
#include <mutex>
#include <numbers>
#include <string>

#include "sim/nature/trees/crown_levels.h"

namespace rigor::nature {
namespace {

constexpr float kTurn_rad = 2 * std::numbers::pi_v<float>;
constexpr float kBreast_m = 1.3F;
constexpr float kClassDbh_m[kAgeClasses] = {0.02F, 0.08F, 0.20F, 0.42F, 0.95F};

/// A trunk as a surface over (height, angle).
struct TrunkShape {
  TrunkKey key;
  Draws draws;
  float length_m, height_m, dbh_m, taper, flare, flare_m, flutes, lean_m;

  [[nodiscard]] float mean_radius(float z) const {
    const float breast = std::min(kBreast_m, 0.4F * height_m);
    float left = std::max(0.0F, (height_m - z) / (height_m - breast));
    const float body = 0.5F * dbh_m * std::pow(left, taper);
    return body +
           0.5F * dbh_m * flare * (std::exp(-std::max(z, 0.0F) / flare_m) - std::exp(-breast / flare_m));
  }
  [[nodiscard]] float radius(float z, float angle) const {
    const float low = std::exp(-std::max(z, 0.0F) / (1.4F * flare_m));
    float lobes = 0;
    for (int k = 0; k < 3; ++k) {
      const auto n = static_cast<std::uint32_t>(k);
      lobes += std::cos(static_cast<float>(3 + 2 * k) * angle + kTurn_rad * draws.uniform(1, n)) *
               (0.6F - 0.15F * static_cast<float>(k));
    }
    const float ripple = flutes * std::cos(9 * angle + kTurn_rad * draws.uniform(1, 7)) *
                         std::exp(-std::max(z, 0.0F) / (5 * flare_m));
    return mean_radius(z) * (1 + 0.26F * flare * low * lobes + ripple);
  }
  /// The axis wanders, and returns to the middle at both ends.
  [[nodiscard]] Vec3 axis(float z) const {
    const float s = std::clamp(z / length_m, 0.0F, 1.0F), envelope = std::sin(0.5F * kTurn_rad * s) * lean_m;
    return {envelope * (std::cos(kTurn_rad * (s * 1.3F + draws.uniform(2, 0))) + 0.6F * draws.spread(2, 1)),
            envelope * (std::sin(kTurn_rad * (s * 1.1F + draws.uniform(2, 2))) + 0.6F * draws.spread(2, 3)),
            z};
  }
  [[nodiscard]] Vec3 point(float z, float angle, float swell = 1) const {
    const float r = radius(z, angle) * swell;
    return axis(z) + Vec3(r * std::cos(angle), r * std::sin(angle), 0);
  }
};

TrunkShape shape_of(const TrunkKey& key) {
  TrunkShape s{
      key,
      Draws("trunk",
            static_cast<std::uint64_t>(key.kind) * 4096 + static_cast<std::uint64_t>(key.bark) * 256 +
                static_cast<std::uint64_t>(key.age_class) * 16 + static_cast<std::uint64_t>(key.variant)),
      0,
      0,
      0,
      0,
      0,
      0,
      0,
      0};
  s.height_m = static_cast<float>(class_height_m(key.age_class));
  s.dbh_m = kClassDbh_m[key.age_class];
  const float old = static_cast<float>(key.age_class) / (kAgeClasses - 1);
  s.taper = key.bark == BarkStyle::fibrous ? 1.0F : key.bark == BarkStyle::ridged ? 0.72F : 0.8F;
  s.flare = (key.bark == BarkStyle::fibrous     ? 0.75F
             : key.kind == TrunkKind::broadleaf ? 0.5F
                                                : 0.4F) *
            (0.4F + 0.6F * old);
  s.flare_m = 0.12F + 0.75F * s.dbh_m;
  s.flutes = key.bark == BarkStyle::fibrous ? 0.07F * old : 0.015F;
  s.lean_m = (key.kind == TrunkKind::broadleaf ? 0.9F : 0.35F) * 0.5F * s.dbh_m;
  s.length_m = s.height_m * 0.985F;
  if (key.kind == TrunkKind::broadleaf) {
    s.taper = 0.75F;
    s.length_m = 0.68F * s.height_m;
  } else if (key.kind == TrunkKind::snag) {
    s.taper = 0.6F;
    s.length_m = (0.55F + 0.2F * s.draws.uniform(3, 0)) * s.height_m;
  }
  return s;
}

std::vector<float> ring_heights(const TrunkShape& s, int level) {
  std::vector<float> z;
  const float low = std::min(1.0F, s.height_m / 12);
  static constexpr float kNear[] = {0, 0.12F, 0.3F, 0.6F, 1.0F, 1.6F, 2.4F},
                         kMiddle[] = {0, 0.35F, 1.0F, 2.2F}, kFar[] = {0, 1.0F};
  const auto base = level == 0   ? std::span<const float>(kNear)
                    : level == 1 ? std::span<const float>(kMiddle)
                                 : std::span<const float>(kFar);
  z.push_back(-0.5F * s.dbh_m - 0.1F);
  for (const float b : base) z.push_back(b * low);
  constexpr int kMore[4] = {12, 6, 3, 1};
  const float from = z.back();
  for (int i = 1; i <= kMore[level]; ++i) {
    const float f = static_cast<float>(i) / static_cast<float>(kMore[level]);
    z.push_back(from + (s.length_m - from) * f);
  }
  return z;
}

struct TrunkLevel {
  std::vector<float> heights;
  int sides;
  std::vector<std::vector<Vec3>> rings;
};
/// Polygons lie on both sides of the circle, so that the mean radius stays.
TrunkLevel level_of(const TrunkShape& s, int level) {
  constexpr int kSides[4] = {16, 10, 6, 4}, kThinSides[4] = {8, 6, 4, 3};
  TrunkLevel out{ring_heights(s, level), s.key.age_class < 2 ? kThinSides[level] : kSides[level], {}};
  const float swell = 2 / (1 + std::cos(kTurn_rad / 2 / static_cast<float>(out.sides)));
  const bool broken = s.key.kind == TrunkKind::snag;
  for (std::size_t i = 0; i < out.heights.size(); ++i) {
    std::vector<Vec3> ring;
    for (int k = 0; k < out.sides; ++k) {
      const float a = kTurn_rad * static_cast<float>(k) / static_cast<float>(out.sides);
      Vec3 p = s.point(out.heights[i], a, swell);
      if (broken && i + 1 == out.heights.size())
        p.z() -=
            s.mean_radius(s.length_m) *
            (0.2F + 1.8F * std::pow(0.5F + 0.5F * std::sin(a + kTurn_rad * s.draws.uniform(4, 0)), 2.0F) +
             0.8F * s.draws.uniform(4, 1 + static_cast<std::uint32_t>(k)));
      ring.push_back(p);
    }
    out.rings.push_back(std::move(ring));
  }
  return out;
}
Vec3 on_level(const TrunkLevel& l, float z, float angle) {
  std::size_t i = 0;
  while (i + 2 < l.heights.size() && l.heights[i + 1] < z) ++i;
  const float f = std::clamp((z - l.heights[i]) / (l.heights[i + 1] - l.heights[i]), 0.0F, 1.0F);
  const float turn = angle / kTurn_rad * static_cast<float>(l.sides);
  const int k = static_cast<int>(turn) % l.sides;
  const float g = turn - std::floor(turn);
  const auto at = [&](std::size_t ring) {
    return Vec3(l.rings[ring][k] + g * (l.rings[ring][(k + 1) % l.sides] - l.rings[ring][k]));
  };
  return at(i) + f * (at(i + 1) - at(i));
}

void add_trunk(MeshBuilder& out, const TrunkShape& s, const TrunkLevel& l) {
  const float repeats = std::max(1.0F, std::round(kTurn_rad * 0.5F * s.dbh_m / kBarkWidth_m));
  const std::size_t rings = l.rings.size();
  const bool pointed = s.key.kind != TrunkKind::snag;
  std::vector<std::uint32_t> previous;
  const auto centre = [](const std::vector<Vec3>& ring) {
    Vec3 c = Vec3::Zero();
    for (const Vec3& p : ring) c += p;
    return Vec3(c / static_cast<float>(ring.size()));
  };
  const auto sway = [&](float z) { return std::pow(std::clamp(z / s.height_m, 0.0F, 1.0F), 2.0F) * 0.35F; };
  for (std::size_t i = 0; i < rings; ++i) {
    const bool tip = pointed && i + 1 == rings;
    std::vector<std::uint32_t> ring;
    const Vec3 middle = centre(l.rings[i]);
    for (int k = 0; k <= l.sides; ++k) {
      const int next = (k + 1) % l.sides, here = k % l.sides, before = (k + l.sides - 1) % l.sides;
      const std::size_t up = std::min(i + 1, rings - 1), down = i > 0 ? i - 1 : 0;
      const Vec3 around = l.rings[i][next] - l.rings[i][before],
                 along = l.rings[up][here] - l.rings[down][here];
      Vec3 n = around.cross(along);
      const Vec3 out_of = l.rings[i][here] - middle;
      n = n.squaredNorm() > 1e-18F        ? Vec3(n.normalized())
          : out_of.squaredNorm() > 1e-18F ? Vec3(out_of.normalized())
                                          : Vec3(0, 0, 1);
      const float f = static_cast<float>(k) / static_cast<float>(l.sides);
      const Vec3 p = tip ? middle : l.rings[i][here];
      ring.push_back(out.wood_vertex(p, n, f * repeats, l.heights[i] / kBarkHeight_m, sway(p.z())));
    }
    for (int k = 0; k < l.sides && i > 0; ++k) {
      out.wood_triangle(previous[k], previous[k + 1], ring[k + 1]);
      if (!tip) out.wood_triangle(previous[k], ring[k + 1], ring[k]);
    }
    previous = std::move(ring);
  }
  const auto cap = [&](const std::vector<Vec3>& ring, const Vec3& middle, bool top) {
    const Vec3 n(0, 0, top ? 1.0F : -1.0F);
    const std::uint32_t c = out.wood_vertex(middle, n, 0, 0, sway(middle.z()));
    std::vector<std::uint32_t> rim;
    for (const Vec3& p : ring)
      rim.push_back(out.wood_vertex(p, n, (p.x() - middle.x()) / kBarkWidth_m,
                                    (p.y() - middle.y()) / kBarkHeight_m, sway(p.z())));
    for (std::size_t k = 0; k < rim.size(); ++k)
      top ? out.wood_triangle(c, rim[k], rim[(k + 1) % rim.size()])
          : out.wood_triangle(c, rim[(k + 1) % rim.size()], rim[k]);
  };
  cap(l.rings.front(), centre(l.rings.front()), false);
  if (!pointed)
    cap(l.rings.back(), centre(l.rings.back()) - Vec3(0, 0, 0.6F * s.mean_radius(s.length_m)), true);
}

/// What is left of a dead tree's branches.
void add_stubs(MeshBuilder& out, const TrunkShape& s, int every) {
  const int count = 8 + 8 * s.key.age_class;
  for (int i = 0; i < count; i += every) {
    const auto k = static_cast<std::uint32_t>(i);
    const float z = s.length_m * (0.25F + 0.72F * (static_cast<float>(i) + s.draws.uniform(10, k)) /
                                              static_cast<float>(count));
    const float a = 2.39996F * static_cast<float>(i) + s.draws.spread(11, k);
    const float r = s.mean_radius(z);
    const float length =
        (0.25F + 1.1F * std::pow(s.draws.uniform(12, k), 2.0F)) * (0.3F + 0.055F * s.height_m);
    const Vec3 from = s.axis(z) + 0.6F * r * Vec3(std::cos(a), std::sin(a), 0);
    Vec3 d(std::cos(a), std::sin(a), 0.1F + 0.3F * s.draws.spread(13, k));
    d.normalize();
    const float thick = std::min(0.3F * r, 0.008F + 0.02F * length);
    const StemPoint path[] = {{from, thick, 0.1F},
                              {from + 0.5F * length * d + Vec3(0, 0, 0.03F * length), 0.7F * thick, 0.15F},
                              {from + length * d - Vec3(0, 0, 0.10F * length), 0, 0.2F}};
    out.tube(path, 3, 1, static_cast<float>(i));
  }
}

TrunkPrototype make(const TrunkKey& key) {
  const TrunkShape s = shape_of(key);
  TrunkPrototype out;
  out.length_m = s.length_m;
  auto prototype = std::make_shared<render::Prototype>();
  static constexpr const char* kKinds[] = {"conifer trunk", "broadleaf trunk", "snag"};
  prototype->name = std::string(kKinds[static_cast<int>(key.kind)]) + " " +
                    std::to_string(static_cast<int>(key.bark)) + "/" + std::to_string(key.age_class) + "/" +
                    std::to_string(key.variant);
  prototype->sway_m = 0.4F;
  prototype->occludes = key.age_class >= 3;
  const TrunkLevel fine = level_of(s, 0);
  const auto bark = bark_surface(key.bark);
  for (int level = 0; level < 4; ++level) {
    const TrunkLevel l = level_of(s, level);
    MeshBuilder mesh;
    add_trunk(mesh, s, l);
    if (key.kind == TrunkKind::snag && level < 3) add_stubs(mesh, s, 1 + level);
    float error = 0;
    if (level > 0) {
      for (std::size_t i = 0; i < fine.rings.size(); ++i)
        for (int k = 0; k < fine.sides; ++k) {
          const float a = kTurn_rad * static_cast<float>(k) / static_cast<float>(fine.sides);
          // Below the ground nothing is seen; at a broken top the jags are, but they are within a radius.
          if (fine.heights[i] >= 0)
            error = std::max(error,
                             (on_level(l, fine.heights[i], a) - on_level(fine, fine.heights[i], a)).norm());
        }
      error = std::max(error, prototype->levels.back().error_m * 1.01F);
    }
    prototype->levels.push_back({mesh.finish(bark, nullptr), error});
  }
  for (std::size_t i = 0; i < fine.rings.size(); ++i) {
    Vec3 c = Vec3::Zero();
    for (const Vec3& p : fine.rings[i]) c += p / static_cast<float>(fine.sides);
    float mean = 0;
    for (const Vec3& p : fine.rings[i])
      mean += std::hypot(p.x() - c.x(), p.y() - c.y()) / static_cast<float>(fine.sides);
    const bool tip = i + 1 == fine.rings.size() && key.kind != TrunkKind::snag;
    out.z_m.push_back(fine.heights[i]);
    out.radius_m.push_back(tip ? 0.0F : mean);
    out.axis_m.emplace_back(c.x(), c.y());
  }
  out.prototype = prototype;
  return out;
}

}  // namespace

float TrunkPrototype::radius_at(float z) const noexcept {
  std::size_t i = 0;
  while (i + 2 < z_m.size() && z_m[i + 1] < z) ++i;
  const float f = std::clamp((z - z_m[i]) / (z_m[i + 1] - z_m[i]), 0.0F, 1.0F);
  return radius_m[i] + f * (radius_m[i + 1] - radius_m[i]);
}

Eigen::Vector2f TrunkPrototype::axis_at(float z) const noexcept {
  std::size_t i = 0;
  while (i + 2 < z_m.size() && z_m[i + 1] < z) ++i;
  const float f = std::clamp((z - z_m[i]) / (z_m[i + 1] - z_m[i]), 0.0F, 1.0F);
  return axis_m[i] + f * (axis_m[i + 1] - axis_m[i]);
}

const TrunkPrototype& trunk_prototype(const TrunkKey& key) {
  static std::mutex mutex;
  static std::map<TrunkKey, TrunkPrototype> made;  // nodes of a map stay where they are
  const std::scoped_lock lock(mutex);
  const auto found = made.find(key);
  return found != made.end() ? found->second : made.emplace(key, make(key)).first->second;
}

}  // namespace rigor::nature
