// Where rays meet what, in closed form.
#include "tests/sim/render/rays/rays_fixture.h"

namespace rigor::test {
namespace {

TEST_F(RaysTest, AnEmptyWorldIsMetByNothing) {
  show(std::vector<std::shared_ptr<const Batch>>{});
  EXPECT_TRUE(shoot({0, 0, 0}, {0, 0, 1}).nothing());
  EXPECT_EQ(engine_->statistics().instances, 0U);
}

TEST_F(RaysTest, APlaneIsMetAtItsClosedFormDownToGrazing) {
  show({one(plane_mesh(5000, surface_of(0.4F)), 7)});
  for (const double degrees : {0.0, 30.0, 60.0, 85.0, 89.0, 89.9}) {
    const double a = degrees * std::numbers::pi / 180;
    const Ray r = ray_of({0.3, -0.2, 1.5}, {std::sin(a), 0, -std::cos(a)});
    const Hit h = cast({r})[0];
    ASSERT_FALSE(h.nothing()) << degrees;
    const double expected = 1.5 / -static_cast<double>(r.direction[2]);
    EXPECT_NEAR(h.range_m, expected, 1e-6 * expected) << degrees;
    EXPECT_NEAR(h.cos_incidence, std::cos(a), 1e-6) << degrees;
    EXPECT_EQ(normal_of(h), Vector3f(0, 0, 1));
    EXPECT_FLOAT_EQ(h.reflectance, 0.4F);
    EXPECT_EQ(h.node.value, 7U);
    EXPECT_NEAR(h.uv[0], (0.3 + expected * static_cast<double>(r.direction[0])) / 10000 + 0.5, 1e-6);
    EXPECT_NEAR(h.uv[1], 0.5 - (-0.2) / 10000, 1e-6);
  }
  EXPECT_TRUE(shoot({0, 0, 1.5}, {0, 0, 1}).nothing());
  EXPECT_TRUE(shoot({0, 0, -1.5}, {0, 0, 1}).nothing()) << "a back face of what is one-sided";
}

}  // namespace
}  // namespace rigor::test
