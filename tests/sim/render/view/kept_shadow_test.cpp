#include <algorithm>

#include "tests/sim/render/view/synthetic_forest.h"
#include "tests/sim/render/view/view_fixture.h"

namespace rigor::test {
namespace {

/// Shadows of what stands still are kept from picture to picture: each must be the one that a renderer draws
/// which has kept nothing.
class ViewKeptShadow : public ViewTest {
 protected:
  void SetUp() override {
    ViewTest::SetUp();
    if (!device_) return;
    const auto f = make_forest(300, 100, 32);
    frame_.batches = {f.ground};
    frame_.batches.insert(frame_.batches.end(), f.trees.begin(), f.trees.end());
    frame_.light.sky = even_sky(0.4F);
    set_sun(130, 40, 3);
    place(0);
  }
  void place(double ahead_m, double turned_deg = 0) {
    const Eigen::Vector3d eye(0, -50 + ahead_m, 4);
    request_.T_world_camera = look(eye, eye + direction(turned_deg, 1));
  }
  /// The next picture, after a look at what another renderer makes of it.
  ViewPicture next() {
    const ViewPicture kept = shoot();
    auto other = ViewRenderer::create(device_);
    EXPECT_TRUE(other);
    ViewPicture anew;
    EXPECT_TRUE((*other)->draw(frame_, request_, anew));
    EXPECT_EQ(kept.radiance, anew.radiance);
    return kept;
  }
  /// Triangles that are drawn for shadows.
  std::size_t of_shadows() {
    const std::size_t all = statistics_.triangles_drawn;
    ViewRequest without = request_;
    without.switches.shadows = false;
    ViewStatistics s;
    ViewPicture unused;
    EXPECT_TRUE(view_->draw(frame_, without, unused, &s));
    return all - s.triangles_drawn;
  }
  static double brightness(const ViewPicture& p) {
    double sum = 0;
    for (const float r : p.radiance) sum += static_cast<double>(r);
    return sum;
  }
};

TEST_F(ViewKeptShadow, WhatStandsStillIsDrawnOnceForPicturesOfAnEyeThatDrives) {
  shoot();
  EXPECT_GT(of_shadows(), 1000U);
  place(0.01);
  shoot();  // all of the squares
  EXPECT_GT(of_shadows(), 1000U);
  for (int i = 2; i < 6; ++i) {
    place(0.01 * i, 0.05 * i);
    next();
    EXPECT_EQ(of_shadows(), 0U) << i;
  }
}

TEST_F(ViewKeptShadow, PicturesOfALongWayAreTheSameAsWithoutAnyKept) {
  std::size_t all = 0, first = 0;
  for (int i = 0; i < 14; ++i) {
    place(0.25 * i, 1.5 * i);
    save(next(), "kept_shadow_way" + std::to_string(i));
    all += of_shadows();
    if (i == 0) first = all;
  }
  EXPECT_LT(all, 14 * first * 7 / 10);
}

TEST_F(ViewKeptShadow, WithFourSamplesAPixelPicturesAreTheSame) {
  request_.samples = 4;
  for (int i = 0; i < 6; ++i) {
    place(0.02 * i, -0.2 * i);
    next();
  }
  EXPECT_LT(of_shadows(), 5000U);
}

TEST_F(ViewKeptShadow, APictureThatIsRefusedChangesNothing) {
  for (int i = 0; i < 3; ++i) next();
  ViewRequest wrong = request_;
  wrong.samples = 2;
  ViewPicture unused;
  EXPECT_FALSE(view_->draw(frame_, wrong, unused));
  next();
  EXPECT_EQ(of_shadows(), 0U);
}

TEST_F(ViewKeptShadow, TwoPlacesInTurnDoNotPushEachOtherOut) {
  for (int i = 0; i < 3; ++i) shoot();
  ASSERT_EQ(of_shadows(), 0U);
  for (int i = 0; i < 3; ++i) {
    place(20, 90);
    next();
    place(0);
    next();
    EXPECT_EQ(of_shadows(), 0U) << i;
  }
}

TEST_F(ViewKeptShadow, FromHighAboveThePictureIsTheSame) {
  request_.pinhole = pinhole(160, 120, 800);
  std::vector<Instance> boxes;
  for (int k = 0; k < 40; ++k)
    boxes.push_back(
        at(85 * std::cos(0.157F * static_cast<float>(k)), 85 * std::sin(0.157F * static_cast<float>(k)), 4));
  frame_.batches = {one(plane_mesh(200, SurfaceOf::grey(0.5F)), 1),
                    batch_of(prototype_of(box_mesh({4, 4, 4}, SurfaceOf::grey(0.4F))), boxes, 2)};
  for (auto& b : boxes)
    frame_.batches.push_back(batch_of(prototype_of(box_mesh({4, 4, 4}, SurfaceOf::grey(0.4F))), {b}, 2));
  for (int i = 0; i < 4; ++i) {
    request_.T_world_camera = look({0.1 * i, -20, 1000}, {0.1 * i, -20.001, 0});
    save(next(), "kept_shadow_high" + std::to_string(i));
  }
  EXPECT_EQ(of_shadows(), 0U);
}

TEST_F(ViewKeptShadow, OfWhatIsFelledPlantedOrPushedIsGoneOrThereAtOnce) {
  for (int i = 0; i < 3; ++i) shoot();
  // A wall between the sun and what is seen comes, steps aside, and goes.
  const Eigen::Vector3d at = Eigen::Vector3d(0, -40, 0) + 12 * direction(130, 40);
  const auto wall = [&](double aside_m) {
    return one(box_mesh({4, 4, 4}, SurfaceOf::grey(0.4F)), 7000, at + Eigen::Vector3d(aside_m, 0, 0));
  };
  const double open = brightness(shoot());
  frame_.batches.push_back(wall(0));
  const double shaded = brightness(next());
  EXPECT_LT(shaded, 0.99 * open);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(brightness(shoot()), shaded);
  frame_.batches.back() = wall(6);
  EXPECT_NE(brightness(next()), shaded);
  frame_.batches.pop_back();
  EXPECT_EQ(brightness(next()), open);
}

TEST_F(ViewKeptShadow, WhatMovesThrowsItsShadowOverThem) {
  const auto mover = [&](double x) {
    auto b = one(box_mesh({1, 1, 1}, SurfaceOf::grey(0.4F)), 7000, {x, -42, 5});
    b->moves = true;
    return b;
  };
  frame_.batches.push_back(mover(0));
  for (int i = 0; i < 6; ++i) {
    frame_.batches.back() = mover(0.5 * i);
    save(next(), "kept_shadow_mover" + std::to_string(i));
    if (i > 1) {
      EXPECT_LE(of_shadows(), 5U * 12) << i;
      EXPECT_GE(of_shadows(), 12U) << i;
    }
  }
  // It stops, and is drawn with what stands still.
  frame_.batches.back() = one(box_mesh({1, 1, 1}, SurfaceOf::grey(0.4F)), 7000, {2.5, -42, 5});
  for (int i = 0; i < 3; ++i) next();
  EXPECT_EQ(of_shadows(), 0U);
}

TEST_F(ViewKeptShadow, TreesSwayInTheWindAndStandStillAfterIt) {
  for (int i = 0; i < 3; ++i) shoot();
  const double calm = brightness(shoot());
  frame_.wind.velocity_m_per_s = {12, 3, 0};
  for (int i = 0; i < 4; ++i) {
    request_.t = request_.t + milliseconds(300);
    next();
  }
  frame_.wind.velocity_m_per_s = {0, 0, 0};
  EXPECT_EQ(brightness(next()), calm);
}

TEST_F(ViewKeptShadow, ADifferentSunOrPictureIsDrawnAnew) {
  for (int i = 0; i < 3; ++i) shoot();
  set_sun(140, 40, 3);
  for (int i = 0; i < 3; ++i) next();
  // Larger maps, and back: what was kept of the smaller ones went with them.
  const Pinhole small = request_.pinhole;
  request_.pinhole = pinhole(400, 300, 375);
  next();
  request_.pinhole = small;
  for (int i = 0; i < 3; ++i) next();
  request_.allowed_error_px = 4;
  for (int i = 0; i < 3; ++i) next();
}

TEST_F(ViewKeptShadow, FarFromTheOriginAndUnderALowSun) {
  const Eigen::Vector3d far(4.5e5, 5.4e6, 800);
  for (auto& b : frame_.batches) {
    auto moved = std::make_shared<Batch>(*b);
    moved->serial = next_serial();
    moved->origin += far;
    b = moved;
  }
  set_sun(200, 4, 3);
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector3d eye = far + Eigen::Vector3d(0, -50 + 0.02 * i, 4);
    request_.T_world_camera = look(eye, eye + direction(10, 0));
    save(next(), "kept_shadow_far" + std::to_string(i));
  }
  EXPECT_EQ(of_shadows(), 0U);
}

}  // namespace
}  // namespace rigor::test
