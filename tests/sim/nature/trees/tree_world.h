// A world of trees for tests.
#pragma once

#include <cmath>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "sim/nature/providers.h"
#include "sim/render/content/provider.h"
#include "sim/world/graph/database.h"
#include "sim/world/semantic_types.h"

namespace rigor::test {

/// Ground z = slope·x + lift where |x|, |y| < half_m; nothing beyond.
struct Slope : render::GroundHeights {
  double slope = 0.1, lift = 5, half_m = 1000;
  /// Lifts the ground where x is larger than that.
  double step_at_m = 1e9, step_m = 0;
  [[nodiscard]] double height_at(double x, double y) const override {
    return std::abs(x) < half_m && std::abs(y) < half_m ? slope * x + lift + (x > step_at_m ? step_m : 0)
                                                        : NAN;
  }
  [[nodiscard]] Eigen::Vector3d normal_at(double, double) const override { return {0, 0, 1}; }
};

struct TreeWorld {
  std::unique_ptr<world::Database> db = world::Database::create();
  std::shared_ptr<Slope> ground = std::make_shared<Slope>();
  std::unique_ptr<render::ContentProvider> provider;
  world::Subscription subscription;
  std::unique_ptr<world::types::Tree> tree;

  TreeWorld() {
    if (!world::define_semantic_types(*db)) std::abort();
    tree = std::make_unique<world::types::Tree>(db->schema());
    provider = nature::make_tree_provider(ground);
    provider->rebuild(db->snapshot());
    subscription = db->subscribe(
        {}, [this](const world::ChangeSet& set, std::span<const world::Change>) { provider->apply(set); });
  }
  struct Spec {
    double x = 0, y = 0, z = NAN;
    std::string species = "TSHE";
    double dbh_m = 0.4, height_m = 0, crown_radius_m = 0, crown_base_m = 0;
    bool dead = false;
  };
  std::vector<world::NodeId> plant(const std::vector<Spec>& specs) {
    world::Transaction tx = db->begin("plant");
    std::vector<world::NodeId> out;
    for (const Spec& s : specs) {
      const world::NodeId n = *tx.create(tree->type);
      bool ok = tx.set(n, tree->position, world::Vector3(s.x, s.y, s.z)).has_value();
      ok = tx.set(n, tree->species, s.species).has_value() && ok;
      ok = tx.set(n, tree->dbh_m, s.dbh_m).has_value() && ok;
      ok = tx.set(n, tree->height_m, s.height_m).has_value() && ok;
      ok = tx.set(n, tree->crown_radius_m, s.crown_radius_m).has_value() && ok;
      ok = tx.set(n, tree->crown_base_m, s.crown_base_m).has_value() && ok;
      ok = tx.set(n, tree->dead, s.dead).has_value() && ok;
      if (!ok) std::abort();
      out.push_back(n);
    }
    if (!tx.commit()) std::abort();
    return out;
  }
  world::NodeId plant_one(const Spec& s) { return plant({s}).front(); }
  [[nodiscard]] render::ContentFrame frame() const {
    render::ContentFrame f;
    provider->collect({}, f);
    return f;
  }
  [[nodiscard]] std::set<std::uint64_t> serials() const {
    std::set<std::uint64_t> out;
    for (const auto& b : frame().batches) out.insert(b->serial);
    return out;
  }
};

/// The corners of an instance's finest mesh in the world.
inline std::vector<Eigen::Vector3d> corners_of(const render::Batch& batch, std::size_t index) {
  const render::Instance& i = batch.instances[index];
  const Eigen::Quaterniond q(i.rotation[3], i.rotation[0], i.rotation[1], i.rotation[2]);
  std::vector<Eigen::Vector3d> out;
  for (const auto& v : batch.prototype->levels.front().mesh->vertices)
    out.push_back(batch.origin + Eigen::Vector3d(i.position[0], i.position[1], i.position[2]) +
                  q * Eigen::Vector3d(v.position[0] * i.scale[0], v.position[1] * i.scale[1],
                                      v.position[2] * i.scale[2]));
  return out;
}

}  // namespace rigor::test
