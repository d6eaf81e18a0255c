// Points of neighbouring rays that share what their surroundings send, against each point alone.
#include "tests/sim/render/rays/light_fixture.h"

namespace rigor::test {
namespace {

class LightSharingTest : public LightTest {
 protected:
  void SetUp() override {
    LightTest::SetUp();
    frame_.light.sky = even_sky(2);
    query_.spread_rad = 0.002F;
    query_.gathered = true;
    query_.packets = true;
  }
  /// Rays of `query_` together and one by one, in the same gathered light.
  struct Both {
    std::vector<LightSample> together, alone;
    [[nodiscard]] double apart(std::size_t i) const {
      double most = 0;
      for (int b = 0; b < 4; ++b)
        most =
            std::max(most, std::abs(static_cast<double>(together[i].radiance[b] / alone[i].radiance[b]) - 1));
      return most;
    }
  };
  Both shoot(const std::vector<Ray>& rays, const std::vector<Ray>& gathering) {
    Both out;
    EXPECT_TRUE(engine_->prepare(window_of(std::vector<ContentFrame>{frame_})));
    query_.rays = gathering;
    EXPECT_TRUE(tracer_->gather(query_));
    out.together.resize(rays.size());
    out.alone.resize(rays.size());
    query_.rays = rays;
    EXPECT_TRUE(tracer_->trace(query_, out.together));
    for (std::size_t i = 0; i < rays.size(); ++i) {
      query_.rays = std::span(rays).subspan(i, 1);
      EXPECT_TRUE(tracer_->trace(query_, std::span(out.alone).subspan(i, 1)));
    }
    return out;
  }
  /// Most are worked out for others, and are apart by no more than this on the mean, few by more than 1 %.
  static void expect_alike(const Both& light, double mean, double share_far_apart) {
    double sum = 0;
    std::size_t shared = 0, far_apart = 0;
    for (std::size_t i = 0; i < light.together.size(); ++i) {
      sum += light.apart(i);
      shared += light.apart(i) > 0 ? 1 : 0;
      far_apart += light.apart(i) > 0.01 ? 1 : 0;
    }
    const auto n = static_cast<double>(light.together.size());
    EXPECT_GT(static_cast<double>(shared), 0.3 * n);
    EXPECT_LT(sum / n, mean);
    EXPECT_LT(static_cast<double>(far_apart), share_far_apart * n);
  }
  /// Of the pixels of a picture that looks ahead and down, by blocks of 4 x 2.
  static std::vector<Ray> picture(int width_px, int height_px) {
    std::vector<Ray> rays;
    for (int v = 0; v < height_px; v += 2)
      for (int u = 0; u < width_px; u += 4)
        for (int k = 0; k < 8; ++k)
          rays.push_back(ray_of(Vector3d::Zero(),
                                Vector3d(0.002 * (u + k % 4 - width_px / 2), 1, -0.3 - 0.002 * (v + k / 4))));
    return rays;
  }
};

TEST_F(LightSharingTest, PointsOfAPlaneHaveTheLightThatEachWouldHaveAlone) {
  // Floor and walls that mirror a little, turned so that no plane lies along an axis.
  auto gloss = surface_of(0.5F);
  gloss->roughness = 0.4F;
  const auto turned = [&](const Vector3f& half, const Vector3f& place) {
    Instance i = rigor::test::at(place.x(), place.y(), place.z());
    turn(i, Eigen::Quaternionf(Eigen::AngleAxisf(0.4F, Vector3f(0.1F, 0.2F, 1).normalized())));
    return batch_of(prototype_of(box_mesh(half, gloss)), {i}, 1);
  };
  frame_.batches = {turned({40, 40, 1}, {0, 0, -3}), turned({0.5F, 40, 10}, {4, 0, 0}),
                    turned({40, 0.5F, 10}, {0, 9, 0})};
  // Light is gathered round the picture too: thin at its edges, it would change there in steps.
  expect_alike(shoot(picture(200, 60), picture(280, 140)), 5e-4, 0.005);
}

TEST_F(LightSharingTest, OnAFloorAtGrazingIncidenceLightDoesNotStepFromPacketToPacket) {
  // From the shade of a wall to the open across the picture, while rows lie far apart.
  frame_.batches = {one(plane_mesh(500, surface_of(0.5F)), 1),
                    one(box_mesh({0.2F, 100, 1}, surface_of(0.2F)), 2, {-3, 0, 1})};
  query_.origin = {0, -12, 0.6};
  const auto level = [&](std::vector<Ray> rays) {
    for (Ray& r : rays)
      r = ray_of(Vector3d::Zero(),
                 Vector3d(r.direction[0] / r.direction[1], 1, r.direction[2] / r.direction[1] + 0.26));
    return rays;
  };
  expect_alike(shoot(level(picture(200, 60)), level(picture(280, 140))), 5e-4, 0.005);
}

TEST_F(LightSharingTest, AMirrorBesideWhatMirrorsNothingIsOne) {
  auto metal = surface_of(0.8F), matt = surface_of(0.3F);
  metal->metallic = 1;
  metal->roughness = 0.3F;
  Mesh m;
  add_quad(m, {-9, 0, 0}, {0, 0, 0}, {0, 9, 0}, {-9, 9, 0});
  add_quad(m, {0, 0, 0}, {9, 0, 0}, {9, 9, 0}, {0, 9, 0});
  m.parts = {{0, 6, matt}, {6, 6, metal}};
  frame_.batches = {one(std::make_shared<Mesh>(std::move(m)), 1)};
  query_.origin = {0, 1, 1};
  for (const double side : {1.0, -1.0}) {  // which of the two comes first
    std::vector<Ray> rays;
    for (int k = 0; k < 8; ++k)
      rays.push_back(ray_of(Vector3d::Zero(), Vector3d(side * 0.01 * (k - 3.5), 0.5, -1)));
    const Both light = shoot(rays, {});
    for (std::size_t k = 0; k < 8; ++k) EXPECT_LT(light.apart(k), 1e-6) << side << " " << k;
  }
}

TEST_F(LightSharingTest, AGapBetweenPointsOfAPlaneKeepsItsShade) {
  const auto black = surface_of(0.05F);
  frame_.batches = {one(box_mesh({5, 20, 5}, black), 1, {-5.08, 0, -5}),
                    one(box_mesh({5, 20, 5}, black), 2, {5.08, 0, -5}),
                    one(plane_mesh(20, surface_of(0.5F), -1), 3)};
  query_.origin = {0, 0, 2};
  std::vector<Ray> rays, gathering;
  for (int k = 0; k < 8; ++k) rays.push_back(ray_of(Vector3d::Zero(), Vector3d(0.03 * (k - 3.5), 0, -1)));
  for (int i = 0; i < 100; ++i)
    for (int j = 0; j < 100; ++j)
      gathering.push_back(ray_of(Vector3d::Zero(), Vector3d(0.005 * (i - 50), 0.005 * (j - 50), -1)));
  const Both light = shoot(rays, gathering);
  EXPECT_GT(light.together[3].range_m, 2.9F);  // in the gap
  EXPECT_LT(light.together[2].range_m, 2.1F);
  for (std::size_t k = 0; k < 8; ++k) EXPECT_LT(light.apart(k), 1e-6) << k;
}

}  // namespace
}  // namespace rigor::test
