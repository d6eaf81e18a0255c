#include <algorithm>

#include "tests/sim/render/view/view_fixture.h"

namespace rigor::test {
namespace {

/// What of an even sky's light reaches the ground at a place, against the open.
class ViewSkyCover : public ViewTest {
 protected:
  void SetUp() override {
    ViewTest::SetUp();
    frame_.light.sky = even_sky(1);
    frame_.light.ground_albedo = {};
    ground_ = one(plane_mesh(200, SurfaceOf::grey(0.5F)), 1);
  }
  /// Seen from close above, so that nothing stands between.
  double light_at(double x, double y, double z = 0) {
    request_.T_world_camera = look({x, y, z + 1.5}, {x, y, z});
    return static_cast<double>(pixel(shoot(), 80, 60)[0]) / 0.5;
  }
  static std::shared_ptr<Batch> box(const Eigen::Vector3f& half, const Eigen::Vector3d& centre,
                                    std::shared_ptr<const Surface> s = SurfaceOf::grey(0.5F)) {
    return one(box_mesh(half, std::move(s)), 2, centre);
  }
  bool asked(const char* word) const {
    const auto names = view_->pipelines();
    return std::any_of(names.begin(), names.end(),
                       [&](const auto& n) { return n.find(word) != std::string::npos; });
  }

  std::shared_ptr<Batch> ground_;
};

TEST_F(ViewSkyCover, InTheOpenAllOfItIsSeen) {
  frame_.batches = {ground_, box({2, 2, 2}, {60, 0, 2})};
  EXPECT_NEAR(light_at(0, 0), 1, 0.01);
  EXPECT_TRUE(asked("sky_cover"));
  // On top of what hides it from others; far from the world's origin too.
  EXPECT_NEAR(light_at(60, 0, 4), 1, 0.01);
  const Eigen::Vector3d far(4.5e5, 5.4e6, 800);
  frame_.batches = {one(plane_mesh(200, SurfaceOf::grey(0.5F)), 1, far),
                    box({2, 2, 2}, far + Eigen::Vector3d(60, 0, 2))};
  EXPECT_NEAR(light_at(far.x(), far.y(), far.z()), 1, 0.01);
}

TEST_F(ViewSkyCover, UnderALargeRoofIsWhatWallsThrowAbout) {
  frame_.batches = {ground_, box({30, 30, 0.2F}, {0, 0, 4})};
  const double inside = light_at(0, 0);
  EXPECT_LT(inside, 0.15);
  EXPECT_GT(inside, 0.05);
}

TEST_F(ViewSkyCover, AtAHighWallHalfOfItIsSeen) {
  frame_.batches = {ground_, box({60, 5, 40}, {0, 5, 40})};
  EXPECT_NEAR(light_at(0, -1.0), 0.5 + 0.5 * 0.1, 0.06);
  // In a corner a quarter.
  frame_.batches.push_back(box({5, 60, 40}, {5, -60, 40}));
  EXPECT_NEAR(light_at(-1, -1), 0.25 + 0.75 * 0.1, 0.08);
  // A low one hides little.
  frame_.batches = {ground_, box({60, 5, 0.5F}, {0, 5, 0.5})};
  EXPECT_GT(light_at(0, -4), 0.95);
}

TEST_F(ViewSkyCover, AWallItselfIsNotHiddenByItsOwnTop) {
  frame_.batches = {ground_, box({40, 5, 10}, {0, 5, 10})};
  request_.T_world_camera = look({0, -6, 3}, {0, 0, 3});
  EXPECT_NEAR(pixel(shoot(), 80, 60)[0], 0.5 * 0.5, 0.01);
}

TEST_F(ViewSkyCover, UnderLeavesMoreNearInfraredIsLeftThanVisibleLight) {
  auto leaf = std::make_shared<Surface>();
  leaf->reflectance = leaf->transmittance = grey(0.1F);
  leaf->two_sided = true;
  frame_.batches = {ground_, box({30, 30, 3}, {0, 0, 8}, leaf)};
  request_.T_world_camera = look({0, 0, 1.5}, {0, 0, 0});
  const auto p = shoot();
  const float red = pixel(p, 80, 60)[0] / 0.5F, green = pixel(p, 80, 60)[1] / 0.5F,
              near_infrared = pixel(p, 80, 60)[3] / 0.5F;
  EXPECT_GT(green, red);
  EXPECT_NEAR(red, 0.16, 0.05);
  EXPECT_NEAR(near_infrared, 0.57, 0.1);
}

TEST_F(ViewSkyCover, StandsStillWhileTheEyeMoves) {
  frame_.batches = {ground_, box({60, 5, 40}, {0, 5, 40}), box({1, 1, 3}, {150, 150, 3})};
  const double here = light_at(0, -1.3);
  for (const double dx : {0.05, 0.11, 0.37}) {
    request_.T_world_camera = look({dx, -1.3, 1.5}, {dx, -1.3, 0});
    const auto p = shoot();
    // The same place of the ground: 150 px to 1.5 m.
    EXPECT_NEAR(static_cast<double>(pixel(p, 80 - static_cast<int>(std::lround(dx * 100)), 60)[0]) / 0.5,
                here, 0.01);
  }
}

TEST_F(ViewSkyCover, CostsNothingWhereNothingStandsOrShadowsAreOff) {
  frame_.batches = {ground_};
  EXPECT_NEAR(light_at(0, 0), 1, 2e-3);
  request_.switches.shadows = false;
  frame_.batches = {ground_, box({30, 30, 0.2F}, {0, 0, 4})};
  EXPECT_NEAR(light_at(0, 0), 1, 2e-3);
  EXPECT_FALSE(asked("sky_cover"));
  EXPECT_FALSE(asked("shadow"));
}

}  // namespace
}  // namespace rigor::test
