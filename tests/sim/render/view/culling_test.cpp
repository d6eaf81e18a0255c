#include <algorithm>

#include "tests/sim/render/view/synthetic_forest.h"
#include "tests/sim/render/view/view_fixture.h"

namespace rigor::test {
namespace {

class ViewCulling : public ViewTest {
 protected:
  void forest(std::size_t trees, double side_m) {
    const auto f = make_forest(trees, side_m, 32);
    frame_.batches = {f.ground};
    frame_.batches.insert(frame_.batches.end(), f.trees.begin(), f.trees.end());
    frame_.light.sky = even_sky(0.4F);
    set_sun(130, 40, 3);
    request_.pinhole = pinhole(320, 240, 260);
    request_.samples = 4;
    request_.T_world_camera = look({0, -50, 4}, {0, 0, 5});
  }
  static ViewSwitches all_off() {
    return {.frustum_culling = false,
            .occlusion_culling = false,
            .levels_of_detail = false,
            .impostors = false,
            .instancing = false};
  }
};

TEST_F(ViewCulling, LeavesOutOnlyWhatCannotBeSeen) {
  forest(300, 100);
  request_.switches = all_off();
  const auto full = shoot();
  save(full, "forest_full");
  const std::size_t everything = statistics_.instances_drawn;
  EXPECT_EQ(everything, 301U);
  EXPECT_GT(statistics_.draw_calls, 300U);
  request_.switches.frustum_culling = true;
  request_.switches.instancing = true;
  const auto culled = shoot();
  EXPECT_LT(statistics_.instances_drawn, everything);
  EXPECT_LT(statistics_.draw_calls, 60U);
  EXPECT_EQ(full.nodes, culled.nodes);
  EXPECT_EQ(full.depth_m, culled.depth_m);
  EXPECT_EQ(full.radiance, culled.radiance);
}

TEST_F(ViewCulling, WhatAWallHidesIsNotDrawnAndThePictureIsTheSame) {
  forest(300, 100);
  auto wall = std::make_shared<Prototype>();
  wall->levels = {{box_mesh({20, 0.2F, 6}, SurfaceOf::grey(0.4F), {0, 0, 6}), 0}};
  wall->occludes = true;
  frame_.batches.push_back(batch_of(wall, {at(0, -38, -3)}, 100000));
  ViewRequest open = request_;
  open.switches = {.occlusion_culling = false, .levels_of_detail = false, .impostors = false};
  const auto all = shoot(frame_, open);
  EXPECT_EQ(statistics_.instances_hidden, 0U);
  const std::size_t drawn = statistics_.instances_drawn;
  for (const int samples : {4, 1}) {
    open.samples = samples;
    open.switches.occlusion_culling = false;
    const auto without = shoot(frame_, open);
    open.switches.occlusion_culling = true;
    const auto with = shoot(frame_, open);
    save(with, "wall_forest");
    EXPECT_GT(statistics_.instances_hidden, 20U);
    EXPECT_LT(statistics_.instances_drawn, drawn);
    EXPECT_EQ(without.nodes, with.nodes);
    EXPECT_EQ(without.depth_m, with.depth_m);
  }
}

TEST_F(ViewCulling, APictureWhoseProgressIsToldIsTheSame) {
  forest(300, 100);
  auto wall = std::make_shared<Prototype>();
  wall->levels = {{box_mesh({20, 0.2F, 6}, SurfaceOf::grey(0.4F), {0, 0, 6}), 0}};
  wall->occludes = true;
  frame_.batches.push_back(batch_of(wall, {at(0, -38, -3)}, 100000));
  for (const bool occlusion : {false, true})
    for (const int samples : {4, 1}) {
      SCOPED_TRACE(std::to_string(samples) + (occlusion ? " samples, what hides first" : " samples"));
      request_.samples = samples;
      request_.switches.occlusion_culling = occlusion;
      request_.progress = {};
      const auto silent = shoot();
      std::vector<double> shares;
      request_.progress = [&](double share) { shares.push_back(share); };
      const auto told = shoot();
      EXPECT_EQ(silent.nodes, told.nodes);
      EXPECT_EQ(silent.depth_m, told.depth_m);
      EXPECT_EQ(silent.radiance, told.radiance);
      ASSERT_GT(shares.size(), 5U);
      EXPECT_TRUE(std::is_sorted(shares.begin(), shares.end()));
      EXPECT_GT(shares.front(), 0);
      EXPECT_NEAR(shares.back(), 1, 1e-9);
    }
}

TEST_F(ViewCulling, CoarserLevelsAndImpostorsStayCloseAndAreCheaper) {
  forest(400, 200);
  request_.T_world_camera = look({0, -100, 6}, {0, 0, 5});
  request_.switches = {.levels_of_detail = false, .impostors = false};
  const auto full = shoot();
  const std::size_t triangles = statistics_.triangles_drawn;
  const auto mean = [](const ViewPicture& p) {
    double sum = 0;
    for (std::size_t i = 0; i < p.radiance.size(); ++i) sum += static_cast<double>(p.radiance[i]);
    return sum / static_cast<double>(p.radiance.size());
  };
  request_.switches.levels_of_detail = true;
  const auto coarse = shoot();
  save(coarse, "forest_levels");
  EXPECT_LT(statistics_.triangles_drawn, triangles / 2);
  EXPECT_NEAR(mean(coarse), mean(full), 0.05 * mean(full));
  request_.switches.impostors = true;
  request_.allowed_error_px = 4;
  const auto impostors = shoot();
  save(impostors, "forest_impostors");
  save(impostors, "forest_infrared", {.colours = ToneMapOptions::Colours::false_near_infrared});
  save(full, "forest_200");
  EXPECT_GT(statistics_.impostors_drawn, 50U);
  EXPECT_NEAR(mean(impostors), mean(full), 0.08 * mean(full));
  request_.allowed_error_px = 0;
  const auto exact = shoot();
  EXPECT_EQ(statistics_.impostors_drawn, 0U);
  EXPECT_EQ(exact.nodes, full.nodes);
}

TEST_F(ViewCulling, AHundredThousandTreesAndOneThatIsFelled) {
  const auto f = make_forest(100000, 2000, 64);
  frame_.batches = {f.ground};
  frame_.batches.insert(frame_.batches.end(), f.trees.begin(), f.trees.end());
  frame_.light.sky = even_sky(0.4F);
  request_.T_world_camera = look({0, 0, 30}, {0, 200, 0});
  request_.allowed_error_px = 8;
  request_.switches.shadows = false;
  shoot();
  EXPECT_GT(statistics_.uploaded_bytes, 100000U * 64);
  EXPECT_EQ(statistics_.instances, 100001U);
  shoot();
  EXPECT_EQ(statistics_.uploaded_bytes, 0U);
  auto changed = std::make_shared<Batch>(*f.trees[40]);
  changed->serial = next_serial();
  changed->instances.pop_back();
  frame_.batches[41] = changed;
  shoot();
  EXPECT_EQ(statistics_.uploaded_bytes, changed->instances.size() * 64);
}

}  // namespace
}  // namespace rigor::test
