#include "sim/render/rays/light_picture.h"

#include "tests/sim/render/rays/light_fixture.h"

namespace rigor::test {
namespace {

class LightPictureTest : public LightTest {
 protected:
  void SetUp() override {
    LightTest::SetUp();
    // From 2 m above, straight down, north towards the picture's top.
    request_.T_world_camera.linear() << 1, 0, 0, 0, -1, 0, 0, 0, -1;
    request_.T_world_camera.translation() = Vector3d(0, 0, 2);
    request_.pinhole = {.width_px = 21, .height_px = 13, .fx_px = 20, .fy_px = 20, .cx_px = 10, .cy_px = 6};
    set_sun(0, 90, static_cast<float>(kPi));
  }
  ViewPicture picture() {
    EXPECT_TRUE(engine_->prepare(window_of(std::vector<ContentFrame>{frame_})));
    ViewPicture p;
    const Status s = trace_picture(*tracer_, request_, p);
    EXPECT_TRUE(s) << s.error().text();
    return p;
  }
  LightPictureRequest request_;
};

TEST_F(LightPictureTest, PixelsLieWhereThePinholePutsThem) {
  // 0.1 m a pixel. A board whose north-east corner is at (0.25, 0.15): between pixels 12 and 13, 4 and 5.
  Mesh m;
  add_quad(m, {-2, -2, 0}, {0.25F, -2, 0}, {0.25F, 0.15F, 0}, {-2, 0.15F, 0});
  frame_.batches = {one(finished(std::move(m), surface_of(0.5F)), 9)};
  const ViewPicture p = picture();
  ASSERT_EQ(p.width_px, 21);
  ASSERT_EQ(p.height_px, 13);
  for (int v = 0; v < 13; ++v)
    for (int u = 0; u < 21; ++u) {
      const std::size_t i = static_cast<std::size_t>(v * 21 + u);
      const bool board = u <= 12 && v >= 5;
      EXPECT_EQ(p.nodes[i], board ? 9U : 0U) << u << " " << v;
      if (board) {
        EXPECT_NEAR(p.depth_m[i], 2, 1e-5);
        EXPECT_NEAR(p.radiance[4 * i], 0.5, 1e-5);
      } else {
        EXPECT_TRUE(std::isinf(p.depth_m[i]));
        EXPECT_EQ(p.radiance[4 * i], 0);
      }
    }
}

TEST_F(LightPictureTest, SeveralSamplesAreAveraged) {
  // The board's edge runs through the middle of pixel column 12 but for a tenth of it.
  Mesh m;
  add_quad(m, {-2, -2, 0}, {0.21F, -2, 0}, {0.21F, 2, 0}, {-2, 2, 0});
  frame_.batches = {one(finished(std::move(m), surface_of(0.5F)), 9)};
  request_.samples_a_side = 10;
  const ViewPicture p = picture();
  const std::size_t row = 6 * 21;
  EXPECT_NEAR(p.radiance[4 * (row + 11)], 0.5, 1e-5);
  EXPECT_NEAR(p.radiance[4 * (row + 12)], 0.5 * 0.6, 1e-5);
  EXPECT_NEAR(p.radiance[4 * (row + 13)], 0, 1e-5);
}

TEST_F(LightPictureTest, RefusesWhatMakesNoSense) {
  ASSERT_TRUE(engine_->prepare(window_of(std::vector<ContentFrame>{frame_})));
  ViewPicture p;
  const auto refused = [&](auto change) {
    LightPictureRequest q = request_;
    change(q);
    const Status s = trace_picture(*tracer_, q, p);
    return !s && s.error().code == ErrorCode::bad_input;
  };
  EXPECT_TRUE(refused([](auto& q) { q.pinhole.width_px = 0; }));
  EXPECT_TRUE(refused([](auto& q) { q.pinhole.fx_px = std::nan(""); }));
  EXPECT_TRUE(refused([](auto& q) { q.samples_a_side = 0; }));
  EXPECT_TRUE(refused([](auto& q) { q.T_world_camera.linear() *= 2; }));
  EXPECT_TRUE(refused([](auto& q) { q.bands[1] = 9; }));
}

}  // namespace
}  // namespace rigor::test
