// Prototypes of trees: trunks and crowns, which are scaled apart so that diameter, height and crown of every
// tree are its own.
//
//   const CrownPrototype& crown = crown_prototype({TreeForm::hemlock, BarkStyle::scaly, 3, 0});
//   const TrunkPrototype& trunk = trunk_prototype({TrunkKind::conifer, BarkStyle::scaly, 3, 1});
//
// A crown stands with its base at z = 0, its axis along z, and is `length_m` high; a trunk stands on the
// ground. Both are made from counter-based numbers when first asked for, and kept: the same key gives the
// same object, on any thread.
//
// error_m of foliage levels: leaves stand by chance, so that moving one by the distance to its neighbour
// changes nothing that is seen; what is seen is that cards are flat, and that gaps close. What is stated is a
// twentieth of the mean half width of a level's cards and an eighth of the root mean square distance from
// points of the finest level's foliage to the level's surface, both measured when the prototype is made; the
// shares set where levels change; between neighbouring levels single leaves differ. For trunks it is the
// largest deviation.
#pragma once

#include <memory>
#include <set>

#include "sim/nature/trees/allometry.h"
#include "sim/render/content/content.h"

namespace rigor::nature {

/// Sapling, pole, young, mature, old.
inline constexpr int kAgeClasses = 5;
inline constexpr int kCrownVariants = 3, kTrunkVariants = 2;
/// The class of a height; `boundary` at geometric means of neighbouring classes' heights.
[[nodiscard]] int age_class_of(double height_m) noexcept;
/// Height of the trees that a class was drawn for, m.
[[nodiscard]] double class_height_m(int age_class) noexcept;

struct CrownKey {
  TreeForm form = TreeForm::fir;
  BarkStyle bark = BarkStyle::scaly;
  int age_class = 0, variant = 0;
  auto operator<=>(const CrownKey&) const = default;
};
struct CrownPrototype {
  std::shared_ptr<const render::Prototype> prototype;
  float length_m = 1, radius_m = 1;  ///< at scale 1: from base to top; reach of 98 % of the foliage
};

enum class TrunkKind : unsigned char {
  conifer,    ///< to the top
  broadleaf,  ///< ends among its limbs
  snag        ///< dead: broken top, stubs of branches
};
struct TrunkKey {
  TrunkKind kind = TrunkKind::conifer;
  BarkStyle bark = BarkStyle::scaly;
  int age_class = 0, variant = 0;
  auto operator<=>(const TrunkKey&) const = default;
};
struct TrunkPrototype {
  std::shared_ptr<const render::Prototype> prototype;
  float length_m = 1;                   ///< at scale 1
  std::vector<float> z_m, radius_m;     ///< mean radius of the finest level's rings, upwards
  std::vector<Eigen::Vector2f> axis_m;  ///< their middles
  /// Mean radius, middle at a height, linear between rings.
  [[nodiscard]] float radius_at(float z_m) const noexcept;
  [[nodiscard]] Eigen::Vector2f axis_at(float z_m) const noexcept;
};

[[nodiscard]] const CrownPrototype& crown_prototype(const CrownKey& key);
/// Makes those that are not there yet, on several threads.
void make_crowns(const std::set<CrownKey>& keys);
[[nodiscard]] const TrunkPrototype& trunk_prototype(const TrunkKey& key);

/// Where a broadleaved trunk ends: this share of the crown's length above its base.
[[nodiscard]] double trunk_share_of_crown(TreeForm form) noexcept;

}  // namespace rigor::nature
