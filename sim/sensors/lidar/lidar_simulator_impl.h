// What a LidarSimulator is made of: memory that scans share, and the state of the scan at hand. Its parts are
// in lidar_simulator.cpp (casting, echoes) and receiver.cpp (what the device makes of them).
#pragma once

#include <vector>

#include "sim/sensors/lidar/echoes.h"
#include "sim/sensors/lidar/lidar_simulator.h"
#include "sim/sensors/lidar/scan_rays.h"

namespace rigor {
namespace lidar {

/// The band whose wavelength is nearest.
[[nodiscard]] int band_of(double wavelength_nm);

/// Rays of one query, about.
inline constexpr std::size_t kRaysPerCast = 16384;

/// What comes along with an echo where truth was asked for.
struct EchoTruth {
  world::NodeId node{};
  float normal[3]{};
};
struct PointTruth {
  EchoTruth echo;
  float range_m = 0;
  EchoSource source = EchoSource::surface;
};

}  // namespace lidar

struct LidarSimulator::Impl {
  Impl(const LidarSpec& s, std::shared_ptr<render::RayEngine> e)
      : spec(s),
        m(spec.model),
        engine(std::move(e)),
        rays(spec.model, spec.ideal),
        band(lidar::band_of(spec.model.wavelength_nm)),
        key(models::channel_key(spec.seed, models::channel_id_from_name(spec.name))),
        returns_per_firing(!spec.ideal && m.echoes.returns == models::LidarReturns::dual ? 2 : 1),
        crosstalk(!spec.ideal && m.retro.crosstalk > 0 &&
                  (m.retro.crosstalk_beams > 0 || m.retro.crosstalk_columns > 0)),
        noisy(!spec.ideal && (m.noise.floor_m > 0 || m.noise.scale_m > 0 || m.noise.retro_sigma_m > 0 ||
                              m.remission.noise > 0)),
        echoes_kept(rays.sub_rays() == 1 ? 1 : lidar::kMaxEchoes) {}

  LidarSpec spec;
  const models::LidarModel& m;
  std::shared_ptr<render::RayEngine> engine;
  lidar::ScanRays rays;
  int band;
  models::PhiloxKey key;
  std::uint32_t returns_per_firing;
  bool crosstalk, noisy;
  std::uint32_t echoes_kept;

  // Memory that scans share.
  lidar::Track track;
  std::vector<render::Ray> batch_rays;
  render::LayeredHits batch_hits;
  std::vector<lidar::Echo> echoes;       // firing · echoes_kept
  std::vector<std::uint8_t> echo_count;  // by firing
  std::vector<lidar::Echo> retro;        // by firing, with crosstalk: the strongest echo of remission above 1
  std::vector<std::uint8_t> tile_retro;  // whether a tile has any
  std::vector<lidar::EchoTruth> echo_truth;  // firing · echoes_kept, with truth
  std::vector<float> centre_range_m;         // by firing, with truth
  std::vector<LidarPoint> tile_points;       // from a tile's first firing on
  std::vector<lidar::PointTruth> tile_truth;
  std::vector<std::uint32_t> tile_count;
  std::vector<std::uint8_t> sun_seen;  // by firing
  std::vector<std::uint32_t> sunward;
  std::vector<render::Ray> sun_rays;
  std::vector<render::Hit> sun_hits;

  // Of measure_adding_rays().
  struct OpenFiring {
    std::size_t firing;
    std::uint32_t cast = 0, met = 0;
    bool clear = false;
  };
  std::vector<OpenFiring> open_firings;
  std::vector<std::uint32_t> still_open;
  std::vector<lidar::Return> open_returns;   // of each, as many as most_sub_rays have layers
  std::vector<lidar::EchoTruth> open_truth;  // likewise, with truth

  // Of the scan at hand.
  lidar::AirState air;
  bool want_truth = false, any_retro = false, any_sun = false;
  double sun_noise = 0;
  std::uint64_t capture_index = 0;

  Status capture(const MeasureRequest& request, const render::SensorView& view,
                 std::vector<LidarPoint>& points, GroundTruth* truth);
  Status look_at_sun(const render::Light& light);
  Status measure();
  /// Of `sub_rays` to a firing.
  [[nodiscard]] render::RayQuery query(std::span<const render::Ray> query_rays, std::uint32_t sub_rays) const;
  /// Its first ray is `first` of batch_rays.
  void form_tile(std::uint32_t tile, std::size_t first);
  /// Remission of what a ray met, with the air on the way.
  [[nodiscard]] double remission_of(const render::Ray& ray, const render::Hit& hit) const;
  /// Keeps the echoes of a firing. True: one is of a retro-reflector, and crosstalk is wanted.
  bool keep_echoes(std::size_t firing, std::span<const lidar::Echo> list);
  /// What echo e of a firing is of; normal in the world.
  void keep_truth(std::size_t firing, std::size_t e, world::NodeId node, const float normal[3]);
  Status measure_adding_rays();
  [[nodiscard]] bool clear_enough(std::span<lidar::Return> returns, std::uint32_t rays_cast) const;
  void receive_tile(std::uint32_t tile);
  void receive(std::uint32_t column, std::uint32_t slot, std::uint32_t& count, LidarPoint* to,
               lidar::PointTruth* truth_to);
  void gather(std::vector<LidarPoint>& points);
  void gather(GroundTruth& truth, const render::ContentSource& world);
};

}  // namespace rigor
