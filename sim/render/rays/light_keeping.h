// Gathered light that is kept from one picture to the next. It is a function of a cell of the world, of what
// stands in it and of sun and sky, never of what was asked before: rays start from places all over the cell
// in which the eye is, sector by sector of the sphere, and a picture has the paths of the sectors that it
// looks at. About what moves light is kept for its instant alone, for all cameras that measure then: paths
// that it blocks are traced anew, and sky that it hides is taken away. Light on it is gathered for each
// picture. Internal to sim/render/rays.
#pragma once

#include <tbb/task_arena.h>

#include <list>
#include <memory>
#include <optional>

#include "sim/render/rays/light_chunk.h"

namespace rigor::render::light {

/// Directions by the faces of a cube, each of `side` x `side` sectors of about the same size.
class Sectors {
 public:
  explicit Sectors(int side) : side_(side) {}
  [[nodiscard]] int side() const noexcept { return side_; }
  [[nodiscard]] int count() const noexcept { return 6 * side_ * side_; }
  /// Any direction but 0.
  [[nodiscard]] int of(Vec3 direction) const noexcept;
  /// x, y: from 0 to 1 within the sector; beyond it: of its neighbours. Unit length.
  [[nodiscard]] Vec3 direction(int sector, float x, float y) const noexcept;

 private:
  int side_;
};

/// What light is gathered in.
struct LitScene {
  const RayScene& scene;
  std::uint64_t still_version, moving_version;  ///< change with what stands still, and with what moves
  const LightSurfaces& surfaces;
  const LightFrame& frame;
};

class KeptLight {
 public:
  /// About what the query's rays look at: each sector that one lies in or comes nearer to than half a sector.
  /// The answer holds until the next call.
  const GatheredLight& about(const LitScene& lit, const LightQuery& query, tbb::task_arena& arena);
  /// Sectors that the last call traced.
  [[nodiscard]] std::size_t traced() const noexcept { return traced_; }
  /// Sectors that the last call asked for what moves.
  [[nodiscard]] std::size_t moved() const noexcept { return moved_; }

 private:
  /// All that the paths of a sector depend on.
  struct Key {
    std::array<std::int64_t, 3> cell{};
    int side = 0;
    std::uint64_t still_version = 0;
    Eigen::Vector3d scene_origin = Eigen::Vector3d::Zero();
    std::array<int, 4> bands{};
    Vec3 to_sun;
    Bands4 sun_irradiance{}, ground{};
    std::shared_ptr<const SkyTables> sky;
    float wetness = 0, snow_depth_m = 0;
    [[nodiscard]] bool operator==(const Key& o) const noexcept;
    [[nodiscard]] Eigen::Vector3d centre() const noexcept;
  };
  struct Region {
    Key key;
    std::vector<std::unique_ptr<Gathered>> sectors;
    std::vector<int> shared;  ///< sectors whose paths are in `light`
    std::unique_ptr<GatheredLight> light;
    /// What was gathered anew about the things that move, as they stood last. Of each sector: not known yet,
    /// null where it is as without them.
    struct Moved {
      std::uint64_t version = 0;
      float time = 0;
      std::vector<std::optional<std::unique_ptr<Gathered>>> sectors;
    } moved;
  };
  struct SectorRays;
  [[nodiscard]] Region& region(const Key& key);
  [[nodiscard]] static std::vector<int> looked_at(const LightQuery& query, const Sectors& sectors);
  const GatheredLight& with_moving(const LitScene& lit, const LightQuery& query, Region& region,
                                   const std::vector<int>& seen, tbb::task_arena& arena);
  /// Null where nothing that moves comes in between.
  [[nodiscard]] static std::unique_ptr<Gathered> gather_about_moving(const LitScene& lit,
                                                                     const Region& region, int sector,
                                                                     float time);
  void forget(const std::vector<int>& seen);

  std::list<Region> regions_;  ///< the one that was asked last first
  std::unique_ptr<GatheredLight> with_moving_;
  std::size_t traced_ = 0, moved_ = 0;
};

}  // namespace rigor::render::light
