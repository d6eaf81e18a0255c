#include <gtest/gtest.h>

#include <chrono>
#include <map>
#include <random>
#include <set>

#include "tests/sim/nature/terrain/ground_world.h"

namespace rigor::ground_test {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

std::set<std::uint64_t> serials(const ContentFrame& f) {
  std::set<std::uint64_t> out;
  for (const auto& b : f.batches) out.insert(b->serial);
  return out;
}

struct Corner {
  double x, y;
};
/// A place within the extent, off the lines on which cells meet.
Corner somewhere(std::mt19937& random, double x0, double x1, double y0, double y1) {
  std::uniform_real_distribution<double> u(0.001, 0.999);
  return {x0 + u(random) * (x1 - x0), y0 + u(random) * (y1 - y0)};
}

TEST(Terrain, HeightsAreBilinearAndNaNOutside) {
  GroundWorld w;
  w.add_terrain({3, 2, 10, 20, 2}, [](double x, double y) { return x + 3 * y + 0.5 * x * y; });
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  for (const auto& p : {Corner{10, 20}, {14, 18}, {11.3, 19.1}, {12, 18}, {13.99, 18.01}}) {
    EXPECT_NEAR(terrain->height_at(p.x, p.y), p.x + 3 * p.y + 0.5 * p.x * p.y, 1e-5);
  }
  for (const auto& p : {Corner{9.99, 19}, {14.01, 19}, {12, 20.01}, {12, 17.99}, {1e9, 0}, {NAN, 0}}) {
    EXPECT_TRUE(std::isnan(terrain->height_at(p.x, p.y)));
    EXPECT_TRUE(std::isnan(terrain->normal_at(p.x, p.y).x()));
  }
}

TEST(Terrain, NormalOfAPlaneIsThatOfThePlane) {
  GroundWorld w;
  w.add_terrain({5, 5}, [](double x, double y) { return 0.3 * x - 0.2 * y; });
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  const Eigen::Vector3d expected = Eigen::Vector3d(-0.3, 0.2, 1).normalized();
  EXPECT_LT((terrain->normal_at(1.7, -2.2) - expected).norm(), 1e-6);
  EXPECT_LT((terrain->normal_at(0, 0) - expected).norm(), 1e-6);
}

// Seen to fail when the error of a block leaves out the parabola along its diagonal.
TEST(Terrain, StatedErrorHoldsAndIsReached) {
  GroundWorld w;
  w.add_terrain({150, 131, -70, 60, 1}, hills);
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  std::mt19937 random(1);
  for (const double allowed : {0.0, 1e-3, 1e-2, 0.1}) {
    const auto frame = collect(*terrain, look_from(3, -2, 12, allowed));
    const auto all = triangles(frame);
    std::map<const Batch*, double> worst;
    double worst_of_all = 0, stated_of_all = 0;
    for (const auto& t : all) {
      if (t.normal().z() <= 1e-9) continue;
      std::uniform_real_distribution<double> u(0, 1);
      for (int k = 0; k < 6; ++k) {
        double a = u(random), b = u(random);
        if (k == 0) a = 0.5, b = 0;  // the diagonal is one of the sides
        if (k == 1) a = 0, b = 0.5;
        if (k == 2) a = 0.5, b = 0.5;
        if (a + b > 1) a = 1 - a, b = 1 - b;
        const Eigen::Vector3d p = t.a + a * (t.b - t.a) + b * (t.c - t.a);
        const double deviation = std::abs(p.z() - terrain->height_at(p.x(), p.y()));
        worst[t.batch] = std::max(worst[t.batch], deviation);
      }
    }
    for (const auto& [batch, deviation] : worst) {
      const double stated = batch->prototype->levels[0].error_m;
      EXPECT_LE(deviation, stated + 2e-5) << allowed;
      worst_of_all = std::max(worst_of_all, deviation);
      stated_of_all = std::max(stated_of_all, stated);
    }
    EXPECT_GT(worst_of_all, 0.5 * stated_of_all) << "the statement is far too cautious";
    if (allowed == 0) {
      EXPECT_LT(worst_of_all, 0.0051);
    }
  }
}

TEST(Terrain, ErrorSubtendsLessThanAllowed) {
  GroundWorld w;
  w.add_terrain({400, 400, -200, 200, 1}, hills);
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  std::size_t before = 0;
  for (const double allowed : {2e-2, 5e-3, 1e-3}) {
    const auto frame = collect(*terrain, look_from(0, 0, 30, allowed));
    for (const auto& b : frame.batches) {
      EXPECT_LE(b->prototype->levels[0].error_m,
                allowed * b->bounds.exteriorDistance(Eigen::Vector3d(0, 0, 30)) + 0.01);
    }
    const auto count = triangles(frame).size();
    EXPECT_GT(count, before);
    before = count;
  }
}

// Seen to fail without skirts.
TEST(Terrain, LevelsMeetWithoutCracks) {
  GroundWorld w;
  w.add_terrain({300, 257, -150, 130, 1}, hills);
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  std::mt19937 random(2);
  const Eigen::Vector3d eye(11, 7, 14);
  const auto frame = collect(*terrain, look_from(eye.x(), eye.y(), eye.z(), 8e-3));
  const auto all = triangles(frame);
  std::set<double> widths;
  double largest = 0;
  for (const auto& b : frame.batches) {
    widths.insert(std::round(b->bounds.sizes().x()));
    largest = std::max<double>(largest, b->prototype->levels[0].error_m);
  }
  ASSERT_GT(widths.size(), 3U) << "tiles of several levels are what is tested";
  ASSERT_GT(largest, 0.05);
  std::uniform_real_distribution<double> u(0, 1), angle(0, 6.283);
  int rays = 0;
  for (const auto& b : frame.batches) {
    for (int k = 0; k < 12; ++k) {
      // A point on an edge of a tile, seen along a flat ray from anywhere.
      const auto lo = b->bounds.min(), hi = b->bounds.max();
      Eigen::Vector3d p(lo.x() + u(random) * (hi.x() - lo.x()), k % 2 ? lo.y() : hi.y(), 0);
      if (k > 5) p = {k % 2 ? lo.x() : hi.x(), lo.y() + u(random) * (hi.y() - lo.y()), 0};
      if (std::abs(p.x()) > 120 || std::abs(p.y()) > 110) continue;
      p.z() = terrain->height_at(p.x(), p.y()) + (u(random) - 0.5) * 2 * largest;
      const double a = angle(random);
      const Eigen::Vector3d direction =
          Eigen::Vector3d(std::cos(a), std::sin(a), -0.15 - u(random)).normalized();
      const Eigen::Vector3d from = p - direction * 60;
      if (from.z() < terrain->height_at(from.x(), from.y()) + 1) continue;
      const double hit = first_hit(all, from, direction);
      const Eigen::Vector3d q = from + direction * hit;
      ++rays;
      ASSERT_TRUE(std::isfinite(hit)) << p.transpose();
      EXPECT_GT(q.z(), terrain->height_at(q.x(), q.y()) - 2 * largest - 0.01)
          << "through the ground at " << p.transpose();
    }
  }
  EXPECT_GT(rays, 200);
}

TEST(Terrain, EdgesOfEqualLevelsAreTheSame) {
  GroundWorld w;
  w.add_terrain({129, 129, 0, 128, 1}, hills);
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  // In full every height of the grid is there, so the edge between two tiles goes through the same heights.
  const auto frame = collect(*terrain, look_from(64, 64, 3000, 0));
  std::map<std::pair<double, double>, std::set<float>> at;
  for (const auto& b : frame.batches) {
    const auto& mesh = *b->prototype->levels[0].mesh;
    for (const auto& v : mesh.vertices) {
      const Eigen::Vector3d p = Eigen::Vector3d(v.position[0], v.position[1], v.position[2]) + b->origin;
      if (std::abs(p.z() - terrain->height_at(p.x(), p.y())) < 1e-4) {
        at[{std::round(p.x() * 64), std::round(p.y() * 64)}].insert(static_cast<float>(p.z()));
      }
    }
  }
  for (int r = 0; r < 129; ++r) {
    for (int c = 0; c < 129; ++c) ASSERT_TRUE(at.contains({c * 64.0, r * 64.0})) << c << ' ' << r;
  }
}

TEST(Terrain, HolesStayHoles) {
  GroundWorld w;
  const auto in_hole = [](double x, double y) {
    return std::hypot(x - 40, y - 30) < 9.3 || (x > 63 && y > 63) || std::abs(x - 20) + std::abs(y) < 1;
  };
  w.add_terrain({65, 65, 0, 64, 1}, [&](double x, double y) { return in_hole(x, y) ? NAN : hills(x, y); });
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  for (const double allowed : {0.0, 2e-3, 0.2}) {
    const auto all = triangles(collect(*terrain, look_from(32, 32, 50, allowed)));
    std::mt19937 random(3);
    for (int k = 0; k < 3000; ++k) {
      const auto p = somewhere(random, 0, 64, 0, 64);
      const bool ground = !std::isnan(terrain->height_at(p.x, p.y));
      ASSERT_EQ(heights_at(all, p.x, p.y).size(), ground ? 1U : 0U) << p.x << ' ' << p.y << ' ' << allowed;
    }
  }
  EXPECT_TRUE(std::isnan(terrain->height_at(40, 30)));
  EXPECT_FALSE(std::isnan(terrain->height_at(30, 30)));  // a height at the rim, beside a hole
}

TEST(Terrain, AllHolesIsNoGround) {
  GroundWorld w;
  w.add_terrain({20, 20}, [](double, double) { return kNaN; });
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  EXPECT_TRUE(collect(*terrain, look_from(5, -5, 10)).batches.empty());
}

// Seen to fail with the order of grids turned round.
TEST(Terrain, FinestGridWinsAndItsHolesShowTheCoarser) {
  GroundWorld w;
  w.add_terrain({33, 33, -80, 80, 5}, [](double, double) { return 1.0; });
  const auto hole = [](double x, double y) { return std::hypot(x - 7, y - 3) < 4; };
  w.add_terrain({41, 31, -13.3, 17.9, 1},
                [&](double x, double y) { return hole(x, y) ? NAN : 4 + 0.01 * x; });
  w.add_terrain({9, 9, 100, 80, 5}, [](double, double) { return 7.0; });
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  EXPECT_NEAR(terrain->height_at(0, 0), 4, 1e-5);
  EXPECT_NEAR(terrain->height_at(7, 3), 1, 1e-5);
  EXPECT_NEAR(terrain->height_at(-60, 0), 1, 1e-5);
  EXPECT_NEAR(terrain->height_at(120, 60), 7, 1e-5);
  for (const double allowed : {0.0, 2e-3, 5e-2}) {
    const auto all = triangles(collect(*terrain, look_from(0, 0, 40, allowed)));
    std::mt19937 random(4);
    int doubled = 0;
    for (int k = 0; k < 4000; ++k) {
      const auto p = somewhere(random, -80, 80, -80, 80);
      auto z = heights_at(all, p.x, p.y);
      ASSERT_FALSE(z.empty()) << p.x << ' ' << p.y;
      doubled += z.size() > 1;
      EXPECT_NEAR(*std::max_element(z.begin(), z.end()), terrain->height_at(p.x, p.y), 0.02)
          << p.x << ' ' << p.y;
    }
    EXPECT_LT(doubled, 4000 * 142 * 1.0 / 25600) << "overlap beyond one fine cell around the border";
  }
}

TEST(Terrain, EqualSpacingGoesByNodeId) {
  GroundWorld w;
  w.add_terrain({9, 9, 0, 8, 1}, [](double, double) { return 1.0; });
  w.add_terrain({9, 9, 4, 8, 1}, [](double, double) { return 2.0; });
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  EXPECT_EQ(terrain->height_at(6, 4), 1);
  EXPECT_EQ(terrain->height_at(10, 4), 2);
  const auto all = triangles(collect(*terrain, look_from(6, 4, 10)));
  EXPECT_EQ(heights_at(all, 6.3, 4.4).size(), 1U);
}

TEST(Terrain, SmallGrids) {
  GroundWorld w;
  w.add_terrain({1, 1, 0, 0, 10}, [](double, double) { return 1.0; });
  w.add_terrain({7, 1, 0, 0, 10}, [](double, double) { return 1.0; });
  w.add_terrain({2, 2, 100, 10, 10}, [](double x, double) { return x > 105 ? 3.0 : 1.0; });
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  EXPECT_EQ(terrain->warnings().size(), 2U);
  EXPECT_NEAR(terrain->height_at(105, 5), 2, 1e-6);
  const auto all = triangles(collect(*terrain, look_from(105, 5, 20)));
  EXPECT_NEAR(heights_at(all, 103, 4).at(0), 1.6, 1e-4);
}

TEST(Terrain, WrongBlobsAreToldOfAndTheRestIsShown) {
  GroundWorld w;
  const auto empty = w.add_terrain({4, 4}, hills);
  const auto wrong = w.add_terrain({4, 4}, hills);
  w.add_terrain({4, 4, 50, 50, 1}, hills);
  const world::types::Terrain type(w.db->schema());
  w.commit([&](auto& tx) {
    EXPECT_TRUE(tx.set(empty, type.heights_m, world::Blob()));
    EXPECT_TRUE(tx.set(wrong, type.columns, std::int64_t{5}));
  });
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  ASSERT_EQ(terrain->warnings().size(), 2U);
  EXPECT_NE(terrain->warnings()[1].find("expected 80 bytes"), std::string::npos) << terrain->warnings()[1];
  EXPECT_FALSE(collect(*terrain, look_from(51, 49, 10)).batches.empty());
}

TEST(Terrain, EmptyWorldHasNoGround) {
  GroundWorld w;
  auto terrain = nature::make_terrain_provider();
  EXPECT_TRUE(std::isnan(terrain->height_at(0, 0)));
  w.follow(*terrain);
  EXPECT_TRUE(std::isnan(terrain->height_at(0, 0)));
  EXPECT_TRUE(collect(*terrain, look_from(0, 0, 0)).batches.empty());
  EXPECT_TRUE(terrain->warnings().empty());
}

TEST(Terrain, TenKilometresFarFromTheOrigin) {
  GroundWorld w;
  const double x0 = 4.1e6, y0 = -5.3e6;
  w.add_terrain({1001, 1001, x0, y0 + 10'000, 10},
                [&](double x, double y) { return 60 * hills((x - x0) / 40, (y - y0) / 40); });
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  const double ground = terrain->height_at(x0 + 5003, y0 + 5001);
  const auto start = std::chrono::steady_clock::now();
  const auto frame = collect(*terrain, look_from(x0 + 5003, y0 + 5001, ground + 1.7));
  const double ms =
      std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
  const auto all = triangles(frame);
  std::printf("10 km, all round: %zu tiles, %zu triangles, first time %.0f ms\n", frame.batches.size(),
              all.size(), ms);
  EXPECT_LT(all.size(), 600'000U);
  std::mt19937 random(5);
  for (int k = 0; k < 200; ++k) {
    const auto p = somewhere(random, x0 + 4993, x0 + 5013, y0 + 4991, y0 + 5011);
    const auto z = heights_at(all, p.x, p.y);
    ASSERT_EQ(z.size(), 1U);
    EXPECT_NEAR(z[0], terrain->height_at(p.x, p.y), 0.03);
  }
}

TEST(Terrain, SameQuerySameObjectsWhateverWasAskedBetween) {
  GroundWorld w;
  w.add_terrain({129, 129, -64, 64, 1}, hills);
  auto a = nature::make_terrain_provider(), b = nature::make_terrain_provider();
  w.follow(*a);
  w.follow(*b);
  const auto query = look_from(3, 4, 10);
  const auto first = collect(*a, query);
  EXPECT_EQ(serials(first), serials(collect(*a, query)));
  for (int k = 0; k < 5; ++k) (void)collect(*a, look_from(-50 + 20 * k, 10, 5, 5e-3));
  EXPECT_EQ(serials(first), serials(collect(*a, query)));
  // Another provider with another past: the same content, byte by byte.
  for (int k = 0; k < 3; ++k) (void)collect(*b, look_from(40, -20 * k, 7, 1e-2));
  const auto other = collect(*b, query);
  ASSERT_EQ(first.batches.size(), other.batches.size());
  for (std::size_t i = 0; i < first.batches.size(); ++i) {
    const auto &m = *first.batches[i]->prototype->levels[0].mesh,
               &n = *other.batches[i]->prototype->levels[0].mesh;
    ASSERT_EQ(m.vertices.size(), n.vertices.size());
    EXPECT_EQ(0,
              std::memcmp(m.vertices.data(), n.vertices.data(), m.vertices.size() * sizeof(render::Vertex)));
    EXPECT_EQ(m.indices, n.indices);
    EXPECT_EQ(m.parts[0].surface->colour_map->rgba, n.parts[0].surface->colour_map->rgba);
  }
}

// Seen to fail when an edit forgets the tree's errors, and when it forgets no tile.
void edit_touches_only_its_tiles(float bump) {
  GroundWorld w;
  const auto node = w.add_terrain({257, 257, 0, 256, 1}, hills);
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  const auto query = look_from(128, 128, 20, 4e-3);
  const auto before = collect(*terrain, query);
  w.change_heights(node,
                   [&](int c, int r, float h) { return std::hypot(c - 200, r - 60) < 6 ? h + bump : h; });
  EXPECT_NEAR(terrain->height_at(200, 256 - 60), hills(200, 196) + static_cast<double>(bump), 1e-4);
  const auto after = collect(*terrain, query);
  const auto old = serials(before);
  std::size_t kept = 0, made = 0;
  for (const auto& b : after.batches) {
    const bool near = b->bounds.min().x() <= 205 && b->bounds.max().x() >= 195 &&
                      b->bounds.min().y() <= 201 && b->bounds.max().y() >= 191;
    const bool same = old.contains(b->serial);
    EXPECT_FALSE(near && same) << "an old tile where the ground has changed";
    (same ? kept : made) += 1;
  }
  EXPECT_GT(kept, 2 * made);
  auto fresh = nature::make_terrain_provider();
  fresh->rebuild(w.now());
  const auto expected = collect(*fresh, query);
  ASSERT_EQ(expected.batches.size(), after.batches.size());
  for (std::size_t i = 0; i < after.batches.size(); ++i) {
    const auto &m = *after.batches[i]->prototype->levels[0].mesh,
               &n = *expected.batches[i]->prototype->levels[0].mesh;
    ASSERT_EQ(m.vertices.size(), n.vertices.size());
    EXPECT_EQ(0,
              std::memcmp(m.vertices.data(), n.vertices.data(), m.vertices.size() * sizeof(render::Vertex)));
    EXPECT_EQ(after.batches[i]->prototype->levels[0].error_m,
              expected.batches[i]->prototype->levels[0].error_m);
  }
}
TEST(Terrain, EditTouchesOnlyItsTiles) {
  edit_touches_only_its_tiles(8.0F);
  edit_touches_only_its_tiles(0.01F);  // too little for other levels of detail: the same tiles, made anew
}

TEST(Terrain, UndoBringsTheGroundBack) {
  GroundWorld w;
  const auto node = w.add_terrain({33, 33, 0, 32, 1}, hills);
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  w.change_heights(node, [](int, int, float h) { return h + 5; });
  EXPECT_NEAR(terrain->height_at(7, 9), hills(7, 9) + 5, 1e-4);
  ASSERT_TRUE(w.db->undo());
  EXPECT_NEAR(terrain->height_at(7, 9), hills(7, 9), 1e-4);
  w.commit([&](auto& tx) { EXPECT_TRUE(tx.remove(node)); });
  EXPECT_TRUE(std::isnan(terrain->height_at(7, 9)));
  EXPECT_TRUE(collect(*terrain, look_from(7, 9, 10)).batches.empty());
}

TEST(Terrain, MovedGridIsShownWhereItIs) {
  GroundWorld w;
  const auto node = w.add_terrain({17, 17, 0, 16, 1}, [](double, double) { return 2.0; });
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  (void)collect(*terrain, look_from(8, 8, 10));
  const world::types::Terrain type(w.db->schema());
  w.commit([&](auto& tx) { EXPECT_TRUE(tx.set(node, type.x_m, 100.0)); });
  const auto all = triangles(collect(*terrain, look_from(8, 8, 10)));
  EXPECT_TRUE(heights_at(all, 8.2, 8.3).empty());
  EXPECT_EQ(heights_at(all, 108.2, 8.3).size(), 1U);
}

// Triangles are pruned by frustum and range.
TEST(Terrain, NothingBehindTheEyeOrBeyondRange) {
  GroundWorld w;
  w.add_terrain({401, 401, -200, 200, 1}, hills);
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  auto query = look_from(0, 0, 10);
  query.frustum = {Eigen::Hyperplane<double, 3>(Eigen::Vector3d(1, 0, 0), 0.0)};
  query.far_m = 120;
  const auto frame = collect(*terrain, query);
  ASSERT_FALSE(frame.batches.empty());
  for (const auto& b : frame.batches) {
    EXPECT_GE(b->bounds.max().x(), 0);
    EXPECT_LE(b->bounds.exteriorDistance(query.eye), 120);
  }
}

}  // namespace
}  // namespace rigor::ground_test
