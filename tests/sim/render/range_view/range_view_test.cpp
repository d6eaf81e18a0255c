#include "tests/sim/render/range_view/range_fixture.h"

namespace rigor::test {
namespace {

class RangeView : public RangeViewTest {};

// A wall square to the view, one at a slant and the ground at 2 m: range = distance / cosine. Errors: of
// floats in the device's interpolation, 25 to 200 µm in the size of such views; the bound is 0.2 mm + 20 ppm.
TEST_F(RangeView, PlanesStandAtTheirRange) {
  const Eigen::Vector3d normals[] = {{0, -1, 0}, Eigen::Vector3d(0.6, -0.8, 0), Eigen::Vector3d(0, -0.1, 1)};
  const double distances[] = {10, 7, 2};
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d n = normals[k].normalized();
    auto b =
        batch_of(prototype_of(plane_mesh(400, SurfaceOf::grey(0.5F))), {at(0, 0, 0)}, 9, -distances[k] * n);
    auto moved = std::make_shared<Batch>(*b);
    const auto q = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), n).cast<float>();
    moved->instances[0].rotation[0] = q.x();
    moved->instances[0].rotation[1] = q.y();
    moved->instances[0].rotation[2] = q.z();
    moved->instances[0].rotation[3] = q.w();
    show({moved});
    const auto rays = pinhole_rays(look({0, 0, 0}, {0, 1, 0}).linear(), 176, 144, 250);
    const auto hits = cast(rays);
    double square = 0, worst = 0;
    std::size_t met = 0;
    for (std::size_t i = 0; i < rays.size(); ++i) {
      const double c = -direction_of(rays[i]).dot(n), expected = distances[k] / c;
      if (c < 0.02) continue;
      ASSERT_FALSE(hits[i].nothing()) << i;
      ++met;
      const double error = static_cast<double>(hits[i].range_m) - expected;
      square += error * error;
      worst = std::max(worst, std::abs(error) / (2e-4 + 2e-5 * expected));
      EXPECT_EQ(hits[i].node.value, 9U);
      EXPECT_NEAR(hits[i].cos_incidence, c, 1e-5);
      EXPECT_NEAR(hits[i].reflectance, 0.5, 1e-6);
    }
    EXPECT_GT(met, 5000U);
    std::printf("plane %d: RMS %.1f um, worst %.3f of bound, of %zu\n", k,
                1e6 * std::sqrt(square / static_cast<double>(met)), worst, met);
    EXPECT_LT(worst, 1);
  }
}

}  // namespace
}  // namespace rigor::test
