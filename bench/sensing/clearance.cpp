#include "bench/sensing/clearance.h"

#include <cmath>
#include <map>
#include <numbers>

namespace rigor {

ClearanceProbe::ClearanceProbe(SensorWorld& world) : world_(world) {
  // Directions spread evenly over the sphere: a spiral whose turns are golden angles apart.
  const double turn = std::numbers::pi * (3 - std::sqrt(5.0));
  for (int i = 0; i < kRays; ++i) {
    const double z = 1 - (2 * i + 1) / double{kRays}, r = std::sqrt(1 - z * z);
    const double d[3] = {r * std::cos(turn * i), r * std::sin(turn * i), z};
    render::Ray out, in;
    for (int k = 0; k < 3; ++k) {
      out.direction[k] = static_cast<float>(d[k]);
      in.direction[k] = -out.direction[k];
      in.origin[k] = static_cast<float>(kReach_m * d[k]);
    }
    out.far_m = in.far_m = static_cast<float>(kReach_m);
    out_.push_back(out);
    in_.push_back(in);
  }
}

Result<std::unique_ptr<ClearanceProbe>> ClearanceProbe::create(
    SensorWorld& world, const std::shared_ptr<render::EmbreeCache>& cache) {
  auto engine = render::EmbreeEngine::create(cache);
  if (!engine) return tl::unexpected<Error>(engine.error());
  std::unique_ptr<ClearanceProbe> probe(new ClearanceProbe(world));
  probe->engine_ = *engine;
  return probe;
}

Result<std::optional<ClearanceProbe::Obstacle>> ClearanceProbe::nearest(const WorldMotion& motion,
                                                                        const Eigen::Vector3d& p_world,
                                                                        double radius_m,
                                                                        std::string_view carrier) {
  SensorWorld::Moment moment(world_, motion);
  render::ContentQuery query;
  query.eye = p_world;
  query.far_m = 2 * kReach_m;
  if (auto s = engine_->prepare(moment.collect(query, BenchTime(), BenchTime(), 1)); !s)
    return tl::unexpected<Error>(s.error());
  std::vector<render::Hit> out(out_.size()), in(in_.size());
  if (auto s = engine_->cast({.origin = p_world, .rays = out_}, out); !s)
    return tl::unexpected<Error>(s.error());
  if (auto s = engine_->cast({.origin = p_world, .rays = in_}, in); !s)
    return tl::unexpected<Error>(s.error());

  const world::Snapshot world = world_.snapshot();
  const world::types::Object object(world.schema());
  std::map<std::uint64_t, bool> known;
  const auto counts = [&](world::NodeId node) {
    const auto [it, fresh] = known.try_emplace(node.value, true);
    if (fresh) {
      const std::string type = moment.type_name(node);
      const std::string& name = world.get_or_default(node, object.name);
      it->second = type != "Terrain" && type != "GroundPlane" && type != "GroundVegetation" &&
                   type != "Road" && type != "Water" && !type.empty() &&
                   (carrier.empty() || !name.starts_with(std::string(carrier) + "."));
    }
    return it->second;
  };
  std::optional<Obstacle> best;
  const auto take = [&](double range_m, world::NodeId node) {
    if (range_m <= radius_m && (!best || range_m < best->range_m) && counts(node))
      best = {range_m, node, moment.type_name(node)};
  };
  std::map<std::uint64_t, int> around;
  for (std::size_t i = 0; i < in.size(); ++i) {
    if (!out[i].nothing()) take(double{out[i].range_m}, out[i].node);
    if (in[i].nothing()) continue;
    take(kReach_m - double{in[i].range_m}, in[i].node);
    ++around[in[i].node.value];
  }
  // What hides the point from three directions in four has it inside.
  for (const auto& [node, count] : around)
    if (4 * count > 3 * kRays && counts({node})) best = {0, {node}, moment.type_name({node})};
  return best;
}

}  // namespace rigor
