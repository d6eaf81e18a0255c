// What share of a pixel is sky, from samples that meet all of it, a part or none.
#include "sim/sensors/camera/sky_edges.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

namespace rigor::test {
namespace {

render::LightSample sample_of(float sky_share, float radiance) {
  render::LightSample s;
  s.sky_share = sky_share;
  s.range_m = sky_share > 0 ? std::numeric_limits<float>::infinity() : 3.0F;
  std::fill_n(s.radiance, 4, radiance);
  return s;
}
std::vector<PixelPlace> places_of(const SkyEdges& edges) {
  return edges.places({0, 0, 8, 8}, [](int, int) { return true; });
}
float resolved(const SkyEdges& edges, PixelPlace at) {
  float radiance[4] = {-1, -1, -1, -1};
  edges.resolve(at, radiance);
  EXPECT_EQ(radiance[0], radiance[3]);
  return radiance[0];
}

TEST(SkyEdges, SamplesThatMeetAPartOfTheSkyCountByTheirShares) {
  SkyEdges edges;
  edges.reset(8, 8);
  edges.add({3, 3}, sample_of(0, 2));  // of the surface
  for (const float share : {0.25F, 1.0F, 0.0F})
    edges.add_sky_only({3, 3}, sample_of(share, share > 0 ? 100 : 0));
  EXPECT_FLOAT_EQ(resolved(edges, {3, 3}), (1.25F * 100 + 2.75F * 2) / 4);
}

TEST(SkyEdges, AreWhereSkyAndSurfacesAreMetAndWhereASampleMetBoth) {
  SkyEdges edges;
  edges.reset(8, 8);
  for (int v = 0; v < 8; ++v)
    for (int u = 0; u < 8; ++u) edges.add({u, v}, sample_of(0, 2));
  EXPECT_TRUE(places_of(edges).empty());
  // A gap in leaves that a ray has met a part of: the pixels about it are asked, not itself again.
  edges.add_sky_only({4, 4}, sample_of(0.1F, 100));
  EXPECT_EQ(places_of(edges).size(), 8U);
  edges.reset(8, 8);
  for (int v = 0; v < 8; ++v)
    for (int u = 0; u < 8; ++u) edges.add({u, v}, sample_of(1, 100));
  EXPECT_TRUE(places_of(edges).empty());
  edges.add_sky_only({4, 4}, sample_of(0.9F, 100));
  EXPECT_EQ(places_of(edges).size(), 8U);
}

TEST(SkyEdges, WhoHasNoSurfaceOfItsOwnTakesItsNeighbours) {
  SkyEdges edges;
  edges.reset(8, 8);
  edges.add({3, 3}, sample_of(1, 100));
  edges.add({4, 3}, sample_of(0, 6));
  edges.add_sky_only({3, 3}, sample_of(0.5F, 100));
  EXPECT_FLOAT_EQ(resolved(edges, {3, 3}), (1.5F * 100 + 0.5F * 6) / 2);
}

}  // namespace
}  // namespace rigor::test
