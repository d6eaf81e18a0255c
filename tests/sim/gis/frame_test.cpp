#include "sim/gis/frame.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <GeographicLib/Geocentric.hpp>

#include "tests/sim/gis/gis_test_support.h"

namespace rigor::gis {
namespace {

using world::Vector3;

// East, north, up from earth-centred coordinates by hand: the rotation of the anchor times the difference.
Vector3 by_hand(const Anchor& a, const GeoPoint& p) {
  const GeographicLib::Geocentric earth(6378137.0, 1 / 298.257223563);
  Vector3 o, q;
  earth.Forward(a.latitude_deg, a.longitude_deg, a.height_m, o.x(), o.y(), o.z());
  earth.Forward(p.latitude_deg, p.longitude_deg, p.height_m, q.x(), q.y(), q.z());
  const double f = a.latitude_deg * M_PI / 180, l = a.longitude_deg * M_PI / 180;
  Eigen::Matrix3d r;
  r << -std::sin(l), std::cos(l), 0, -std::sin(f) * std::cos(l), -std::sin(f) * std::sin(l), std::cos(f),
      std::cos(f) * std::cos(l), std::cos(f) * std::sin(l), std::sin(f);
  return r * (q - o);
}

TEST(LocalFrame, HundredKilometresFromTheAnchorIsRightToAMillimetre) {
  for (const Anchor a : {Anchor{46.8, 8.2, 1500}, Anchor{0, 0, 0}, Anchor{-33.9, 151.2, 20},
                         Anchor{78.2, 179.99, 5}, Anchor{90, 0, 0}}) {
    const LocalFrame frame(a);
    for (const double bearing : {0.0, 1.0, 2.5, 4.2}) {
      const Vector3 p(1e5 * std::cos(bearing), 1e5 * std::sin(bearing), 300);
      const GeoPoint g = frame.to_geo(p);
      EXPECT_LT((frame.to_world(g) - p).norm(), 1e-6);
      EXPECT_LT((by_hand(a, g) - p).norm(), 1e-3);
    }
  }
}

TEST(LocalFrame, FindsTheZOfAHeightFarFromTheAnchor) {
  const LocalFrame frame({46.8, 8.2, 1500});
  const double z = frame.z_at_height(80'000, -60'000, 700);
  EXPECT_NEAR(frame.to_geo({80'000, -60'000, z}).height_m, 700, 1e-5);
  EXPECT_LT(z, -1500) << "the earth curves away";
}

TEST(LocalFrame, TheMiddleOfPointsOnBothSidesOfTheAntimeridianIsBetweenThem) {
  const std::vector<GeoPoint> points = {{10, 179.5, 0}, {10, -179.5, 0}};
  EXPECT_NEAR(std::abs(middle_of(points).longitude_deg), 180, 1e-9);
  const std::vector<GeoPoint> pole = {{89.9, 0, 0}, {89.9, 120, 0}, {89.9, -120, 0}};
  EXPECT_NEAR(middle_of(pole).latitude_deg, 90, 1e-6);
}

TEST(LocalFrame, APlotsYAxisPointsAlongItsAzimuth) {
  // y axis to the east: x points south.
  const Plot plot{46.8, 8.2, 90};
  const LocalFrame frame({46.8, 8.2, 0});
  const Vector3 y = frame.to_world(from_plot(plot, 0, 100)), x = frame.to_world(from_plot(plot, 100, 0));
  EXPECT_NEAR(y.x(), 100, 1e-6);
  EXPECT_NEAR(y.y(), 0, 1e-6);
  EXPECT_NEAR(x.x(), 0, 1e-6);
  EXPECT_NEAR(x.y(), -100, 1e-6);
}

TEST(Anchor, IsReadFromText) {
  const auto a = parse_anchor("46.8,8.2,1200");
  ASSERT_TRUE(a) << a.error().text();
  EXPECT_EQ(a->latitude_deg, 46.8);
  EXPECT_EQ(a->height_m, 1200);
  EXPECT_TRUE(std::isnan(parse_anchor("-46.8, -8.2")->height_m));
  EXPECT_EQ(parse_anchor("0,190")->longitude_deg, -170);
  for (const char* bad :
       {"", "46.8", "46.8,", "46.8,8.2,1,2", "46.8,8.2,", "91,0", "a,b", "46.8 8.2", "1,nan"})
    EXPECT_FALSE(parse_anchor(bad)) << bad;
}

}  // namespace
}  // namespace rigor::gis
