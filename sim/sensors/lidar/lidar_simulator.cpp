#include "sim/sensors/lidar/lidar_simulator.h"

#include <tbb/parallel_for.h>

#include <cmath>
#include <cstring>
#include <unordered_map>

#include "sim/sensors/lidar/lidar_simulator_impl.h"

namespace rigor {

using lidar::AirState;
using lidar::Echo;
using lidar::EchoList;
using lidar::EchoSource;
using lidar::EchoTruth;
using lidar::PointTruth;
using lidar::Return;

int lidar::band_of(double wavelength_nm) {
  int best = 0;
  for (int b = 1; b < render::kBandCount; ++b)
    if (std::abs(world::kBandWavelength_nm[static_cast<std::size_t>(b)] - wavelength_nm) <
        std::abs(world::kBandWavelength_nm[static_cast<std::size_t>(best)] - wavelength_nm))
      best = b;
  return best;
}

/// Which firings look at the sun: within the cone, and nothing between.
Status LidarSimulator::Impl::look_at_sun(const render::Light& light) {
  any_sun = false;
  const auto irradiance = static_cast<double>(light.sun_irradiance[static_cast<std::size_t>(band)]);
  sun_noise = m.sun.gain_m2_per_w * irradiance;
  if (spec.ideal || !(m.sun.half_angle_rad > 0) || !(sun_noise > 0) || !(light.direction_to_sun.z() > 0))
    return {};
  const Eigen::Vector3f to_sun = light.direction_to_sun.normalized().cast<float>();
  const auto cos_cone = static_cast<float>(std::cos(m.sun.half_angle_rad));
  sun_seen.resize(rays.firings());
  tbb::parallel_for(std::size_t{0}, rays.firings(), [&](std::size_t f) {
    Eigen::Vector3f d, o;
    rays.centre(f, track, d, o);
    sun_seen[f] = d.dot(to_sun) >= cos_cone ? 1 : 0;
  });
  sunward.clear();
  sun_rays.clear();
  for (std::size_t f = 0; f < rays.firings(); ++f) {
    if (!sun_seen[f]) continue;
    Eigen::Vector3f d, o;
    rays.centre(f, track, d, o);
    render::Ray r;
    for (int i = 0; i < 3; ++i) {
      r.origin[i] = o[i];
      r.direction[i] = to_sun[i];
    }
    r.time = rays.share(static_cast<std::uint32_t>(f / rays.beams()),
                        static_cast<std::uint32_t>(f % rays.beams()));
    sun_rays.push_back(r);
    sunward.push_back(static_cast<std::uint32_t>(f));
  }
  if (sunward.empty()) return {};
  sun_hits.resize(sun_rays.size());
  if (auto ok = engine->cast(query(sun_rays, 1), sun_hits); !ok) return ok;
  for (std::size_t i = 0; i < sunward.size(); ++i)
    if (!sun_hits[i].nothing()) sun_seen[sunward[i]] = 0;
  any_sun = true;
  return {};
}

/// Casts the scan in pieces of whole tiles and forms their echoes; without crosstalk the points follow at
/// once, while all is at hand.
Status LidarSimulator::Impl::measure() {
  if (rays.adds_rays()) return measure_adding_rays();
  const std::uint32_t tiles = rays.tiles();
  const std::size_t per_tile = rays.rays_in_tile(0);  // the last may have fewer
  const auto tiles_per_cast =
      static_cast<std::uint32_t>(std::max<std::size_t>(1, lidar::kRaysPerCast / per_tile));
  batch_rays.resize(std::min<std::size_t>(tiles, tiles_per_cast) * per_tile);
  const auto far_m = static_cast<float>(m.range.max_m * 1.001 + 1);
  for (std::uint32_t first = 0; first < tiles; first += tiles_per_cast) {
    const std::uint32_t last = std::min(tiles, first + tiles_per_cast);
    const auto begin_of = [&](std::uint32_t tile) { return std::size_t{tile - first} * per_tile; };
    tbb::parallel_for(first, last, [&](std::uint32_t tile) {
      rays.fill_tile(tile, track, far_m,
                     std::span(batch_rays).subspan(begin_of(tile), rays.rays_in_tile(tile)));
    });
    const std::size_t count = begin_of(last - 1) + rays.rays_in_tile(last - 1);
    batch_hits.resize(count);
    if (auto ok = engine->cast_layers(query(std::span(batch_rays).first(count), rays.sub_rays()), batch_hits);
        !ok)
      return ok;
    tbb::parallel_for(first, last, [&](std::uint32_t tile) {
      form_tile(tile, begin_of(tile));
      if (!crosstalk) receive_tile(tile);
    });
  }
  if (!crosstalk) return {};
  any_retro = std::any_of(tile_retro.begin(), tile_retro.end(), [](std::uint8_t t) { return t != 0; });
  tbb::parallel_for(0U, tiles, [&](std::uint32_t tile) { receive_tile(tile); });
  return {};
}

render::RayQuery LidarSimulator::Impl::query(std::span<const render::Ray> query_rays,
                                             std::uint32_t sub_rays) const {
  const lidar::ScanRays::Width width = rays.width(sub_rays);
  return {.origin = track.origin(),
          .band = band,
          .near_m = std::max(0.001F, static_cast<float>(m.range.housing_m)),
          .rays = query_rays,
          .half_width_m = width.half_m,
          .half_width_per_m = width.half_per_m};
}

double LidarSimulator::Impl::remission_of(const render::Ray& ray, const render::Hit& hit) const {
  const double e = lidar::surface_remission(m, hit);
  if (spec.ideal || air.clear()) return e;
  return e * air.two_way(track.origin().z() + static_cast<double>(ray.origin[2]),
                         static_cast<double>(ray.direction[2]), static_cast<double>(hit.range_m));
}

bool LidarSimulator::Impl::keep_echoes(std::size_t firing, std::span<const Echo> list) {
  std::copy(list.begin(), list.end(), echoes.begin() + static_cast<std::ptrdiff_t>(firing * echoes_kept));
  echo_count[firing] = static_cast<std::uint8_t>(list.size());
  if (!crosstalk) return false;
  Echo strongest{};
  for (const Echo& e : list)
    if (e.remission > std::max(1.0F, strongest.remission)) strongest = e;
  retro[firing] = strongest;
  return strongest.remission > 0;
}

void LidarSimulator::Impl::keep_truth(std::size_t firing, std::size_t e, world::NodeId node,
                                      const float normal[3]) {
  const auto column = static_cast<std::uint32_t>(firing / rays.beams()),
             slot = static_cast<std::uint32_t>(firing % rays.beams());
  const Eigen::Matrix3f R = track.at(rays.share(column, slot)).R_world_sensor;
  EchoTruth& t = echo_truth[firing * echoes_kept + e];
  t.node = node;
  const Eigen::Vector3f n = (R.transpose() * Eigen::Map<const Eigen::Vector3f>(normal)).normalized();
  for (int k = 0; k < 3; ++k) t.normal[k] = n[k];
}

void LidarSimulator::Impl::form_tile(std::uint32_t tile, std::size_t first) {
  const std::uint32_t sub_rays = rays.sub_rays();
  std::array<Return, models::kMaxLidarSubRays * render::LayeredHits::kMost> returns;
  std::uint8_t has_retro = 0;
  for (std::uint32_t i = 0; i < rays.tile_columns(tile); ++i)
    for (std::uint32_t s = 0; s < rays.beams(); ++s) {
      const std::size_t firing = std::size_t{tile * lidar::kTileColumns + i} * rays.beams() + s;
      const std::size_t at = first + rays.ray_in_tile(tile, i, s);
      EchoList list;
      if (sub_rays == 1) {
        for (const render::PartialHit& p : batch_hits.of(at))
          list.push_back({.range_m = p.hit.range_m,
                          .remission = static_cast<float>(remission_of(batch_rays[at], p.hit)),
                          .cos_incidence = p.hit.cos_incidence});
      } else {
        std::size_t met = 0;
        for (std::size_t k = 0; k < sub_rays; ++k) {
          const std::span<const render::PartialHit> layers = batch_hits.of(at + k);
          for (std::size_t l = 0; l < layers.size(); ++l) {
            const render::Hit& hit = layers[l].hit;
            const double e =
                static_cast<double>(rays.weight(k) * layers[l].share) * remission_of(batch_rays[at + k], hit);
            if (e > 0)
              returns[met++] = {hit.range_m, static_cast<std::uint16_t>(k * render::LayeredHits::kMost + l),
                                e, hit.cos_incidence};
          }
        }
        if (met > 0) list = lidar::form_echoes(m, std::span(returns).first(met));
      }
      if (keep_echoes(firing, list.all())) has_retro = 1;
      if (!want_truth) continue;
      // Of the middle, what covers most of it.
      const auto centre = batch_hits.of(at);
      const auto most = std::max_element(centre.begin(), centre.end(),
                                         [](const auto& a, const auto& b) { return a.share < b.share; });
      centre_range_m[firing] =
          most == centre.end() ? std::numeric_limits<float>::infinity() : most->hit.range_m;
      for (std::uint32_t e = 0; e < list.count(); ++e) {
        const std::size_t ray = at + list[e].sub_ray / render::LayeredHits::kMost,
                          layer = list[e].sub_ray % render::LayeredHits::kMost;
        const render::Hit& hit = batch_hits.of(ray)[layer].hit;
        keep_truth(firing, e, hit.node, hit.normal);
      }
    }
  if (crosstalk) tile_retro[tile] = has_retro;
}

void LidarSimulator::Impl::gather(std::vector<LidarPoint>& points) {
  std::size_t total = 0;
  for (const std::uint32_t n : tile_count) total += n;
  points.resize(total);
  std::size_t at = 0;
  const std::size_t stride = std::size_t{lidar::kTileColumns} * rays.beams() * returns_per_firing;
  for (std::size_t tile = 0; tile < tile_count.size(); ++tile) {
    if (tile_count[tile] > 0)
      std::memcpy(&points[at], &tile_points[tile * stride], tile_count[tile] * sizeof(LidarPoint));
    at += tile_count[tile];
  }
}

void LidarSimulator::Impl::gather(GroundTruth& truth, const render::ContentSource& world) {
  truth = {};
  truth.class_names = {""};
  std::unordered_map<std::string, std::uint16_t> classes{{"", 0}};
  std::unordered_map<world::NodeId, std::uint16_t> class_of_node;
  const auto class_named = [&](const std::string& name) {
    const auto [at, fresh] = classes.try_emplace(name, static_cast<std::uint16_t>(truth.class_names.size()));
    if (fresh) truth.class_names.push_back(name);
    return at->second;
  };
  const std::size_t stride = std::size_t{lidar::kTileColumns} * rays.beams() * returns_per_firing;
  for (std::size_t tile = 0; tile < tile_count.size(); ++tile)
    for (std::size_t i = 0; i < tile_count[tile]; ++i) {
      const PointTruth& t = tile_truth[tile * stride + i];
      truth.node.push_back(t.echo.node.value);
      truth.range_m.push_back(t.range_m);
      truth.normal.insert(truth.normal.end(), t.echo.normal, t.echo.normal + 3);
      std::uint16_t index = 0;
      if (t.source == EchoSource::ghost) {
        index = class_named("crosstalk");
      } else if (t.source == EchoSource::particle) {
        index = class_named("precipitation");
      } else if (t.echo.node.value != 0) {
        const auto [at, fresh] = class_of_node.try_emplace(t.echo.node, std::uint16_t{0});
        if (fresh) at->second = class_named(world.type_name(t.echo.node));
        index = at->second;
      }
      truth.class_index.push_back(index);
    }
  truth.width = static_cast<std::uint32_t>(truth.node.size());
  truth.height = 1;
}

Status LidarSimulator::Impl::capture(const MeasureRequest& request, const render::SensorView& view,
                                     std::vector<LidarPoint>& points, GroundTruth* truth) {
  rays.begin_scan(request.index, request.t_capture);
  const Duration duration = seconds_from(rays.duration_s());
  track.follow(view.T_world_sensor, request.t_capture, duration, rays.columns());
  if (!track.finite())
    return fail(ErrorCode::bad_input, spec.name,
                "expected a finite pose of the sensor, at " + std::to_string(request.t_capture.ns()) + " ns");
  const double far_m = m.range.max_m + track.reach_m();
  render::ContentQuery query;
  query.look_from_cell_of(track.origin());
  query.allowed_error_rad = spec.allowed_error_rad;
  query.far_m = far_m;
  query.t = request.t_capture;
  const auto window = view.world.collect(query, request.t_capture, request.t_capture + duration,
                                         duration.ns() > 0 ? m.scan.instants : 1);
  if (auto ok = engine->prepare(window); !ok) return ok;

  capture_index = request.index;
  want_truth = truth != nullptr;
  any_retro = false;
  air = spec.ideal ? AirState{} : lidar::air_state(m, window->first(), band, track.origin().z());

  const std::size_t firings = rays.firings();
  if (firings == 0) {  // a pattern that has ended
    points.clear();
    if (truth) {
      *truth = {};
      truth->height = 1;
      truth->class_names = {""};
    }
    return {};
  }
  echoes.resize(firings * echoes_kept);
  echo_count.resize(firings);
  tile_points.resize(firings * returns_per_firing);
  tile_count.resize(rays.tiles());
  if (crosstalk) {
    retro.resize(firings);
    tile_retro.resize(rays.tiles());
  }
  if (want_truth) {
    echo_truth.resize(firings * echoes_kept);
    centre_range_m.resize(firings);
    tile_truth.resize(tile_points.size());
  }
  if (auto ok = look_at_sun(window->first().light); !ok) return ok;
  if (auto ok = measure(); !ok) return ok;
  gather(points);
  if (truth) gather(*truth, view.world);
  return {};
}

Result<std::unique_ptr<LidarSimulator>> LidarSimulator::create(const LidarSpec& spec,
                                                               std::shared_ptr<render::RayEngine> engine) {
  if (!engine) return fail(ErrorCode::bad_input, spec.name, "expected an engine");
  if (auto valid = spec.model.validate(); !valid) return tl::unexpected<Error>(valid.error());
  if (!std::isfinite(spec.allowed_error_rad) || spec.allowed_error_rad < 0)
    return fail(ErrorCode::bad_input, spec.name, "expected an allowed error of at least 0 rad");
  return std::unique_ptr<LidarSimulator>(new LidarSimulator(std::make_unique<Impl>(spec, std::move(engine))));
}

LidarSimulator::LidarSimulator(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
LidarSimulator::~LidarSimulator() = default;

Status LidarSimulator::capture(const MeasureRequest& request, const render::SensorView& view,
                               std::vector<LidarPoint>& points, GroundTruth* truth) {
  return impl_->capture(request, view, points, truth);
}
std::size_t LidarSimulator::max_points() const {
  return impl_->rays.max_firings() * impl_->returns_per_firing;
}
const LidarSpec& LidarSimulator::spec() const { return impl_->spec; }

}  // namespace rigor
