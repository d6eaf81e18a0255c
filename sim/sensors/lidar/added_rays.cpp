// Rays where the echoes of a footprint are not clear: as many as sub_rays first, then twice as many, up to
// most_sub_rays.
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <bitset>
#include <cmath>
#include <utility>

#include "sim/sensors/lidar/lidar_simulator_impl.h"

namespace rigor {

using lidar::EchoList;
using lidar::EchoTruth;
using lidar::Return;

namespace {

/// The strongest echo leads by this many standard deviations of the powers of its rays …
constexpr double kLead = 1.5;
/// … and its mean range is known to this.
constexpr double kKnown_m = 0.05;

}  // namespace

/// More rays would say the same. Sorts the returns by range.
bool LidarSimulator::Impl::clear_enough(std::span<Return> returns, std::uint32_t rays_cast) const {
  if (returns.empty()) return true;
  std::sort(returns.begin(), returns.end(), [](const Return& a, const Return& b) {
    return a.range_m != b.range_m ? a.range_m < b.range_m : a.sub_ray < b.sub_ray;
  });
  const auto separation = static_cast<float>(m.echoes.separation_m);
  const auto ray_of = [](const Return& r) { return r.sub_ray / render::LayeredHits::kMost; };
  std::array<double, models::kMaxLidarSubRays> of_ray{};  // power in the group at hand
  std::bitset<models::kMaxLidarSubRays> met;
  double squares = 0, most = 0, next = 0, variance = 0;
  std::size_t groups = 0;
  for (std::size_t i = 0; i < returns.size(); ++groups) {
    double sum = 0, moment = 0, second = 0;
    const std::size_t first = i;
    const float nearest = returns[i].range_m;
    do {
      const double p = lidar::power(m, returns[i].remission, static_cast<double>(returns[i].range_m));
      const auto r = static_cast<double>(returns[i].range_m - nearest);
      sum += p;
      moment += p * r;
      second += p * r * r;
      of_ray[ray_of(returns[i])] += p;
      met.set(ray_of(returns[i]));
      ++i;
    } while (i < returns.size() && returns[i].range_m - returns[i - 1].range_m <= separation);
    for (std::size_t k = first; k < i; ++k) {
      const double p = std::exchange(of_ray[ray_of(returns[k])], 0.0);
      squares += p * p;
    }
    if (sum > most) {
      next = most;
      most = sum;
      variance = std::max(0.0, second / sum - moment * moment / (sum * sum));
    } else {
      next = std::max(next, sum);
    }
  }
  if (!(std::sqrt(variance / rays_cast) < kKnown_m)) return false;
  // The other devices' answers hang on weak echoes too.
  if (m.echoes.returns != models::LidarReturns::strongest) return groups == 1 && met.count() == rays_cast;
  return groups == 1 || most - next > kLead * std::sqrt(squares);
}

Status LidarSimulator::Impl::measure_adding_rays() {
  const auto first_rays = static_cast<std::uint32_t>(m.footprint.sub_rays),
             most_rays = static_cast<std::uint32_t>(m.footprint.most_sub_rays);
  const auto far_m = static_cast<float>(m.range.max_m * 1.001 + 1);
  const std::uint32_t tiles = rays.tiles();
  const auto together = static_cast<std::uint32_t>(std::max<std::size_t>(
      1, lidar::kRaysPerCast / (std::size_t{lidar::kTileColumns} * rays.beams() * most_rays)));
  constexpr std::size_t kLayers = render::LayeredHits::kMost;
  const std::size_t each_returns = most_rays * kLayers;
  const auto cast = [&](std::uint32_t sub_rays) {
    batch_hits.resize(batch_rays.size());
    return engine->cast_layers(query(batch_rays, sub_rays), batch_hits);
  };
  for (std::uint32_t begin = 0; begin < tiles; begin += together) {
    const std::uint32_t end = std::min(tiles, begin + together);
    // Beam by beam, as neighbours lie in a tile.
    open_firings.clear();
    for (std::uint32_t tile = begin; tile < end; ++tile)
      for (std::uint32_t rank = 0; rank < rays.beams(); ++rank)
        for (std::uint32_t i = 0; i < rays.tile_columns(tile); ++i)
          open_firings.push_back({.firing = std::size_t{tile * lidar::kTileColumns + i} * rays.beams() +
                                            rays.slot_of_rank(rank)});
    open_returns.resize(open_firings.size() * each_returns);
    if (want_truth) {
      open_truth.resize(open_returns.size());
      batch_rays.resize(open_firings.size());
      for (std::size_t f = 0; f < open_firings.size(); ++f) {
        Eigen::Vector3f d, o;
        rays.centre(open_firings[f].firing, track, d, o);
        render::Ray& ray = batch_rays[f];
        for (int k = 0; k < 3; ++k) ray.direction[k] = d[k], ray.origin[k] = o[k];
        const std::size_t firing = open_firings[f].firing;
        ray.time = rays.share(static_cast<std::uint32_t>(firing / rays.beams()),
                              static_cast<std::uint32_t>(firing % rays.beams()));
        ray.far_m = far_m;
      }
      if (auto ok = cast(1); !ok) return ok;
      for (std::size_t f = 0; f < open_firings.size(); ++f) {
        const auto met = batch_hits.of(f);
        centre_range_m[open_firings[f].firing] =
            met.empty() ? std::numeric_limits<float>::infinity() : met.front().hit.range_m;
      }
    }
    for (std::uint32_t have = 0, want = first_rays;; have = want, want = std::min(2 * want, most_rays)) {
      still_open.clear();
      for (std::size_t f = 0; f < open_firings.size(); ++f)
        if (!open_firings[f].clear) still_open.push_back(static_cast<std::uint32_t>(f));
      if (still_open.empty()) break;
      const std::size_t each = want - have;
      batch_rays.resize(still_open.size() * each);
      tbb::parallel_for(std::size_t{0}, still_open.size(), [&](std::size_t at) {
        rays.fill_firing(open_firings[still_open[at]].firing, have, track, far_m,
                         std::span(batch_rays).subspan(at * each, each));
      });
      if (auto ok = cast(want); !ok) return ok;
      tbb::parallel_for(std::size_t{0}, still_open.size(), [&](std::size_t at) {
        OpenFiring& f = open_firings[still_open[at]];
        const std::size_t returns = std::size_t{still_open[at]} * each_returns;
        for (std::size_t k = at * each; k < (at + 1) * each; ++k) {
          const std::span<const render::PartialHit> layers = batch_hits.of(k);
          for (std::size_t l = 0; l < layers.size(); ++l) {
            const render::Hit& hit = layers[l].hit;
            const double e = static_cast<double>(layers[l].share) * remission_of(batch_rays[k], hit);
            if (!(e > 0)) continue;
            const auto sub_ray = static_cast<std::uint16_t>((have + (k - at * each)) * kLayers + l);
            open_returns[returns + f.met++] = {hit.range_m, sub_ray, e, hit.cos_incidence};
            if (want_truth) {
              EchoTruth& t = open_truth[returns + sub_ray];
              t.node = hit.node;
              std::copy(hit.normal, hit.normal + 3, t.normal);
            }
          }
        }
        f.cast = want;
        f.clear = want == most_rays || clear_enough(std::span(open_returns).subspan(returns, f.met), want);
      });
      if (want == most_rays) break;
    }
    const std::size_t per_tile = std::size_t{lidar::kTileColumns} * rays.beams();
    tbb::parallel_for(begin, end, [&](std::uint32_t tile) {
      std::uint8_t has_retro = 0;
      const std::size_t first = (tile - begin) * per_tile;
      for (std::size_t f = first; f < std::min(first + per_tile, open_firings.size()); ++f) {
        const OpenFiring& of = open_firings[f];
        const auto returns = std::span(open_returns).subspan(f * each_returns, of.met);
        for (Return& r : returns) r.remission /= of.cast;
        const EchoList list = of.met > 0 ? lidar::form_echoes(m, returns) : EchoList{};
        if (keep_echoes(of.firing, list.all())) has_retro = 1;
        if (!want_truth) continue;
        for (std::uint32_t e = 0; e < list.count(); ++e) {
          const EchoTruth& t = open_truth[f * each_returns + list[e].sub_ray];
          keep_truth(of.firing, e, t.node, t.normal);
        }
      }
      if (crosstalk)
        tile_retro[tile] = has_retro;
      else
        receive_tile(tile);
    });
  }
  if (!crosstalk) return {};
  any_retro = std::any_of(tile_retro.begin(), tile_retro.end(), [](std::uint8_t t) { return t != 0; });
  tbb::parallel_for(0U, tiles, [&](std::uint32_t tile) { receive_tile(tile); });
  return {};
}

}  // namespace rigor
