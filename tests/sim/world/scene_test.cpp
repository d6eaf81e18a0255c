#include "sim/world/scene.h"

#include <gtest/gtest.h>

#include <numbers>

namespace rigor::world {
namespace {

Scene two_hinges() {
  Scene s;
  s.materials.emplace_back();
  Node base;
  base.name = "base";
  base.T_parent_node.translate(Eigen::Vector3d(1, 2, 0));
  base.hinge = Hinge{};
  Node arm;
  arm.name = "arm";
  arm.parent = 0;
  arm.T_parent_node.translate(Eigen::Vector3d(1, 0, 0));
  arm.hinge = Hinge{Eigen::Vector3d::UnitY()};
  s.nodes = {base, arm};
  return s;
}

TEST(Scene, PosesAreFunctionsOfTime) {
  const Scene s = two_hinges();
  ASSERT_TRUE(s.validate());
  WorldSnapshot w(s);
  const BenchTime t0(5'000'000'000);
  w.joints[0] = {t0, 0.25, std::numbers::pi};  // half a turn per second
  const Eigen::Isometry3d T = T_world_node(s, w, 1, t0 + milliseconds(500));
  const double angle = 0.25 + std::numbers::pi / 2;
  EXPECT_LT((T.translation() - Eigen::Vector3d(1 + std::cos(angle), 2 + std::sin(angle), 0)).norm(), 1e-12);
  EXPECT_LT(
      (T.linear() * Eigen::Vector3d::UnitX() - Eigen::Vector3d(std::cos(angle), std::sin(angle), 0)).norm(),
      1e-12);
  EXPECT_LT((T_world_node(s, w, 0, t0 - milliseconds(500)).linear().col(0) -
             Eigen::Vector3d(std::cos(0.25 - std::numbers::pi / 2), std::sin(0.25 - std::numbers::pi / 2), 0))
                .norm(),
            1e-12)
      << "before t_ref too";
  EXPECT_TRUE(T_world_node(s, w, std::nullopt, t0).isApprox(Eigen::Isometry3d::Identity()));
}

TEST(Scene, RefusesWhatCannotBe) {
  const auto message = [](const Scene& s) {
    const Status status = s.validate();
    return status ? std::string() : status.error().text();
  };
  Scene s = two_hinges();
  s.nodes[0].parent = 1;
  EXPECT_NE(message(s).find("'base'"), std::string::npos);
  s = two_hinges();
  s.nodes[1].hinge->axis = {0, 0, 2};
  EXPECT_NE(message(s).find("length 1"), std::string::npos);
  s = two_hinges();
  s.bodies.push_back({.name = "box", .material = 3});
  EXPECT_NE(message(s).find("no such material"), std::string::npos);
  s.bodies[0] = {.name = "box", .size_m = {1, -1, 1}};
  EXPECT_NE(message(s).find("positive"), std::string::npos);
  s.bodies[0] = {.name = "box", .size_m = {0.5, 0.5, 0.1}, .chessboard = Chessboard{}};
  EXPECT_NE(message(s).find("fits"), std::string::npos);
  s = two_hinges();
  s.sun.direction_to_sun = {0, 0, 0};
  EXPECT_NE(message(s).find("sun"), std::string::npos);
}

TEST(Scene, ChessboardCornersAreRowByRowAboutTheCentre) {
  const Body b{.name = "board", .size_m = {1.1, 0.8, 0.02}, .chessboard = Chessboard{}};
  const auto corners = chessboard_corners_in_body(b);
  ASSERT_EQ(corners.size(), 54u);
  EXPECT_LT((corners[0] - Eigen::Vector3d(-0.4, 0.25, 0.01)).norm(), 1e-12);
  EXPECT_LT((corners[1] - corners[0] - Eigen::Vector3d(0.1, 0, 0)).norm(), 1e-12);
  EXPECT_LT((corners[53] - Eigen::Vector3d(0.4, -0.25, 0.01)).norm(), 1e-12);
}

}  // namespace
}  // namespace rigor::world
