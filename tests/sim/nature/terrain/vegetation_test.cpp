#include <gtest/gtest.h>

#include <cstring>
#include <map>
#include <set>
#include <tuple>

#include "sim/nature/terrain/plants.h"
#include "tests/sim/nature/terrain/ground_world.h"

namespace rigor::ground_test {
namespace {

using nature::Plant;

/// Terrain and its plants, in the order in which a view holds them.
struct Meadow {
  Meadow()
      : terrain(nature::make_terrain_provider()), plants(nature::make_ground_vegetation_provider(terrain)) {}
  void start() {
    w.follow(*terrain);
    w.follow(*plants);
  }
  GroundWorld w;
  std::shared_ptr<nature::TerrainProvider> terrain;
  std::unique_ptr<render::ContentProvider> plants;
};

struct Placed {
  double x, y, z, wide, tall;
  NodeId node;
};
std::vector<Placed> placed(const ContentFrame& frame) {
  std::vector<Placed> out;
  for (const auto& b : frame.batches) {
    for (const auto& i : b->instances) {
      const Eigen::Vector3d p = b->origin + Eigen::Vector3d(i.position[0], i.position[1], i.position[2]);
      out.push_back({p.x(), p.y(), p.z(), i.scale[0], i.scale[2], b->node});
    }
  }
  return out;
}
std::size_t count_in(const std::vector<Placed>& all, double x0, double y0, double x1, double y1) {
  return static_cast<std::size_t>(std::count_if(all.begin(), all.end(), [&](const Placed& p) {
    return p.x >= x0 && p.x < x1 && p.y >= y0 && p.y < y1;
  }));
}
std::set<std::uint64_t> serials(const ContentFrame& f) {
  std::set<std::uint64_t> out;
  for (const auto& b : f.batches) out.insert(b->serial);
  return out;
}
double flat(double, double) { return 12.0; }
int first_class(double, double) { return 0; }

TEST(GroundVegetation, AsManyPlantsAsStated) {
  for (const double per_m2 : {0.003, 0.05, 1.0, 30.0, 90.0}) {
    Meadow m;
    m.w.add_terrain({121, 121, -60, 60, 1}, flat);
    m.w.add_cover({13, 13, -60, 60, 10}, "grass", first_class);
    m.w.add_vegetation("grass", "grass", per_m2, 0.2);
    m.start();
    const auto all = placed(collect(*m.plants, look_from(0, 0, 14, 0)));
    // Counts per cell are rounded at random, so they vary less than those of a Poisson process.
    const double expected = per_m2 * 100 * 100;
    EXPECT_NEAR(static_cast<double>(count_in(all, -50, -50, 50, 50)), expected, 3 * std::sqrt(expected))
        << per_m2;
    // No corner is favoured.
    EXPECT_NEAR(static_cast<double>(count_in(all, -50, -50, 0, 0)), expected / 4,
                4 * std::sqrt(expected / 4) + 1);
  }
}

TEST(GroundVegetation, ThinningKeepsTheCover) {
  Meadow m;
  m.w.add_terrain({401, 401, -400, 400, 2}, flat);
  m.w.add_cover({81, 81, -400, 400, 10}, "meadow", first_class);
  m.w.add_vegetation("meadow", "grass", 20, 0.4);
  m.start();
  const auto all = placed(collect(*m.plants, look_from(0, 0, 13, 2e-3)));
  std::map<int, std::size_t> of_width;
  for (int ring = 0; ring < 5; ++ring) {
    const double r0 = ring * 36, r1 = r0 + 36;
    double area = 0;
    for (const auto& p : all) {
      const double r = std::hypot(p.x, p.y);
      if (r >= r0 && r < r1) area += p.wide * p.wide / p.tall;  // 1 for a plant that stands for itself
      of_width[static_cast<int>(std::lround(std::log2(p.wide / std::sqrt(p.tall))))]++;
    }
    const double full = 20 * 3.14159 * (r1 * r1 - r0 * r0);
    EXPECT_NEAR(area / full, 1, 0.06) << "ring from " << r0;
  }
  EXPECT_GE(of_width.size(), 3U) << "several steps of thinning are what is tested";
  EXPECT_LT(all.size(), 400'000U);
  // Beyond 280 m a plant of 0.56 m subtends less than the error.
  for (const auto& p : all) EXPECT_LT(std::hypot(p.x, p.y), 330);
}

TEST(GroundVegetation, PlantsStandOnTheGround) {
  Meadow m;
  m.w.add_terrain({81, 81, 4e6 - 40, 5e6 + 40, 1},
                  [](double x, double y) { return hills(x - 4e6, y - 5e6); });
  m.w.add_cover({9, 9, 4e6 - 40, 5e6 + 40, 10}, "grass", first_class);
  m.w.add_vegetation("grass", "fern", 2, 0.6);
  m.w.add_vegetation("grass", "litter", 3, 0.08);
  m.start();
  const auto all = placed(collect(*m.plants, look_from(4e6, 5e6, 10)));
  ASSERT_GT(all.size(), 1000U);
  for (const auto& p : all) ASSERT_NEAR(p.z, m.terrain->height_at(p.x, p.y), 0.01);
}

TEST(GroundVegetation, NothingOnWaterRoadsRockWallsHolesOrOtherCover) {
  Meadow m;
  m.w.add_terrain({101, 101, 0, 100, 1}, [](double x, double y) {
    if (std::hypot(x - 80, y - 20) < 6) return std::numeric_limits<double>::quiet_NaN();
    return x < 20 ? 60 - 3 * x : 0.0;
  });
  m.w.add_cover({11, 11, 0, 100, 10}, "grass soil", [](double, double y) { return y > 65 ? 1 : 0; });
  m.w.add_vegetation("grass", "grass", 4, 0.2);
  m.w.add_water({40, 0, 60, 0, 60, 20, 40, 20}, 0.1);
  const world::types::Road road(m.w.db->schema());
  m.w.commit([&](auto& tx) {
    const auto node = *tx.create(road.type);
    EXPECT_TRUE(tx.set(node, road.line, world::Numbers{25, 40, 100, 40}));
    EXPECT_TRUE(tx.set(node, road.width_m, 5.0));
  });
  m.start();
  const auto all = placed(collect(*m.plants, look_from(50, 50, 10, 0)));
  EXPECT_GT(count_in(all, 25, 22, 70, 37), 2000U);
  EXPECT_EQ(count_in(all, 40, 0, 60, 20), 0U);
  EXPECT_EQ(count_in(all, 25, 37.5, 100, 42.5), 0U);
  EXPECT_EQ(count_in(all, 0, 0, 18.9, 100), 0U);
  EXPECT_EQ(count_in(all, 76, 16, 84, 24), 0U);
  EXPECT_EQ(count_in(all, 0, 76, 100, 100), 0U);
}

TEST(GroundVegetation, SamePlantsWhateverWasAskedBefore) {
  const auto build = [](Meadow& m) {
    m.w.add_terrain({161, 161, -80, 80, 1}, hills);
    m.w.add_cover({33, 33, -80, 80, 5}, "grass forest_floor",
                  [](double x, double y) { return std::sin(x / 11) * std::sin(y / 13) > 0 ? 1 : 0; });
    m.w.add_vegetation("grass", "grass", 20, 0.25);
    m.w.add_vegetation("forest_floor", "fern", 0.7, 0.6);
    m.start();
  };
  Meadow a, b;
  build(a);
  build(b);
  const auto query = look_from(3, 5, 9);
  const auto first = collect(*a.plants, query);
  for (int k = 0; k < 4; ++k) (void)collect(*b.plants, look_from(-60 + 30 * k, 11 * k, 8, 1e-3 * (k + 1)));
  const auto other = collect(*b.plants, query);
  ASSERT_EQ(first.batches.size(), other.batches.size());
  ASSERT_GT(first.batches.size(), 20U);
  for (std::size_t i = 0; i < first.batches.size(); ++i) {
    const auto &p = first.batches[i]->instances, &q = other.batches[i]->instances;
    ASSERT_EQ(p.size(), q.size());
    EXPECT_EQ(0, std::memcmp(p.data(), q.data(), p.size() * sizeof(render::Instance)));
  }
  EXPECT_EQ(serials(first), serials(collect(*a.plants, query)));
}

TEST(GroundVegetation, EyesInOneCellGetOneAnswerThatIsFineEnoughForEachOfThem) {
  Meadow m;
  m.w.add_terrain({161, 161, -80, 80, 1}, hills);
  m.w.add_cover({33, 33, -80, 80, 5}, "grass", [](double, double) { return 0; });
  m.w.add_vegetation("grass", "grass", 20, 0.25);
  m.start();
  ContentQuery query;
  query.allowed_error_rad = 2e-3;
  std::set<std::set<std::uint64_t>> answers;
  for (const auto& [x, y] : {std::pair{4.1, 6.1}, {5.9, 7.9}, {4.5, 7.5}}) {
    query.look_from_cell_of({x, y, 9.5});
    ContentFrame frame;
    m.terrain->collect(query, frame);
    m.plants->collect(query, frame);
    answers.insert(serials(frame));
    // The same eye alone asks for no more plants, nor for finer ground, anywhere.
    ContentQuery alone;
    alone.allowed_error_rad = query.allowed_error_rad;
    alone.eye = {x, y, 9.5};
    const auto few = collect(*m.plants, alone), ground = collect(*m.terrain, alone);
    EXPECT_LE(placed(few).size(), placed(frame).size());
    const auto finest = [](const ContentFrame& f, double px, double py) {
      double error = 1e9;
      for (const auto& b : f.batches)
        if (b->prototype->name == "ground" && b->bounds.min().x() <= px && px <= b->bounds.max().x() &&
            b->bounds.min().y() <= py && py <= b->bounds.max().y())
          error = std::min(error, static_cast<double>(b->prototype->levels[0].error_m));
      return error;
    };
    for (double px = -70.3; px < 75; px += 7)
      for (double py = -70.3; py < 75; py += 7)
        EXPECT_LE(finest(frame, px, py), std::max(finest(ground, px, py), 0.02)) << px << " " << py;
  }
  EXPECT_EQ(answers.size(), 1U);
  query.look_from_cell_of({6.1, 7.9, 9.5});
  EXPECT_FALSE(answers.contains(serials(collect(*m.plants, query))));
}

TEST(GroundVegetation, InFullWithinADistanceAndThinnedBeyond) {
  Meadow m;
  m.w.add_terrain({161, 161, -80, 80, 1}, flat);
  m.w.add_cover({33, 33, -80, 80, 5}, "grass", [](double, double) { return 0; });
  m.w.add_vegetation("grass", "grass", 20, 0.25);
  m.start();
  ContentQuery query = look_from(0, 0, 13);
  query.allowed_error_rad = 0;
  const auto full = placed(collect(*m.plants, query));
  query.allowed_error_rad = 5e-3;
  const auto thin = placed(collect(*m.plants, query));
  query.full_within_m = 30;
  const auto both = placed(collect(*m.plants, query));
  EXPECT_EQ(count_in(both, -20, -20, 20, 20), count_in(full, -20, -20, 20, 20));
  EXPECT_LT(count_in(thin, -20, -20, 20, 20), count_in(full, -20, -20, 20, 20));
  EXPECT_LT(count_in(both, 60, -80, 80, 80), count_in(full, 60, -80, 80, 80));
}

TEST(GroundVegetation, ThinnedPlantsAreSomeOfThoseInFull) {
  Meadow m;
  m.w.add_terrain({101, 101, -50, 50, 1}, flat);
  m.w.add_cover({11, 11, -50, 50, 10}, "grass", first_class);
  m.w.add_vegetation("grass", "grass", 10, 1.2);
  m.start();
  std::set<std::pair<double, double>> full;
  for (const auto& p : placed(collect(*m.plants, look_from(0, 0, 13, 0)))) {
    for (const double dx : {-0.5, 0.0, 0.5}) {
      for (const double dy : {-0.5, 0.0, 0.5})
        full.insert({std::round(p.x * 1000 + dx), std::round(p.y * 1000 + dy)});
    }
  }
  const auto thinned = placed(collect(*m.plants, look_from(0, 0, 63, 4e-3)));
  ASSERT_LT(thinned.size(), full.size() / 3);
  ASSERT_GT(thinned.size(), full.size() / 100);
  for (const auto& p : thinned) ASSERT_TRUE(full.contains({std::round(p.x * 1000), std::round(p.y * 1000)}));
}

TEST(GroundVegetation, EditOfTheGroundMovesItsPlantsAlone) {
  Meadow m;
  const auto node = m.w.add_terrain({129, 129, 0, 128, 1}, flat);
  m.w.add_cover({14, 14, 0, 130, 10}, "grass", first_class);
  m.w.add_vegetation("grass", "grass", 10, 0.3);
  m.start();
  const auto query = look_from(64, 64, 14);
  const auto before = serials(collect(*m.plants, query));
  m.w.change_heights(node, [](int c, int r, float h) { return std::hypot(c - 30, r - 90) < 5 ? h + 2 : h; });
  const auto frame = collect(*m.plants, query);
  std::size_t kept = 0;
  for (const auto& b : frame.batches) kept += before.contains(b->serial);
  EXPECT_GT(kept, frame.batches.size() * 8 / 10);
  EXPECT_LT(kept, frame.batches.size());
  for (const auto& p : placed(frame)) ASSERT_NEAR(p.z, m.terrain->height_at(p.x, p.y), 0.01);
}

TEST(GroundVegetation, NothingWithoutNodesCoverOrGround) {
  Meadow bare;
  bare.start();
  EXPECT_TRUE(collect(*bare.plants, look_from(0, 0, 2)).batches.empty());
  Meadow no_cover;
  no_cover.w.add_terrain({9, 9}, flat);
  no_cover.w.add_vegetation("grass", "grass", 10, 0.3);
  no_cover.start();
  EXPECT_TRUE(collect(*no_cover.plants, look_from(0, 0, 14)).batches.empty());
  Meadow no_ground;
  no_ground.w.add_cover({9, 9, 0, 80, 10}, "grass", first_class);
  no_ground.w.add_vegetation("grass", "grass", 10, 0.3);
  no_ground.w.add_vegetation("grass", "grass", 0, 0.3);
  no_ground.start();
  EXPECT_TRUE(collect(*no_ground.plants, look_from(40, 40, 2)).batches.empty());
  EXPECT_TRUE(no_ground.plants->warnings().empty());
}

TEST(GroundVegetation, CapLeavesOutTheFarthestAndSaysSo) {
  Meadow m;
  m.w.add_terrain({101, 101, -500, 500, 10}, flat);
  m.w.add_cover({101, 101, -500, 500, 10}, "grass", first_class);
  m.w.add_vegetation("grass", "grass", 50, 0.3);
  m.start();
  const auto all = placed(collect(*m.plants, look_from(0, 0, 14, 0)));
  EXPECT_LE(all.size(), 2'010'000U);
  EXPECT_GT(all.size(), 1'900'000U);
  ASSERT_EQ(m.plants->warnings().size(), 1U);
  EXPECT_NE(m.plants->warnings()[0].find("left out"), std::string::npos);
  EXPECT_NEAR(static_cast<double>(count_in(all, -40, -40, 40, 40)), 50 * 6400, 3 * std::sqrt(50 * 6400));
  (void)collect(*m.plants, look_from(0, 0, 14));
  EXPECT_TRUE(m.plants->warnings().empty());
}

TEST(GroundVegetation, BatchesAreBoundedByTheirBoxes) {
  Meadow m;
  m.w.add_terrain({65, 65, 0, 64, 1}, hills);
  m.w.add_cover({8, 8, 0, 70, 10}, "grass", first_class);
  for (const char* plant : {"grass", "fern", "shrub", "flower", "litter"})
    m.w.add_vegetation("grass", plant, 1, 0.5);
  m.start();
  for (const auto& b : collect(*m.plants, look_from(32, 32, 10)).batches) {
    for (const auto& i : b->instances) {
      const Eigen::Quaternionf q(i.rotation[3], i.rotation[0], i.rotation[1], i.rotation[2]);
      EXPECT_NEAR(q.norm(), 1, 1e-5);
      for (const auto& level : b->prototype->levels) {
        for (const auto& v : level.mesh->vertices) {
          const Eigen::Vector3f scaled(v.position[0] * i.scale[0], v.position[1] * i.scale[1],
                                       v.position[2] * i.scale[2]);
          const Eigen::Vector3f relative =
              q * scaled + Eigen::Vector3f(i.position[0], i.position[1], i.position[2]);
          const Eigen::Vector3d p = b->origin + relative.cast<double>();
          ASSERT_LE(b->bounds.exteriorDistance(p), 1e-4) << b->prototype->name;
        }
      }
    }
  }
}

TEST(GroundVegetation, PrototypesAreSound) {
  for (const auto plant : {Plant::grass, Plant::fern, Plant::shrub, Plant::flower, Plant::litter}) {
    const auto p = nature::plant_prototype(plant, 0.8, 1);
    ASSERT_GE(p->levels.size(), 3U) << p->name;
    EXPECT_EQ(p->levels[0].error_m, 0);
    std::size_t more = 100'000;
    float error = -1;
    for (const auto& level : p->levels) {
      EXPECT_GT(level.error_m, error);
      error = level.error_m;
      const auto& mesh = *level.mesh;
      EXPECT_LT(mesh.indices.size(), more) << p->name;
      more = mesh.indices.size();
      std::size_t covered = 0;
      for (const auto& part : mesh.parts) {
        EXPECT_EQ(part.first_index, covered);
        covered += part.index_count;
        ASSERT_TRUE(part.surface);
        for (std::size_t b = 0; b < 6; ++b) {
          EXPECT_LE(part.surface->reflectance[b], 1.0F);
          EXPECT_GE(part.surface->transmittance[b], 0.0F);
        }
      }
      EXPECT_EQ(covered, mesh.indices.size());
      for (const auto i : mesh.indices) ASSERT_LT(i, mesh.vertices.size());
      for (const auto& v : mesh.vertices) {
        EXPECT_NEAR(Eigen::Vector3f(v.normal[0], v.normal[1], v.normal[2]).norm(), 1, 1e-4) << p->name;
      }
      if (plant != Plant::litter) {
        EXPECT_NEAR(mesh.bounds.max().z(), 0.8, 1e-5) << p->name;
      }
      EXPECT_GE(mesh.bounds.min().z(), plant == Plant::litter ? -0.3 : -0.01);
    }
    EXPECT_EQ(p->levels[0].mesh->vertices.size(),
              nature::plant_prototype(plant, 0.8, 1)->levels[0].mesh->vertices.size());
  }
}

TEST(GroundVegetation, CardsKeepTheMeanOfTheirSurface) {
  for (const auto card :
       {nature::Card::blade, nature::Card::tuft, nature::Card::frond, nature::Card::fern_side,
        nature::Card::leaves, nature::Card::leaf, nature::Card::head}) {
    const auto& picture = nature::card_picture(card);
    const auto& t = *picture.texture;
    double sum[4] = {};
    for (std::size_t i = 0; i < t.rgba.size(); i += 4) {
      const double a = t.rgba[i + 3] / 255.0;
      for (std::size_t c = 0; c < 3; ++c) {
        const double e = t.rgba[i + c] / 255.0;
        sum[c] += a * (e <= 0.04045 ? e / 12.92 : std::pow((e + 0.055) / 1.055, 2.4));
      }
      sum[3] += a;
    }
    for (std::size_t c = 0; c < 3; ++c) EXPECT_NEAR(sum[c] / sum[3], picture.mean[c], 0.01);
    EXPECT_GT(picture.coverage, 0.12F) << static_cast<int>(card);
    EXPECT_LE(picture.coverage, 1.0F);
  }
}

}  // namespace
}  // namespace rigor::ground_test
