// Cameras of small scenes.
#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "sim/sensors/camera_simulator.h"

namespace rigor::test {

class RenderTest : public ::testing::Test {
 protected:
  /// Grey ground under a sun at 45 degrees in the east, a little sky.
  static world::Scene plain_scene() {
    world::Scene s;
    s.materials = {{.name = "grey", .reflectance = {0.4, 0.4, 0.4, 0.4}},
                   {.name = "white", .reflectance = {0.8, 0.8, 0.8, 0.8}},
                   {.name = "black", .reflectance = {0.04, 0.04, 0.04, 0.04}}};
    s.ground = world::Ground{};
    s.sun.direction_to_sun = Eigen::Vector3d(1, 0, 1).normalized();
    s.sun.irradiance_w_per_m2 = {3, 3, 3, 2};
    s.sky.zenith_radiance_w_per_m2_sr = {0.1, 0.1, 0.1, 0.05};
    s.sky.horizon_radiance_w_per_m2_sr = {0.2, 0.2, 0.2, 0.1};
    return s;
  }
  static CameraSpec spec() {
    CameraSpec c;
    c.name = "camera";
    c.model.width_px = 320;
    c.model.height_px = 240;
    c.model.fx_px = c.model.fy_px = 300;
    c.model.cx_px = 159.5;
    c.model.cy_px = 119.5;
    c.noise = false;
    c.format = PixelFormat::mono16;
    return c;
  }
  std::unique_ptr<CameraSimulator> make(const CameraSpec& c, const world::Scene& s) {
    const Status valid = s.validate();
    EXPECT_TRUE(valid) << valid.error().text();
    auto made = CameraSimulator::create(c, std::make_shared<const world::Scene>(s));
    EXPECT_TRUE(made) << made.error().text();
    return made ? std::move(*made) : nullptr;
  }
  static std::vector<std::byte> shoot(CameraSimulator& c, const CaptureRequest& q,
                                      const world::WorldSnapshot& w) {
    const auto& m = c.spec().model;
    const bool whole = q.region.width_px == 0;
    std::vector<std::byte> out(
        image_bytes(c.spec().format, static_cast<std::size_t>(whole ? m.width_px : q.region.width_px),
                    static_cast<std::size_t>(whole ? m.height_px : q.region.height_px)));
    const Status s = c.capture(q, w, out);
    EXPECT_TRUE(s) << s.error().text();
    return out;
  }
  static std::vector<std::byte> shoot(CameraSimulator& c, const CaptureRequest& q = {}) {
    return shoot(c, q, world::WorldSnapshot(c.scene()));
  }
  static std::uint16_t at16(const std::vector<std::byte>& p, int width, int u, int v) {
    const std::size_t i = 2 * (static_cast<std::size_t>(v) * width + u);
    return static_cast<std::uint16_t>(std::to_integer<int>(p[i]) | std::to_integer<int>(p[i + 1]) << 8);
  }
  static double mean16(const std::vector<std::byte>& p) {
    double sum = 0;
    for (std::size_t i = 0; i < p.size(); i += 2)
      sum += std::to_integer<int>(p[i]) | std::to_integer<int>(p[i + 1]) << 8;
    return sum / (static_cast<double>(p.size()) / 2);
  }
};

}  // namespace rigor::test
