#include "tests/sim/render/view/view_fixture.h"

namespace rigor::test {
namespace {

class ViewGeometry : public ViewTest {};

TEST_F(ViewGeometry, AnEmptyWorldIsSky) {
  frame_.light.sky = even_sky(2);
  request_.T_world_camera = look({0, 0, 10}, {0, 10, 13});
  const auto p = shoot();
  EXPECT_NEAR(pixel(p, 80, 60)[0], 2, 1e-5);
  EXPECT_NEAR(pixel(p, 80, 60)[3], 2, 1e-5);
  EXPECT_TRUE(std::isinf(depth(p, 80, 60)));
  EXPECT_EQ(node(p, 80, 60), 0U);
}

TEST_F(ViewGeometry, ABoxStandsWhereThePinholeSaysAtItsDepth) {
  for (const int samples : {1, 4}) {
    request_.samples = samples;
    frame_.light.sky = even_sky(1);
    frame_.batches = {
        one(box_mesh({1, 1, 1}, SurfaceOf::grey(0.5F)), (std::uint64_t{7} << 40) + 3, {2, 20, 1})};
    request_.T_world_camera = look({0, 0, 1}, {0, 20, 1});
    const auto p = shoot();
    save(p, "box");
    // Front face at 19 m: from (1 .. 3) / 19 * 150 right of the middle.
    const double left = 79.5 + 150.0 * 1 / 19, right = 79.5 + 150.0 * 3 / 19;
    for (int u = 0; u < 160; ++u) {
      const bool inside = node(p, u, 59) != 0;
      if (u > left + 1 && u < right - 1) {
        EXPECT_TRUE(inside) << u;
        EXPECT_NEAR(depth(p, u, 59), 19, 1e-4);
        EXPECT_EQ(node(p, u, 59), (std::uint64_t{7} << 40) + 3);
      }
      if (u < left - 3 || u > right + 1) {
        EXPECT_FALSE(inside) << u;
      }
    }
  }
}

TEST_F(ViewGeometry, AsExactFarFromTheOriginAsThere) {
  const auto content = [&](const Eigen::Vector3d& origin) {
    ContentFrame f;
    f.light = frame_.light;
    f.light.sky = even_sky(1);
    f.light.direction_to_sun = direction(140, 40);
    f.light.sun_irradiance = grey(3);
    f.batches = {one(plane_mesh(30, SurfaceOf::grey(0.4F)), 1, origin),
                 one(box_mesh({1, 0.5F, 1}, SurfaceOf::grey(0.7F)), 2, origin + Eigen::Vector3d(1, 12, 1))};
    return f;
  };
  request_.switches.occlusion_culling = false;
  request_.T_world_camera = look({0, 0, 3}, {0, 12, 1});
  const auto here = shoot(content(Eigen::Vector3d::Zero()), request_);
  const Eigen::Vector3d far_away(1e5, -1e5, 300);
  request_.T_world_camera = look(far_away + Eigen::Vector3d(0, 0, 3), far_away + Eigen::Vector3d(0, 12, 1));
  const auto there = shoot(content(far_away), request_);
  std::size_t differ = 0;
  for (std::size_t i = 0; i < here.depth_m.size(); ++i) {
    if (here.nodes[i] != there.nodes[i] || std::isinf(here.depth_m[i]) != std::isinf(there.depth_m[i])) {
      ++differ;
      continue;
    }
    if (std::isinf(here.depth_m[i])) continue;
    // A millimetre at the slant of the farthest ground in view.
    EXPECT_NEAR(here.depth_m[i], there.depth_m[i], 1e-3 + 2e-5 * here.depth_m[i]);
    differ += std::abs(here.radiance[4 * i] - there.radiance[4 * i]) > 0.02F * here.radiance[4 * i] ? 1 : 0;
  }
  // Edges of shadows may fall on other texels.
  EXPECT_LT(differ, here.depth_m.size() / 200);
}

TEST_F(ViewGeometry, NormalsWhereTheyAreAskedFor) {
  frame_.light.sky = even_sky(1);
  auto leaf = SurfaceOf::grey(0.5F);  // with holes: another pipeline
  auto map = std::make_shared<Texture>();
  map->width = map->height = 1;
  map->rgba = {255, 255, 255, 255};
  leaf->colour_map = map;
  leaf->alpha_cutoff = 0.5F;
  frame_.batches = {one(plane_mesh(30, SurfaceOf::grey(0.4F)), 1, {0, 0, -1}),
                    one(box_mesh({1, 1, 1}, leaf), 2, {0, 10, 0})};
  // Turned about the optical axis: camera axes are not the world's.
  request_.T_world_camera = look({0, 0, 0.5}, {0, 10, 0.5});
  request_.T_world_camera.rotate(Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitZ()));
  for (const int samples : {1, 4}) {
    request_.samples = samples;
    request_.normals = false;
    const auto without = shoot();
    EXPECT_TRUE(without.normals.empty());
    request_.normals = true;
    const auto p = shoot();
    EXPECT_EQ(without.radiance, p.radiance);
    ASSERT_EQ(p.normals.size(), 3 * p.nodes.size());
    const Eigen::Matrix3d to_camera = request_.T_world_camera.linear().transpose();
    std::size_t sky = 0, ground = 0, box = 0;
    for (std::size_t i = 0; i < p.nodes.size(); ++i) {
      const Eigen::Vector3d n = Eigen::Map<const Eigen::Vector3f>(&p.normals[3 * i]).cast<double>();
      Eigen::Vector3d expected = Eigen::Vector3d::Zero();
      if (p.nodes[i] == 1) expected = to_camera * Eigen::Vector3d::UnitZ();
      if (p.nodes[i] == 2) expected = to_camera * -Eigen::Vector3d::UnitY();
      if (p.nodes[i] == 2 && (n - expected).norm() > 0.5) expected = to_camera * Eigen::Vector3d::UnitZ();
      ASSERT_NEAR((n - expected).norm(), 0, 6e-5) << i;
      ++(p.nodes[i] == 0 ? sky : p.nodes[i] == 1 ? ground : box);
    }
    EXPECT_GT(std::min({sky, ground, box}), 500U);
  }
}

TEST_F(ViewGeometry, WhatCannotBeDrawnIsSkippedAndCounted) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  frame_.light.sky = even_sky(1);
  std::vector<Instance> all{at(nan, 10, 0), at(0, 10, 0), at(3, 10, 0), at(-3, 10, 0)};
  all[2].rotation[3] = nan;
  all[3].scale[1] = std::numeric_limits<float>::infinity();
  auto batch = batch_of(prototype_of(box_mesh({1, 1, 1}, nullptr)), all);
  batch->nodes = {NodeId{11}, NodeId{12}, NodeId{13}, NodeId{14}};
  auto no_prototype = std::make_shared<Batch>();
  no_prototype->instances.push_back(at(0, 0, 0));
  auto no_levels = batch_of(std::make_shared<Prototype>(), {at(0, 5, 0)});
  auto no_indices = one(finished({}, nullptr), 1);
  Mesh wild;
  add_box(wild, {1, 1, 1});
  wild.indices[4] = 1'000'000;
  Mesh nan_mesh;
  add_box(nan_mesh, {1, 1, 1}, {0, 30, 0});
  nan_mesh.vertices[3].position[0] = nan;
  frame_.batches = {batch,
                    no_prototype,
                    no_levels,
                    nullptr,
                    no_indices,
                    one(finished(std::move(wild), nullptr), 2),
                    one(finished(std::move(nan_mesh), nullptr), 3)};
  request_.T_world_camera = look({0, 0, 0}, {0, 10, 0});
  const auto p = shoot();
  EXPECT_EQ(statistics_.instances_skipped, 3U);
  EXPECT_EQ(node(p, 80, 60), 12U);
}

TEST_F(ViewGeometry, WrongRequestsAreRefused) {
  ViewPicture p;
  const auto refused = [&](auto change) {
    ViewRequest q = request_;
    change(q);
    const Status s = view_->draw(frame_, q, p);
    EXPECT_FALSE(s);
    if (!s) {
      EXPECT_EQ(s.error().code, ErrorCode::bad_input);
    }
  };
  refused([](ViewRequest& q) { q.pinhole.width_px = 0; });
  refused([](ViewRequest& q) { q.pinhole.height_px = 1 << 20; });
  refused([](ViewRequest& q) { q.pinhole.fx_px = std::nan(""); });
  refused([](ViewRequest& q) { q.pinhole.near_m = 0; });
  refused([](ViewRequest& q) { q.samples = 2; });
  refused([](ViewRequest& q) { q.bands[2] = 6; });
  refused([](ViewRequest& q) { q.allowed_error_px = -1; });
  refused([](ViewRequest& q) { q.T_world_camera.translation().x() = std::nan(""); });
  refused([](ViewRequest& q) { q.T_world_camera.linear() *= 2; });
}

TEST_F(ViewGeometry, PicturesOfOnePixelAndOfSixteenMillion) {
  frame_.light.sky = even_sky(1);
  frame_.batches = {one(plane_mesh(2, SurfaceOf::grey(0.5F)), 5)};
  request_.T_world_camera = look({0, 0, 10}, {0, 0, 0});
  request_.pinhole = pinhole(1, 1, 1);
  request_.pinhole.fx_px = request_.pinhole.fy_px = 10;
  auto p = shoot();
  EXPECT_EQ(node(p, 0, 0), 5U);
  request_.pinhole = pinhole(4096, 4096, 8000);
  request_.samples = 4;
  request_.switches.shadows = false;
  p = shoot();
  // 4 m at 10 m fill 3200 pixels.
  EXPECT_EQ(node(p, 2048, 2048), 5U);
  EXPECT_EQ(node(p, 2048 - 1590, 2048), 5U);
  EXPECT_EQ(node(p, 2048, 2048 + 1590), 5U);
  EXPECT_EQ(node(p, 2048, 2048 - 1590), 5U);
  EXPECT_EQ(node(p, 2048 - 1610, 2048), 0U);
  EXPECT_EQ(node(p, 2048, 2048 + 1610), 0U);
  EXPECT_EQ(node(p, 2048, 2048 - 1610), 0U);
  EXPECT_NEAR(depth(p, 2048, 3000), 10, 1e-4);
}

TEST_F(ViewGeometry, TheSamePictureWhateverWasDrawnBefore) {
  frame_.light.sky = even_sky(1);
  set_sun(120, 35, 4);
  frame_.batches = {one(plane_mesh(30, SurfaceOf::grey(0.4F)), 1),
                    one(box_mesh({1, 0.5F, 1}, SurfaceOf::grey(0.7F)), 2, {1, 12, 1})};
  request_.samples = 4;
  request_.T_world_camera = look({0, 0, 3}, {0, 12, 1});
  const auto first = shoot();
  ContentFrame other = frame_;
  other.batches.push_back(one(box_mesh({2, 2, 2}, SurfaceOf::grey(0.1F)), 3, {0, 6, 1}));
  other.precipitation = {Precipitation::Kind::rain, 100, 0.002F, {0, 0, -6}, grey(1e-3F)};
  ViewRequest else_where = request_;
  else_where.pinhole = pinhole(64, 48, 50);
  else_where.bands = {3, 4, 5, 0};
  shoot(other, else_where);
  const auto again = shoot();
  EXPECT_EQ(first.radiance, again.radiance);
  EXPECT_EQ(first.depth_m, again.depth_m);
  EXPECT_EQ(first.nodes, again.nodes);
}

}  // namespace
}  // namespace rigor::test
