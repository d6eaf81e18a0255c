// What the ground reflects, and its waters.
#include <gtest/gtest.h>

#include "sim/nature/terrain/noise.h"
#include "tests/sim/nature/terrain/ground_world.h"

namespace rigor::ground_test {
namespace {

double linear(std::uint8_t byte) {
  static const auto table = [] {
    std::array<double, 256> t{};
    for (int i = 0; i < 256; ++i) {
      const double e = i / 255.0;
      t[i] = e <= 0.04045 ? e / 12.92 : std::pow((e + 0.055) / 1.055, 2.4);
    }
    return t;
  }();
  return table[byte];
}

struct Reflectance {
  std::array<double, 6> mean{};
  double sigma_green = 0;
};
/// Of all texels of all tiles of a frame.
Reflectance reflectance(const ContentFrame& frame) {
  Reflectance out;
  double count = 0, square = 0;
  for (const auto& b : frame.batches) {
    if (b->prototype->name != "ground") continue;
    const auto& s = *b->prototype->levels[0].mesh->parts[0].surface;
    for (std::size_t i = 0; i < s.colour_map->rgba.size(); i += 4) {
      for (std::size_t k = 0; k < 3; ++k) {
        out.mean[k] += s.reflectance[k] * linear(s.colour_map->rgba[i + k]);
        out.mean[k + 3] += s.reflectance[k + 3] * linear(s.near_infrared_map->rgba[i + k]);
      }
      const double green = linear(s.colour_map->rgba[i + 1]);
      square += green * green;
      count += 1;
    }
  }
  for (double& m : out.mean) m /= count;
  out.sigma_green = std::sqrt(square / count - out.mean[1] * out.mean[1]);
  return out;
}

Reflectance of_cover(const std::string& word, double slope = 0, double allowed = 2e-3) {
  GroundWorld w;
  w.add_terrain({65, 65, 0, 64, 1}, [&](double x, double) { return slope * x; });
  if (!word.empty()) w.add_cover({9, 9, 0, 64, 8}, word, [](double, double) { return 0; });
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  return reflectance(collect(*terrain, look_from(32, 32, 32 * slope + 3, allowed)));
}

TEST(GroundLook, PlantsAreBrightInTheNearInfraredAndSoilIsNot) {
  const auto grass = of_cover("grass"), soil = of_cover("soil"), snow = of_cover("snow");
  EXPECT_GT(grass.mean[3], 3 * grass.mean[0]);
  EXPECT_GT(grass.mean[1], grass.mean[0] * 0.95);
  EXPECT_GT(soil.mean[0], soil.mean[1]);
  EXPECT_LT(soil.mean[3], 2.5 * soil.mean[0]);
  EXPECT_GT(snow.mean[1], 0.85);
  EXPECT_LT(snow.mean[5], 0.15);
}

TEST(GroundLook, MeanStaysFromLevelToLevelAndDetailGoes) {
  const auto near = of_cover("forest_floor", 0, 1e-3), far = of_cover("forest_floor", 0, 0.2);
  for (std::size_t b = 0; b < 6; ++b) EXPECT_NEAR(near.mean[b] / far.mean[b], 1, 0.15) << b;
  EXPECT_GT(near.sigma_green, far.sigma_green);
}

TEST(GroundLook, WithoutCoverGrassIsOnGentleSlopesAndRockOnSteepOnes) {
  const auto gentle = of_cover("", 0.1), steep = of_cover("", 2.0), rock = of_cover("rock");
  EXPECT_GT(gentle.mean[3], 2.5 * gentle.mean[0]);
  EXPECT_LT(steep.mean[3], 1.6 * steep.mean[0]);
  EXPECT_NEAR(steep.mean[1], rock.mean[1], 0.05);
}

TEST(GroundLook, TilesOfOneCoverAreThoseOfTilesWithSeveralAwayFromBorders) {
  // Steep in the east, so that soil and rock come through.
  const auto height = [](double x, double) { return 0.01 * x * x; };
  const auto frame_of = [&](bool odd_cells) {
    GroundWorld w;
    w.add_terrain({129, 129, 0, 128, 1}, height);
    w.add_cover({129, 129, 0, 128, 1}, "forest_floor snow", [&](double x, double y) {
      return odd_cells && std::fmod(x, 16) == 8 && std::fmod(y, 16) == 8 ? 1 : 0;
    });
    auto terrain = nature::make_terrain_provider();
    w.follow(*terrain);
    return collect(*terrain, look_from(64, 64, 45, 4e-3));
  };
  const ContentFrame one = frame_of(false), several = frame_of(true);
  ASSERT_EQ(one.batches.size(), several.batches.size());
  std::size_t compared = 0, different = 0;
  for (std::size_t k = 0; k < one.batches.size(); ++k) {
    const auto& a = *one.batches[k]->prototype->levels[0].mesh->parts[0].surface;
    const auto& b = *several.batches[k]->prototype->levels[0].mesh->parts[0].surface;
    const Eigen::AlignedBox3d& box = one.batches[k]->bounds;
    const int n = static_cast<int>(a.colour_map->width);
    for (int row = 0; row < n; ++row) {
      for (int column = 0; column < n; ++column) {
        const double x = box.min().x() + (box.max().x() - box.min().x()) * column / (n - 1),
                     y = box.max().y() - (box.max().y() - box.min().y()) * row / (n - 1);
        // Odd cells count up to one cell from their centres.
        if (std::abs(std::remainder(x - 8, 16)) < 1.01 && std::abs(std::remainder(y - 8, 16)) < 1.01)
          continue;
        const auto at = 4 * (static_cast<std::ptrdiff_t>(row) * n + column);
        const auto same = [&](const render::Texture& p, const render::Texture& q) {
          return std::equal(p.rgba.begin() + at, p.rgba.begin() + at + 4, q.rgba.begin() + at);
        };
        ++compared;
        different += !same(*a.colour_map, *b.colour_map) || !same(*a.near_infrared_map, *b.near_infrared_map);
      }
    }
  }
  EXPECT_GT(compared, 100'000U);
  EXPECT_EQ(different, 0U);
}

TEST(GroundNoise, RastersAreTheNoiseAtTheirPlaces) {
  const nature::FractalNoise noise{.stream = 7, .longest = 4, .shortest = -3, .gain = 0.85};
  // Across the origin, where lattice numbers change their sign, and far from it.
  for (const nature::RasterPlaces places :
       {nature::RasterPlaces{-3.3, 2.1, 0.05, 100}, nature::RasterPlaces{5e6 + 0.7, -4e6, 0.06, 33},
        nature::RasterPlaces{-20, 40, 0.0625, 128}}) {
    const auto raster = nature::noise_over(noise, places);
    EXPECT_EQ(raster.missing_sigma, 0);
    for (int j = 0; j < places.n; ++j) {
      for (int i = 0; i < places.n; ++i) {
        ASSERT_NEAR(raster.values[static_cast<std::size_t>(j) * places.n + i],
                    nature::noise_at(noise, places.x0 + places.step * i, places.y0 - places.step * j), 2e-6)
            << i << ' ' << j;
      }
    }
  }
}

TEST(GroundLook, ChangeOfCoverIsSeenWhereItIsAlone) {
  GroundWorld w;
  w.add_terrain({129, 129, 0, 128, 1}, hills);
  const auto cover = w.add_cover({33, 33, 0, 128, 4}, "grass snow", [](double, double) { return 0; });
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  const auto query = look_from(64, 64, 20, 4e-3);
  const auto before = collect(*terrain, query);
  const world::types::LandCover type(w.db->schema());
  auto old = w.now().get_or_default(cover, type.cells).as<std::uint8_t>();
  std::vector<std::uint8_t> cells(old.begin(), old.end());
  for (int r = 0; r < 4; ++r) cells[r * 33] = cells[r * 33 + 1] = cells[r * 33 + 2] = 1;
  w.commit([&](auto& tx) {
    EXPECT_TRUE(tx.set(cover, type.cells, world::Blob::of(std::span<const std::uint8_t>(cells))));
  });
  const auto after = collect(*terrain, query);
  ASSERT_EQ(before.batches.size(), after.batches.size());
  std::size_t same = 0;
  for (std::size_t i = 0; i < after.batches.size(); ++i) {
    const bool near = after.batches[i]->bounds.min().x() < 10 && after.batches[i]->bounds.max().y() > 114;
    const bool kept = after.batches[i]->serial == before.batches[i]->serial;
    EXPECT_FALSE(near && kept);
    same += kept;
  }
  EXPECT_GT(same, after.batches.size() * 3 / 4);
}

TEST(GroundLook, PlainImageryIsTheImagery) {
  GroundWorld w;
  w.add_terrain({33, 33, 0, 32, 1}, [](double, double) { return 0.0; });
  const world::types::Imagery type(w.db->schema());
  w.commit([&](auto& tx) {
    const auto node = *tx.create(type.type);
    EXPECT_TRUE(tx.set(node, type.columns, std::int64_t{2}));
    EXPECT_TRUE(tx.set(node, type.rows, std::int64_t{1}));
    EXPECT_TRUE(tx.set(node, type.x_m, 8.0));
    EXPECT_TRUE(tx.set(node, type.y_m, 16.0));
    EXPECT_TRUE(tx.set(node, type.spacing_m, 64.0));
    const std::vector<std::uint8_t> rgb = {200, 10, 30, 200, 10, 30};
    EXPECT_TRUE(tx.set(node, type.rgb, world::Blob::of(std::span<const std::uint8_t>(rgb))));
  });
  auto plain = nature::make_terrain_provider({.plain_imagery = true});
  plain->rebuild(w.now());
  const auto r = reflectance(collect(*plain, look_from(16, 16, 5)));
  EXPECT_NEAR(r.mean[0], linear(200), 1e-6);
  EXPECT_NEAR(r.mean[2], linear(30), 1e-6);
}

bool water_at(const ContentFrame& frame, double x, double y, double& z) {
  const auto h = heights_at(triangles(frame, "water"), x, y);
  if (!h.empty()) z = h[0];
  return !h.empty();
}

TEST(Water, LiesAtItsLevelAndItsBedIsNotDrawn) {
  GroundWorld w;
  w.add_terrain({65, 65, 0, 64, 1}, [](double x, double y) { return std::hypot(x - 32, y - 32) / 4 - 3; });
  const auto lake = w.add_water({22, 22, 42, 22, 42, 42, 22, 42}, 0.25);
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  auto frame = collect(*terrain, look_from(32, 32, 10));
  double z = 0;
  ASSERT_TRUE(water_at(frame, 32.3, 31.1, z));
  EXPECT_NEAR(z, 0.25, 1e-6);
  EXPECT_FALSE(water_at(frame, 21, 30, z));
  EXPECT_TRUE(heights_at(triangles(frame), 32.3, 31.1).empty());
  EXPECT_FALSE(heights_at(triangles(frame), 10.3, 31.1).empty());
  EXPECT_NEAR(terrain->height_at(32, 32), -3, 1e-6);
  for (const auto& b : frame.batches) {
    EXPECT_EQ(b->prototype->levels[0].mesh->parts[0].surface->water, b->prototype->name == "water");
  }
  const world::types::Water type(w.db->schema());
  w.commit([&](auto& tx) { EXPECT_TRUE(tx.set(lake, type.level_m, -1.0)); });
  frame = collect(*terrain, look_from(32, 32, 10));
  ASSERT_TRUE(water_at(frame, 32.3, 31.1, z));
  EXPECT_NEAR(z, -1, 1e-6);
  w.commit([&](auto& tx) { EXPECT_TRUE(tx.remove(lake)); });
  frame = collect(*terrain, look_from(32, 32, 10));
  EXPECT_FALSE(water_at(frame, 32.3, 31.1, z));
  EXPECT_FALSE(heights_at(triangles(frame), 32.3, 31.1).empty());
}

TEST(Water, LevelIsThatOfTheLowestShoreWhereNoneIsGiven) {
  GroundWorld w;
  w.add_terrain({65, 65, 0, 64, 1}, [](double x, double) { return 0.1 * x; });
  w.add_water({20, 20, 40, 20, 40, 40, 20, 40}, std::numeric_limits<double>::quiet_NaN());
  w.add_water({1, 1, 2, 2}, 0);
  w.add_water({900, 900, 910, 900, 900, 910}, std::numeric_limits<double>::quiet_NaN());
  auto terrain = nature::make_terrain_provider();
  w.follow(*terrain);
  double z = 0;
  ASSERT_TRUE(water_at(collect(*terrain, look_from(32, 32, 10)), 30, 31, z));
  EXPECT_NEAR(z, 2, 1e-5);
  EXPECT_EQ(terrain->warnings().size(), 2U);
}

TEST(Water, CellsOfAFlatLakeAreASheetThoseOfARiverTheGroundItself) {
  for (const bool river : {false, true}) {
    GroundWorld w;
    w.add_terrain({97, 97, 0, 96, 1},
                  [&](double x, double y) { return (river ? 0.2 * x : 5) + (std::abs(y - 48) < 9 ? 0 : 2); });
    w.add_cover({25, 25, 0, 96, 4}, "grass water",
                [](double, double y) { return std::abs(y - 48) < 7 ? 1 : 0; });
    auto terrain = nature::make_terrain_provider();
    w.follow(*terrain);
    const auto frame = collect(*terrain, look_from(48, 48, 30));
    double z = 0;
    EXPECT_EQ(water_at(frame, 50.3, 48.37, z), !river);
    EXPECT_EQ(heights_at(triangles(frame), 50.3, 48.37).size(), river ? 1U : 0U);
    std::size_t wet = 0;
    for (const auto& b : frame.batches) {
      for (const auto& part : b->prototype->levels[0].mesh->parts)
        wet += part.surface->water ? part.index_count : 0;
    }
    EXPECT_GT(wet, 0U);
  }
}

}  // namespace
}  // namespace rigor::ground_test
