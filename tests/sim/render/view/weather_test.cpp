#include "tests/sim/render/view/view_fixture.h"

namespace rigor::test {
namespace {

class ViewWeather : public ViewTest {
 protected:
  /// Black boards at several distances in front of a sky.
  void boards(const std::vector<double>& distances) {
    frame_.batches.clear();
    for (std::size_t i = 0; i < distances.size(); ++i) {
      const auto d = static_cast<float>(distances[i]);
      const float x = (static_cast<float>(i) - 1.5F) * 0.2F * d;
      frame_.batches.push_back(
          one(box_mesh({0.05F * d, 0.1F, 0.2F * d}, SurfaceOf::grey(0.5F), {x, d + 0.1F, 0}), i + 1));
    }
    request_.T_world_camera = look({0, 0, 0}, {0, 1, 0});
  }
};

TEST_F(ViewWeather, HazeTakesLightByTheExponentialOfTheWayBelowItsTop) {
  const std::vector<double> distances{20, 100, 400, 1500};
  frame_.light.sky = even_sky(1);
  boards(distances);
  const auto clear = shoot();
  const Spectrum extinction{1e-3F, 2e-3F, 4e-3F, 5e-4F, 5e-4F, 5e-4F};
  for (const double top : {std::numeric_limits<double>::infinity(), 3.0, -2.0}) {
    frame_.hazes = {{.extinction_per_m = extinction, .top_m = top, .inscattered_radiance = grey(0.7F)}};
    const auto hazy = shoot();
    for (int v = 20; v < 100; ++v)
      for (int u = 0; u < 160; ++u) {
        const std::uint64_t n = node(clear, u, v);
        if (n == 0) continue;
        const double z = static_cast<double>(depth(clear, u, v));
        const Eigen::Vector3d p =
            request_.T_world_camera.linear() * Eigen::Vector3d((u - 79.5) / 150 * z, (v - 59.5) / 150 * z, z);
        const double low = std::min(0.0, p.z()), high = std::max(0.0, p.z());
        const double share = std::isinf(top) ? 1.0 : std::clamp((top - low) / (high - low), 0.0, 1.0);
        for (int c = 0; c < 4; ++c) {
          const double t =
              std::exp(-static_cast<double>(extinction[static_cast<std::size_t>(c)]) * p.norm() * share);
          const double expected = static_cast<double>(pixel(clear, u, v)[c]) * t + 0.7 * (1 - t);
          ASSERT_NEAR(pixel(hazy, u, v)[c], expected, 2e-4)
              << n << " at " << u << ", " << v << " top " << top;
        }
      }
  }
  // Upwards through a layer of 50 m, and through all of an endless one.
  frame_.hazes = {{.extinction_per_m = extinction, .top_m = 50, .inscattered_radiance = grey(0.7F)}};
  request_.T_world_camera = look({0, 0, 0}, direction(0, 30));
  const double t = std::exp(-1e-3 * 100);
  EXPECT_NEAR(pixel(shoot(), 80, 60)[0], t + 0.7 * (1 - t), 1e-3);
  frame_.hazes[0].top_m = std::numeric_limits<double>::infinity();
  EXPECT_NEAR(pixel(shoot(), 80, 60)[0], 0.7, 1e-4);
}

TEST_F(ViewWeather, RainIsTheSameWhateverWasDrawnBeforeAndFalls) {
  frame_.light.sky = even_sky(1);
  frame_.batches = {one(plane_mesh(50, SurfaceOf::grey(0.05F)), 1)};
  frame_.precipitation = {Precipitation::Kind::rain, 400, 0.002F, {1, 0, -7}, grey(1e-3F)};
  request_.pinhole = pinhole(320, 240, 300);
  request_.samples = 4;
  request_.T_world_camera = look({0, 0, 2}, {0, 10, 2.5});
  const auto first = shoot();
  save(first, "rain");
  request_.t = request_.t + milliseconds(40);
  const auto later = shoot();
  request_.t = request_.t - milliseconds(40);
  const auto again = shoot();
  EXPECT_EQ(first.radiance, again.radiance);
  EXPECT_NE(first.radiance, later.radiance);
  frame_.precipitation = {Precipitation::Kind::snow, 150, 0.008F, {0.5F, 0, -1}, grey(1e-3F)};
  save(shoot(), "snow_fall");
  auto without = frame_;
  without.precipitation.drops_per_m3 = 0;
  EXPECT_NE(shoot().radiance, shoot(without, request_).radiance);
}

TEST_F(ViewWeather, SnowWhitensWhatFacesUpAndTakesItAndWetSoilIsDarker) {
  frame_.light.sky = even_sky(1);
  frame_.light.ground_albedo = {};
  frame_.batches = {one(box_mesh({4, 4, 1}, SurfaceOf::grey(0.1F)), 1)};
  request_.T_world_camera = look({0, 0, 8}, {0, 0, 0});
  const float dry = pixel(shoot(), 80, 60)[0];
  // The film of water mirrors a few hundredths of the sky; under the sun alone the soil is plainly darker.
  set_sun(180, 30, 5);
  frame_.light.sky = even_sky(0);
  const float lit = pixel(shoot(), 80, 60)[0];
  frame_.surface.wetness = 1;
  EXPECT_LT(pixel(shoot(), 80, 60)[0], 0.85F * lit);
  frame_.light.sky = even_sky(1);
  frame_.light.sun_irradiance = {};
  frame_.surface = {0, 0.3F};
  const auto snowy = shoot();
  EXPECT_GT(pixel(snowy, 80, 60)[0], 0.8F);
  auto shelter = SurfaceOf::grey(0.1F);
  shelter->takes_snow = false;
  frame_.batches = {one(box_mesh({4, 4, 1}, shelter), 1)};
  EXPECT_NEAR(pixel(shoot(), 80, 60)[0], dry, 1e-5);
  frame_.batches = {one(box_mesh({4, 4, 1}, SurfaceOf::grey(0.1F)), 1)};
  request_.T_world_camera = look({0, -10, 0}, {0, 0, 0});
  EXPECT_LT(pixel(shoot(), 80, 60)[0], 0.1F);  // a wall
  frame_.surface = {0, 0.012F};
  request_.T_world_camera = look({0, -8, 4}, {0, 0, 1});
  save(shoot(), "snow_thin");
}

TEST_F(ViewWeather, WindSwaysByTheInstantAlone) {
  Mesh m;
  add_quad(m, {-0.5F, 0, 0}, {0.5F, 0, 0}, {0.5F, 0, 3}, {-0.5F, 0, 3}, 1);
  auto s = SurfaceOf::grey(0.5F);
  s->two_sided = true;
  auto p = prototype_of(finished(std::move(m), s));
  p->sway_m = 0.5F;
  frame_.light.sky = even_sky(1);
  frame_.batches = {batch_of(p, {at(0, 10, -1.5F)}, 1)};
  request_.T_world_camera = look({0, 0, 0}, {0, 10, 0});
  const auto still = shoot();
  frame_.wind.velocity_m_per_s = {10, 0, 0};
  const auto swayed = shoot();
  request_.t = request_.t + milliseconds(700);
  const auto later = shoot();
  EXPECT_NE(still.nodes, swayed.nodes);
  EXPECT_NE(later.nodes, swayed.nodes);
  // 0.2 to 0.5 m at 10 m: the top's right edge moves 3 to 8 px.
  const auto right_edge = [&](const ViewPicture& q) {
    int last = 0;
    for (int u = 0; u < 160; ++u)
      if (node(q, u, 40) != 0) last = u;
    return last;
  };
  EXPECT_GE(right_edge(swayed) - right_edge(still), 2);
  EXPECT_LE(right_edge(swayed) - right_edge(still), 9);
}

}  // namespace
}  // namespace rigor::test
