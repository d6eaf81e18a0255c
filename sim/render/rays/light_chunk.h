// A few rays of a light query, from the first intersection to the light that comes back. Internal to
// sim/render/rays.
#pragma once

#include <array>
#include <span>

#include "sensor-hal/models/philox.h"
#include "sim/render/rays/embree_scene.h"
#include "sim/render/rays/light_gather.h"
#include "sim/render/rays/light_point.h"
#include "sim/render/rays/light_tracer.h"
#include "sim/render/rays/sun_keeping.h"

namespace rigor::render::light {

/// Small enough for what is known of its points to stay in the first cache.
constexpr std::size_t kChunk = 64;

struct ChunkInput {
  const RayScene& scene;
  const LightSurfaces& surfaces;
  const LightFrame& frame;
  const LightQuery& query;
  Eigen::Vector3d origin;                   ///< of the query, relative to the scene's cell
  const GatheredLight* gathered = nullptr;  ///< null: the sky is open
  /// What the query's rays can meet, and what all rays that follow can.
  RayScene::Part seen = RayScene::Part::all, followed = RayScene::Part::all;
  /// Of a query with SunRays::wide and shadows, where there is a sun and shadows have holes; else null.
  KeptSun* kept_sun = nullptr;
};

/// Belongs to one thread.
class Chunk {
 public:
  explicit Chunk(const ChunkInput& in);
  /// Rays from `first` on, at most kChunk.
  void trace(std::size_t first, std::span<LightSample> samples);
  /// Light about the points of the rays from `first` on, at most kChunk of `rays`: along `paths`, 2 to
  /// kMostPaths, from each point, of leaves along one from each side, and what is seen of the sky. Goes to
  /// the end of `out`. `again`: of paths that a call with the same rays has put into `out`, which had nothing
  /// before, those that are traced once more, into the same places, and nothing else; rays of others need not
  /// be there.
  void gather(std::size_t first, std::size_t rays, unsigned paths, Gathered& out,
              std::span<const std::uint8_t> again = {});
  static constexpr unsigned kMostPaths = 4;
  std::size_t shadow_rays = 0, sky_rays = 0;

 private:
  /// A ray that looks for light to send on to a point.
  struct Path {
    Vec3 place, direction;
    Bands4 share{};  ///< of the light it finds that is seen from the chunk's ray
    unsigned point = 0;
    float time = 0;
    bool mirrored = false;  ///< not one of those that ask what hides the sky
  };

  void load_rays(std::size_t first, unsigned n);
  /// Relative to the scene's cell.
  [[nodiscard]] Vec3 start_of(const Ray& r) const;
  [[nodiscard]] bool is_ray(const Ray& r) const;
  /// Light of a ray that meets nothing.
  void nothing_met(const Ray& r, LightSample& s) const;
  void first_intersections(std::size_t first, std::span<LightSample> samples);
  void sky_only(std::size_t first, std::span<LightSample> samples);
  /// Sunlight on points by rays without width. How many were shot. `draw`: tells apart draws for one ray.
  unsigned add_sun(std::span<Point> points, std::size_t first, unsigned draw, SunRays sun);
  /// Sunlight on points, at most kChunk, by wide rays (SunRays::wide). How many were shot.
  unsigned add_wide_sun(std::span<Point> points);
  /// Sets clear[i] of points that have a cell to the share of sunlight that gets past what stands still.
  /// Where leaves do not decide, points have no cell afterwards. How many rays were shot.
  unsigned take_from_cells(std::span<const Point> points, std::span<SunCell> cells, std::span<float> clear);
  /// Multiplies clear[i] by the share that gets past what moves, of points with a cell, or past everything,
  /// of points without one, by rays of the points' own. How many were shot.
  unsigned ask_for_points(std::span<const Point> points, std::span<const SunCell> cells, bool in_cells,
                          std::span<float> clear);
  [[nodiscard]] bool may_see_sun(const Point& p) const noexcept {
    return in_.frame.sun && may_be_lit(p.patch, p.normal, p.shading_normal, in_.frame.to_sun);
  }
  /// Where all of it is seen.
  [[nodiscard]] Bands4 from_sun(const Point& p) const noexcept {
    return lit_from(p.patch, p.view, p.normal, in_.frame.to_sun, in_.frame.sun_irradiance);
  }
  void set_sun_ray(unsigned i, Vec3 place, Vec3 normal, float time, Vec3 to);
  void add_lamps();
  /// What surroundings send to a point.
  struct Surroundings {
    Bands4 front{}, behind{};  ///< W/m² onto its sides
    Bands4 mirrored{};         ///< irradiance of open sky and ground about the mirror's direction
    Bands4 seen{};             ///< share of that which nothing hides
  };
  [[nodiscard]] Surroundings surroundings(const Point& p, const Mirror& m);
  void add_surroundings(Point& p, const Mirror& m, const Surroundings& s) const;
  static constexpr unsigned kPacket = 8;
  /// Whether the points from `first` on are those of a whole packet (LightQuery::packets) that share what
  /// surroundings send; if so, with their mirrors.
  [[nodiscard]] bool shares_from(unsigned first, std::array<Mirror, kPacket>& mirrors) const;
  /// Works it out for three of the points, and for the others in between.
  void share_surroundings(std::span<Point> points, const std::array<Mirror, kPacket>& mirrors);
  void add_open_sky();
  void add_sky(std::size_t first);
  /// Asks what is seen of the sky from the chunk's points.
  void gather_sky(std::size_t first, unsigned paths, std::vector<GatheredSky>& out);
  void begin_paths(std::size_t first, unsigned k);
  void follow_paths(std::size_t first, unsigned k, unsigned bounces);
  /// The way on from a point that scatters diffusely. False where all is absorbed.
  bool scatter(const Point& p, std::size_t index, unsigned k, unsigned segment, Path& out) const;
  [[nodiscard]] std::array<float, 4> draws(std::size_t index, unsigned purpose, unsigned k,
                                           unsigned segment) const;

  const ChunkInput in_;
  PointLookup points_of_;
  models::PhiloxKey key_;
  unsigned n_ = 0;
  std::array<Point, kChunk> points_;
  std::array<float, kChunk> asked_{}, open_{};  ///< of a point: sky rays, and those that nothing stopped
  std::array<float, kChunk> first_m_{};         ///< of a point's last path: length of its first segment
  unsigned paths_ = 0;
  std::array<Path, 2 * kChunk> path_;
  std::array<Point, 2 * kChunk> met_;
  RayPackets rays_;
  GatheredLight::Found found_;
};

}  // namespace rigor::render::light
