#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <mutex>
#include <string>

#include "sim/nature/trees/crown_levels.h"
#include "sim/nature/trees/tree_textures.h"
#include "sim/render/content/surface_library.h"

namespace rigor::nature {
namespace {

constexpr double kClassHeight_m[kAgeClasses] = {1.6, 5, 12, 24, 44};

/// Shares of the width of cards and of the distance between levels that the eye can tell.
constexpr float kWidthSeen = 0.05F, kDistanceSeen = 0.12F;

/// Square of the distance from p to a triangle (Ericson, Real-Time Collision Detection, 5.1.5).
float distance2(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a, ap = p - a;
  const float d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return ap.squaredNorm();
  const Vec3 bp = p - b;
  const float d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0 && d4 <= d3) return bp.squaredNorm();
  const float vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return (ap - d1 / (d1 - d3) * ab).squaredNorm();
  const Vec3 cp = p - c;
  const float d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0 && d5 <= d6) return cp.squaredNorm();
  const float vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return (ap - d2 / (d2 - d6) * ac).squaredNorm();
  const float va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0)
    return (bp - (d4 - d3) / (d4 - d3 + d5 - d6) * (c - b)).squaredNorm();
  const float sum = va + vb + vc;
  if (!(sum > 0)) return ap.squaredNorm();
  return (ap - vb / sum * ab - vc / sum * ac).squaredNorm();
}
Vec3 corner(const render::Mesh& m, std::size_t index) {
  const render::Vertex& v = m.vertices[m.indices[index]];
  return {v.position[0], v.position[1], v.position[2]};
}
/// The parts of leaves follow each other at the end.
struct Range {
  std::uint32_t first_index, index_count;
};
Range foliage_of(const render::Mesh& m) {
  std::uint32_t first = m.parts.back().first_index;
  for (const render::MeshPart& p : m.parts)
    if (p.surface->alpha_cutoff > 0) first = std::min(first, p.first_index);
  return {first, static_cast<std::uint32_t>(m.indices.size()) - first};
}

/// Root mean square distance from points of the finest foliage to a coarser level's.
float foliage_error(const render::Mesh& fine, const render::Mesh& coarse) {
  constexpr std::size_t kSamples = 160;
  const Range f = foliage_of(fine), c = foliage_of(coarse);
  const std::size_t triangles = f.index_count / 3, samples = std::min(kSamples, triangles);
  // A triangle whose sphere is farther than the nearest one so far is not asked.
  struct Sphere {
    Vec3 middle;
    float radius;
  };
  std::vector<Sphere> spheres;
  for (std::uint32_t k = c.first_index; k < c.first_index + c.index_count; k += 3) {
    const Vec3 middle = (corner(coarse, k) + corner(coarse, k + 1) + corner(coarse, k + 2)) / 3;
    float radius = 0;
    for (std::uint32_t n = k; n < k + 3; ++n) radius = std::max(radius, (corner(coarse, n) - middle).norm());
    spheres.push_back({middle, 1.0001F * radius + 1e-5F});
  }
  double sum = 0;
  for (std::size_t i = 0; i < samples; ++i) {
    const std::size_t t = f.first_index + 3 * (i * triangles / samples);
    const Vec3 p = (corner(fine, t) + corner(fine, t + 1) + corner(fine, t + 2)) / 3;
    float least = 1e9F;
    float reach = std::numeric_limits<float>::infinity();  // a little more than to the nearest so far
    for (std::size_t n = 0; n < spheres.size(); ++n) {
      const float beyond = reach + spheres[n].radius;
      if ((p - spheres[n].middle).squaredNorm() > beyond * beyond) continue;
      const std::size_t k = c.first_index + 3 * n;
      const float d2 = distance2(p, corner(coarse, k), corner(coarse, k + 1), corner(coarse, k + 2));
      if (d2 >= least) continue;
      least = d2;
      reach = 1.0001F * std::sqrt(d2) + 1e-5F;
    }
    sum += least;
  }
  return static_cast<float>(std::sqrt(sum / static_cast<double>(samples)));
}

CrownPrototype make(const CrownKey& key) {
  CrownMeshes crown = is_conifer(key.form) ? make_conifer_crown(key) : make_broadleaf_crown(key);
  CrownPrototype out;
  out.length_m = crown.length_m;
  std::vector<float> reach;
  const render::Mesh& fine = *crown.levels.front();
  const Range leaves = foliage_of(fine);
  for (std::uint32_t k = leaves.first_index; k < leaves.first_index + leaves.index_count; ++k)
    reach.push_back(corner(fine, k).head<2>().norm());
  const auto at = reach.begin() + static_cast<std::ptrdiff_t>(0.98 * static_cast<double>(reach.size() - 1));
  std::nth_element(reach.begin(), at, reach.end());
  out.radius_m = *at;

  auto prototype = std::make_shared<render::Prototype>();
  static constexpr const char* kForms[kTreeFormCount] = {"spruce", "fir",   "hemlock", "douglas fir",
                                                         "cedar",  "yew",   "pine",    "larch",
                                                         "oak",    "beech", "birch",   "shrub"};
  prototype->name = std::string(kForms[static_cast<int>(key.form)]) + " crown " +
                    std::to_string(key.age_class) + "/" + std::to_string(key.variant);
  prototype->impostor = true;
  prototype->sway_m = 0.10F + 0.03F * out.radius_m;
  float last = 0;
  for (std::size_t i = 0; i < crown.levels.size(); ++i) {
    const float seen = kWidthSeen * crown.half_width_m[i] +
                       kDistanceSeen * (i == 0 ? 0.0F : foliage_error(fine, *crown.levels[i]));
    const float error = i == 0 ? 0.0F : std::max(1.05F * last, seen);
    prototype->levels.push_back({crown.levels[i], error});
    last = error;
  }
  out.prototype = prototype;
  return out;
}

}  // namespace

int age_class_of(double height_m) noexcept {
  int c = 0;
  while (c + 1 < kAgeClasses && height_m * height_m > kClassHeight_m[c] * kClassHeight_m[c + 1]) ++c;
  return c;
}
double class_height_m(int age_class) noexcept { return kClassHeight_m[age_class]; }

ClassSize class_size(TreeForm form, int age_class) noexcept {
  constexpr float kRatio[kAgeClasses] = {0.92F, 0.85F, 0.75F, 0.65F, 0.60F};
  // Crown radius of a conifer and of a broadleaf of that height in a stand, m.
  constexpr float kConifer_m[kAgeClasses] = {0.45F, 1.1F, 1.9F, 2.9F, 4.2F},
                  kBroad_m[kAgeClasses] = {0.6F, 1.5F, 2.6F, 4.4F, 7.0F};
  float width = 1;
  if (form == TreeForm::fir) width = 0.85F;
  if (form == TreeForm::yew) width = 1.6F;
  if (form == TreeForm::oak || form == TreeForm::shrub) width = 1.15F;
  if (form == TreeForm::birch) width = 0.8F;
  const float height = static_cast<float>(kClassHeight_m[age_class]);
  return {height, height * kRatio[age_class], width * (is_conifer(form) ? kConifer_m : kBroad_m)[age_class]};
}

double trunk_share_of_crown(TreeForm form) noexcept {
  switch (form) {
    case TreeForm::oak:
      return 0.25;
    case TreeForm::birch:
      return 0.7;
    case TreeForm::shrub:
      return 0.1;
    default:
      return 0.45;
  }
}

const CrownPrototype& crown_prototype(const CrownKey& key) {
  struct Slot {
    std::once_flag once;
    CrownPrototype value;
  };
  static std::mutex mutex;
  static std::map<CrownKey, Slot> slots;  // nodes of a map stay where they are
  Slot* slot = nullptr;
  {
    const std::scoped_lock lock(mutex);
    slot = &slots[key];
  }
  std::call_once(slot->once, [&] { slot->value = make(key); });
  return slot->value;
}

void make_crowns(const std::set<CrownKey>& keys) {
  std::set<TreeForm> forms;
  std::set<BarkStyle> barks;
  for (const CrownKey& k : keys) {
    forms.insert(k.form);
    barks.insert(k.bark);
  }
  static_cast<void>(render::SurfaceLibrary::builtin());  // made at its first call
  // Crowns share their pictures.
  std::vector<std::function<void()>> pictures;
  for (const TreeForm form : forms)
    pictures.emplace_back([form] { static_cast<void>(foliage_surface(form)); });
  for (const BarkStyle bark : barks) pictures.emplace_back([bark] { static_cast<void>(bark_surface(bark)); });
  render::make_in_parallel(pictures.size(), [&](std::size_t i) { pictures[i](); });
  const std::vector<CrownKey> all(keys.begin(), keys.end());
  render::make_in_parallel(all.size(), [&](std::size_t i) { static_cast<void>(crown_prototype(all[i])); });
}

}  // namespace rigor::nature
