#include "tests/sim/nature/terrain/ground_world.h"

#include <gtest/gtest.h>

namespace rigor::ground_test {

using world::Blob;

GroundWorld::GroundWorld() : db(world::Database::create()) { EXPECT_TRUE(world::define_semantic_types(*db)); }

void GroundWorld::commit(const std::function<void(world::Transaction&)>& write) {
  auto tx = db->begin("test");
  write(tx);
  const auto status = tx.commit();
  ASSERT_TRUE(status) << status.error().text();
}

namespace {
template <class Type>
void set_frame(world::Transaction& tx, NodeId node, const Type& type, const GridSpec& g) {
  EXPECT_TRUE(tx.set(node, type.columns, static_cast<std::int64_t>(g.columns)));
  EXPECT_TRUE(tx.set(node, type.rows, static_cast<std::int64_t>(g.rows)));
  EXPECT_TRUE(tx.set(node, type.x_m, g.x_m));
  EXPECT_TRUE(tx.set(node, type.y_m, g.y_m));
  EXPECT_TRUE(tx.set(node, type.spacing_m, g.spacing_m));
}
}  // namespace

NodeId GroundWorld::add_terrain(const GridSpec& g, const HeightFunction& height) {
  const world::types::Terrain type(db->schema());
  NodeId node;
  commit([&](auto& tx) {
    node = *tx.create(type.type);
    set_frame(tx, node, type, g);
    std::vector<float> h;
    for (int r = 0; r < g.rows; ++r) {
      for (int c = 0; c < g.columns; ++c) {
        h.push_back(static_cast<float>(height(g.x_m + c * g.spacing_m, g.y_m - r * g.spacing_m)));
      }
    }
    EXPECT_TRUE(tx.set(node, type.heights_m, Blob::of(std::span<const float>(h))));
  });
  return node;
}

NodeId GroundWorld::add_cover(const GridSpec& g, const std::string& classes,
                              const std::function<int(double, double)>& cell) {
  const world::types::LandCover type(db->schema());
  NodeId node;
  commit([&](auto& tx) {
    node = *tx.create(type.type);
    set_frame(tx, node, type, g);
    std::vector<std::uint8_t> cells;
    for (int r = 0; r < g.rows; ++r) {
      for (int c = 0; c < g.columns; ++c) {
        cells.push_back(static_cast<std::uint8_t>(cell(g.x_m + c * g.spacing_m, g.y_m - r * g.spacing_m)));
      }
    }
    EXPECT_TRUE(tx.set(node, type.cells, Blob::of(std::span<const std::uint8_t>(cells))));
    EXPECT_TRUE(tx.set(node, type.classes, classes));
  });
  return node;
}

NodeId GroundWorld::add_vegetation(const std::string& cover, const std::string& plant, double per_m2,
                                   double height_m, std::int64_t seed) {
  const world::types::GroundVegetation type(db->schema());
  NodeId node;
  commit([&](auto& tx) {
    node = *tx.create(type.type);
    EXPECT_TRUE(tx.set(node, type.cover, cover));
    EXPECT_TRUE(tx.set(node, type.plant, plant));
    EXPECT_TRUE(tx.set(node, type.per_m2, per_m2));
    EXPECT_TRUE(tx.set(node, type.height_m, height_m));
    EXPECT_TRUE(tx.set(node, type.seed, seed));
  });
  return node;
}

NodeId GroundWorld::add_water(std::vector<double> outline, double level_m) {
  const world::types::Water type(db->schema());
  NodeId node;
  commit([&](auto& tx) {
    node = *tx.create(type.type);
    EXPECT_TRUE(tx.set(node, type.outline, world::Numbers(std::move(outline))));
    EXPECT_TRUE(tx.set(node, type.level_m, level_m));
  });
  return node;
}

void GroundWorld::change_heights(NodeId terrain, const std::function<float(int, int, float)>& edit) {
  const world::types::Terrain type(db->schema());
  const auto snapshot = now();
  const auto columns = static_cast<int>(snapshot.get_or_default(terrain, type.columns));
  const auto old = snapshot.get_or_default(terrain, type.heights_m).as<float>();
  std::vector<float> h(old.begin(), old.end());
  for (std::size_t i = 0; i < h.size(); ++i) {
    h[i] = edit(static_cast<int>(i) % columns, static_cast<int>(i) / columns, h[i]);
  }
  commit(
      [&](auto& tx) { EXPECT_TRUE(tx.set(terrain, type.heights_m, Blob::of(std::span<const float>(h)))); });
}

void GroundWorld::follow(render::ContentProvider& provider) {
  provider.rebuild(now());
  subscriptions_.push_back(db->subscribe(
      {}, [&provider](const world::ChangeSet& set, std::span<const world::Change>) { provider.apply(set); }));
}

double hills(double x, double y) {
  return 6 * std::sin(x / 37) * std::cos(y / 29) + 1.3 * std::sin(x / 7.3 + 1) * std::sin(y / 5.1) +
         0.2 * std::sin(x / 1.9) + 0.15 * std::cos(y / 1.3 + x / 3);
}

ContentFrame collect(render::ContentProvider& provider, const ContentQuery& query) {
  ContentFrame frame;
  provider.collect(query, frame);
  return frame;
}

ContentQuery look_from(double x, double y, double z, double allowed_error_rad) {
  ContentQuery q;
  q.eye = {x, y, z};
  q.allowed_error_rad = allowed_error_rad;
  return q;
}

std::vector<Triangle> triangles(const ContentFrame& frame, const std::string& prototype) {
  std::vector<Triangle> out;
  for (const auto& batch : frame.batches) {
    if (batch->prototype->name != prototype) continue;
    const auto& mesh = *batch->prototype->levels[0].mesh;
    const auto corner = [&](std::uint32_t i) -> Eigen::Vector3d {
      const float* p = mesh.vertices[i].position;
      return Eigen::Vector3d(p[0], p[1], p[2]) + batch->origin;
    };
    for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
      out.push_back(
          {corner(mesh.indices[i]), corner(mesh.indices[i + 1]), corner(mesh.indices[i + 2]), batch.get()});
    }
  }
  return out;
}

std::vector<double> heights_at(const std::vector<Triangle>& all, double x, double y) {
  std::vector<double> out;
  const auto cross = [&](const Eigen::Vector3d& p, const Eigen::Vector3d& q) {
    return (q.x() - p.x()) * (y - p.y()) - (q.y() - p.y()) * (x - p.x());
  };
  for (const auto& t : all) {
    const double wa = cross(t.b, t.c), wb = cross(t.c, t.a), wc = cross(t.a, t.b), sum = wa + wb + wc;
    if (sum <= 1e-9 || wa < 0 || wb < 0 || wc < 0) continue;
    out.push_back((wa * t.a.z() + wb * t.b.z() + wc * t.c.z()) / sum);
  }
  return out;
}

double first_hit(const std::vector<Triangle>& all, const Eigen::Vector3d& from,
                 const Eigen::Vector3d& direction) {
  double nearest = std::numeric_limits<double>::infinity();
  for (const auto& t : all) {
    const Eigen::Vector3d e1 = t.b - t.a, e2 = t.c - t.a, p = direction.cross(e2);
    const double det = e1.dot(p);
    if (det <= 1e-14) continue;  // from behind, or along it
    const Eigen::Vector3d s = from - t.a, q = s.cross(e1);
    const double u = s.dot(p) / det, v = direction.dot(q) / det, d = e2.dot(q) / det;
    if (u < 0 || v < 0 || u + v > 1 || d <= 0) continue;
    nearest = std::min(nearest, d);
  }
  return nearest;
}

}  // namespace rigor::ground_test
