#include "sim/nature/built/building_mesh.h"

#include <gtest/gtest.h>

#include "tests/sim/nature/built/mesh_checks.h"

namespace rigor::nature::built {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

const Polygon kBox{.outer = {{0, 0}, {12, 0}, {12, 8}, {0, 8}}, .holes = {}};
const Polygon kEll{.outer = {{0, 0}, {14, 0}, {14, 6}, {6, 6}, {6, 13}, {0, 13}}, .holes = {}};
const Polygon kCourt{.outer = {{0, 0}, {24, 0}, {24, 20}, {0, 20}},
                     .holes = {{{7, 7}, {7, 13}, {17, 13}, {17, 7}}}};
constexpr RoofShape kShapes[] = {RoofShape::flat, RoofShape::gabled, RoofShape::hipped, RoofShape::pyramidal,
                                 RoofShape::shed};

BuildingSpec plain(const Polygon& footprint, RoofShape roof) {
  BuildingSpec s;
  s.footprint = footprint;
  s.roof = roof;
  s.overhang_m = 0;
  s.openings = false;
  s.chimney = false;
  s.foundation_m = 0.5;
  return s;
}

TEST(Building, IsWatertightWithEveryRoofAndDetail) {
  for (const Polygon& footprint : {kBox, kEll, kCourt})
    for (const RoofShape roof : kShapes)
      for (const bool bare : {true, false}) {
        BuildingSpec s = plain(footprint, roof);
        if (!bare) s = BuildingSpec{.footprint = footprint, .roof = roof};
        const BuildingMesh made = make_building(s);
        ASSERT_EQ(made.levels.size(), bare ? 1U : 3U);
        for (const auto& level : made.levels) {
          EXPECT_EQ(test::open_edge_count(*level.mesh), 0) << static_cast<int>(roof) << " " << bare;
          EXPECT_GT(test::worst_normal(*level.mesh), 0.999);
          EXPECT_GT(test::volume_m3(*level.mesh), 0);
        }
      }
}

TEST(Building, VolumeIsAreaTimesHeightAndRoof) {
  for (const auto& [roof, above] : {std::pair(RoofShape::gabled, 12 * 8 * 3.0 / 2),
                                    {RoofShape::pyramidal, 12 * 8 * 3.0 / 3},
                                    {RoofShape::shed, 12 * 8 * 3.0 / 2},
                                    {RoofShape::hipped, 8 * 3.0 / 2 * 4 + 64.0}}) {
    const BuildingMesh made = make_building(plain(kBox, roof));
    EXPECT_NEAR(test::volume_m3(*made.levels[0].mesh), 12 * 8 * 6.5 + above, 0.01);
  }
  BuildingSpec flat = plain(kCourt, RoofShape::flat);
  flat.roof_height_m = 0;
  EXPECT_NEAR(test::volume_m3(*make_building(flat).levels[0].mesh), (24 * 20 - 10 * 6) * 6.5, 0.05);
}

TEST(Building, WindowsAreSetInAndOfGlass) {
  BuildingSpec s = plain(kBox, RoofShape::flat);
  s.openings = true;
  s.roof_height_m = 0;
  const BuildingMesh made = make_building(s);
  const auto glass = [](const Vector3d&, const render::Surface& f) { return f.name == "glass"; };
  const auto door = [](const Vector3d&, const render::Surface& f) { return f.name == "door"; };
  // Two storeys, 4 bays on the long walls, 3 on the short ones, one of which holds the door.
  const double pane = (1.1 - 0.14) * (1.25 - 0.14);
  EXPECT_NEAR(test::area_m2(*made.levels[0].mesh, glass), (2 * 2 * (4 + 3) - 1) * pane, 0.05 * 27 * pane);
  EXPECT_GT(test::area_m2(*made.levels[0].mesh, door), 1.5);
  // What is set in is missing from the volume; flush windows miss nothing.
  const double step = 1.5 * 0.92 * (0.22 + 0.5);
  EXPECT_NEAR(test::volume_m3(*made.levels[1].mesh), 12 * 8 * 6.5 + step, 0.01);
  EXPECT_LT(test::volume_m3(*made.levels[0].mesh), 12 * 8 * 6.5 + step - 27 * 1.1 * 1.2 * 0.11);
  EXPECT_EQ(test::area_m2(*made.levels[2].mesh, glass), 0);
}

TEST(Building, WindowsBelowTheGroundAreLeftOut) {
  BuildingSpec s = plain(kBox, RoofShape::flat);
  s.openings = true;
  const auto glass = [](const Vector3d&, const render::Surface& f) { return f.name == "glass"; };
  const double all = test::area_m2(*make_building(s).levels[0].mesh, glass);
  s.ground = [](const Vector2d& p) { return 0.5 * p.y(); };  // 4 m high behind the house
  const BuildingMesh made = make_building(s);
  const double left = test::area_m2(*made.levels[0].mesh, glass);
  EXPECT_LT(left, 0.85 * all);
  EXPECT_GT(left, 0.4 * all);
  // The door is at the foot of the slope: on the wall y = 0.
  test::each_triangle(*made.levels[0].mesh,
                      [&](std::uint32_t a, std::uint32_t, std::uint32_t, const render::Surface& f) {
                        if (f.name == "door") {
                          EXPECT_LT(test::position(*made.levels[0].mesh, a).y(), 0.5);
                        }
                      });
}

TEST(Building, TinyOnesAreBuiltToo) {
  for (const double side : {0.15, 0.5, 1.0, 1.8}) {
    for (const RoofShape roof : kShapes) {
      BuildingSpec s;
      s.footprint = Polygon{.outer = {{0, 0}, {side, 0}, {side, side}, {0, side}}, .holes = {}};
      s.height_m = 0.1 + side;
      s.roof = roof;
      const BuildingMesh made = make_building(s);
      EXPECT_EQ(test::open_edge_count(*made.levels[0].mesh), 0) << side;
    }
  }
}

}  // namespace
}  // namespace rigor::nature::built
