// Whether a shadow map can be used again. What stands still throws the same shadows into the same square of a
// cascade, wherever the eye is. Internal to sim/render/view.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "sim/render/view/culling.h"
#include "sim/render/view/shadow_cascades.h"

namespace rigor::render {

class KeptShadow {
 public:
  enum class Use : std::uint8_t {
    none,  ///< the square, or what stands still in it, is new: draw what shades what is looked at
    fill,  ///< the last picture wanted the same: draw all of the square that stands still, and keep it
    again  ///< what is kept is right for what is looked at
  };
  /// Of the next picture. What is to be filled counts as kept from here on.
  [[nodiscard]] Use next(const ShadowCascade& cascade, std::span<const ResidentBatch* const> batches,
                         const CullOptions& options);
  /// Nothing is kept.
  void forget() { *this = {}; }

 private:
  struct Content {
    bool any = false;
    std::array<double, 16> square{};  ///< what a map is a function of, beside its casters
    struct Caster {
      std::uint64_t serial = 0;
      Eigen::Vector3d centre;
      double radius_m = 0;
    };
    std::vector<Caster> still;  ///< all that reach the square, by serial
    [[nodiscard]] bool has(std::uint64_t serial) const;
  };
  /// Whether both have the same casters where `cascade` looks.
  [[nodiscard]] static bool same(const ShadowCascade& cascade, const Content& kept, const Content& now);

  Content kept_, last_;
};

}  // namespace rigor::render
