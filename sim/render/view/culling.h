// Which instances are drawn, at which level of detail, in which order. Internal to sim/render/view.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "sim/render/view/occlusion.h"
#include "sim/render/view/resident_content.h"
#include "sim/render/view/shadow_cascades.h"
#include "sim/render/view/view_camera.h"

namespace rigor::render {

struct ImpostorAtlas;

struct CullOptions {
  bool frustum = true, levels = true, impostors = true;
  double allowed_error_px = 1;
  double sway_factor = 0;  ///< metres of sway for one metre at 10 m/s
  /// Null where a prototype has no impostor. May bake one.
  std::function<const ImpostorAtlas*(const ResidentPrototype&)> impostor{};
};

/// An instance that is seen.
struct Visible {
  const ResidentBatch* batch = nullptr;
  std::uint32_t index = 0;
  float distance_m = 0;
};

/// Instances of one prototype at one level of detail.
struct Bucket {
  const ResidentPrototype* prototype = nullptr;
  const ResidentMesh* mesh = nullptr;  ///< or:
  const ImpostorAtlas* impostor = nullptr;
  std::vector<Visible> instances;
};

/// The level to draw: the coarsest whose error at this distance and scale subtends no more than is allowed.
[[nodiscard]] std::size_t level_for(const Prototype& prototype, double scale, double distance_m,
                                    double allowed_rad);
/// How far a picture of an impostor may lie from the thing itself, as a share of its radius.
inline constexpr double kImpostorErrorShare = 0.08;

/// What the camera sees, in the order of the batches, buckets in the order in which they first occur.
[[nodiscard]] std::vector<Bucket> cull(const ViewCamera& camera,
                                       std::span<const ResidentBatch* const> batches,
                                       const CullOptions& options);
/// Whether a batch may throw another shadow in the next picture: it moves, or sways in the wind.
[[nodiscard]] bool shadow_moves(const ResidentBatch& batch, const CullOptions& options);
/// Which casters: all that may shade what a cascade looks at, those of them whose shadows move, or all in its
/// square whose shadows stand still.
enum class Casters : std::uint8_t { all, moving, still_in_square };
/// What may throw a shadow into a cascade, at levels of detail that its texels can tell apart; not what is
/// smaller across than `smallest_m`. The level of each does not depend on the eye.
[[nodiscard]] std::vector<Bucket> cull_casters(const ShadowCascade& cascade,
                                               std::span<const ResidentBatch* const> batches, Casters which,
                                               const CullOptions& options, double smallest_m = 0);
/// Drops what lies behind what has been drawn.
void drop_hidden(const ViewCamera& camera, const DepthTiles& tiles, double sway_factor,
                 std::vector<Bucket>& buckets);
/// Near ones first, so that they hide far ones before these are shaded.
void sort_by_distance(std::vector<Bucket>& buckets);

}  // namespace rigor::render
