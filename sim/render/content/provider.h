// A semantic render plugin: keeps its own structure for its own part of the world, up to date by the
// database's signals, and answers queries with content (sim/render/content/content.h). Ways A, B and C from
// data to picture are all providers: models as they are, interpreted geometry, and structures of their own.
#pragma once

#include <Eigen/Geometry>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sim/render/content/content.h"
#include "sim/world/graph/changes.h"
#include "sim/world/graph/snapshot.h"

namespace rigor::render {

/// What somebody wants to see. A provider answers with at least all that matters to it, and may answer with
/// more.
struct ContentQuery {
  Eigen::Vector3d eye = Eigen::Vector3d::Zero();
  /// The answer holds for every eye within this distance of `eye`.
  double eye_reach_m = 0;
  /// Half spaces n·x + d ≥ 0 with n of unit length; inside all of them is what is seen. Empty: all round.
  std::vector<Eigen::Hyperplane<double, 3>> frustum{};
  /// An error that subtends less than this at the eye does not matter. 0: everything in full (no detail is
  /// left out, no impostors).
  double allowed_error_rad = 1e-3;
  double full_within_m = 0;  ///< as near as this everything is given in full, whatever error is allowed
  double far_m = std::numeric_limits<double>::infinity();  ///< nothing beyond matters
  BenchTime t{};  ///< instant whose poses, weather and sun are wanted
  /// Way from the eye within which what stands outside the frustum may throw shadows into it.
  double shadow_reach_m = 0;

  /// Asks for what any eye in the same cell of the world needs (cubes of kEyeCell_m): the query, and so the
  /// content, stays the same while a moving sensor is within the cell. An eye that is not finite is taken as
  /// it is.
  void look_from_cell_of(const Eigen::Vector3d& eye_world);
  static constexpr double kEyeCell_m = 2;

  /// Distance of a box from the nearest eye that the answer must hold for; 0 where that is inside.
  [[nodiscard]] double distance_m(const Eigen::AlignedBox3d& box) const;
  /// False where a box lies wholly outside the frustum or beyond far_m, so that nothing of it can be seen.
  [[nodiscard]] bool may_see(const Eigen::AlignedBox3d& box) const;
  /// As above, with what may throw shadows: boxes within shadow_reach_m of the eye.
  [[nodiscard]] bool may_matter(const Eigen::AlignedBox3d& box) const;
};

/// Height of the ground, for whatever stands on it. Made by the terrain's provider, read by the others.
class GroundHeights {
 public:
  virtual ~GroundHeights() = default;
  /// z of the ground, bilinear; NaN outside all terrain and over holes. Any thread.
  [[nodiscard]] virtual double height_at(double x, double y) const = 0;
  [[nodiscard]] virtual Eigen::Vector3d normal_at(double x, double y) const = 0;
};

/// Calls come from one thread at a time.
class ContentProvider {
 public:
  virtual ~ContentProvider() = default;
  [[nodiscard]] virtual std::string_view name() const = 0;
  /// Builds everything anew. Errors say what in the world cannot be shown; the provider then shows the rest,
  /// and tells the message through `warnings`.
  virtual void rebuild(const world::Snapshot& world) = 0;
  /// After a transaction; costs what changed. A change of a type that it does not know is none of its
  /// business.
  virtual void apply(const world::ChangeSet& changes) = 0;
  /// Adds its part to the frame. The same world, query and time give the same content, whatever was asked
  /// before.
  virtual void collect(const ContentQuery& query, ContentFrame& frame) = 0;
  /// Of a provider that adds batches alone, whatever `query.t` is: a number that changes with what it shows,
  /// so that an answer can be kept. 0: each query must be asked.
  [[nodiscard]] virtual std::uint64_t version() const { return 0; }
  [[nodiscard]] virtual std::vector<std::string> warnings() const { return {}; }
};

}  // namespace rigor::render
