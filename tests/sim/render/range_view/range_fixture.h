// Rays into small worlds made by hand, answered by the engine of range views.
#pragma once

#include <cstring>

#include "sim/render/view/raster_engine.h"
#include "tests/sim/render/view/view_fixture.h"

namespace rigor::test {

inline std::shared_ptr<ContentWindow> still(ContentFrame frame) {
  auto w = std::make_shared<ContentWindow>();
  w->frames.push_back(std::make_shared<const ContentFrame>(std::move(frame)));
  return w;
}

inline Ray ray(const Eigen::Vector3d& direction, float time = 0) {
  const Eigen::Vector3d d = direction.normalized();
  Ray r;
  for (int i = 0; i < 3; ++i) r.direction[i] = static_cast<float>(d[i]);
  r.time = time;
  return r;
}
inline Eigen::Vector3d direction_of(const Ray& r) {
  return Eigen::Vector3d(static_cast<double>(r.direction[0]), static_cast<double>(r.direction[1]),
                         static_cast<double>(r.direction[2]))
      .normalized();
}
/// The pixels of a pinhole, as rays.
inline std::vector<Ray> pinhole_rays(const Eigen::Matrix3d& R_world_camera, int width, int height, double f) {
  std::vector<Ray> rays;
  for (int v = 0; v < height; ++v)
    for (int u = 0; u < width; ++u)
      rays.push_back(ray(R_world_camera *
                         Eigen::Vector3d((u - 0.5 * (width - 1)) / f, (v - 0.5 * (height - 1)) / f, 1)));
  return rays;
}
/// All round, `rows` between these elevations.
inline std::vector<Ray> ring_rays(int columns, int rows, double low_deg, double high_deg) {
  std::vector<Ray> rays;
  for (int c = 0; c < columns; ++c)
    for (int r = 0; r < rows; ++r)
      rays.push_back(ray(direction(c * 360.0 / columns,
                                   rows > 1 ? low_deg + r * (high_deg - low_deg) / (rows - 1) : low_deg)));
  return rays;
}

/// A sphere of triangles about (0, 0, 0) with the exact normals of a sphere.
inline std::shared_ptr<Mesh> sphere_mesh(float radius, int steps, std::shared_ptr<const Surface> s) {
  Mesh m;
  for (int j = 0; j <= steps; ++j)
    for (int i = 0; i <= 2 * steps; ++i) {
      const Eigen::Vector3f n = direction(180.0 * i / steps, 180.0 * j / steps - 90).cast<float>();
      const Eigen::Vector3f p = radius * n;
      m.vertices.push_back({{p.x(), p.y(), p.z()}, {n.x(), n.y(), n.z()}, {0, 0}, 0});
      m.bounds.extend(p);
    }
  const auto w = static_cast<std::uint32_t>(2 * steps + 1);
  for (std::uint32_t j = 0; j < static_cast<std::uint32_t>(steps); ++j)
    for (std::uint32_t i = 0; i + 1 < w; ++i) {
      const std::uint32_t a = j * w + i;
      for (const std::uint32_t k : {a, a + w + 1, a + 1, a, a + w, a + w + 1}) m.indices.push_back(k);
    }
  return finished(std::move(m), std::move(s));
}

class RangeViewTest : public ::testing::Test {
 protected:
  void SetUp() override {
    auto device = view_device();
    if (!device) GTEST_SKIP() << "no Vulkan device: " << device.error().text();
    device_ = *device;
    messages_before_ = device_->validation_messages().size();
    auto made = RasterEngine::create(device_);
    ASSERT_TRUE(made) << made.error().text();
    engine_ = *made;
  }
  void TearDown() override {
    if (!device_) return;
    const auto messages = device_->validation_messages();
    for (std::size_t i = messages_before_; i < messages.size(); ++i) ADD_FAILURE() << messages[i];
  }

  void show(std::vector<std::shared_ptr<const Batch>> batches) {
    frame_.batches = std::move(batches);
    show(still(frame_));
  }
  void show(std::shared_ptr<const ContentWindow> window) {
    const Status s = engine_->prepare(std::move(window));
    ASSERT_TRUE(s) << s.error().text();
  }
  std::vector<Hit> cast(const std::vector<Ray>& rays, int band = 4,
                        const Eigen::Vector3d& origin = Eigen::Vector3d::Zero()) {
    std::vector<Hit> hits(rays.size());
    const Status s = engine_->cast({.origin = origin, .band = band, .rays = rays}, hits);
    EXPECT_TRUE(s) << s.error().text();
    return hits;
  }

  std::shared_ptr<Device> device_;
  std::shared_ptr<RasterEngine> engine_;
  ContentFrame frame_;
  std::size_t messages_before_ = 0;
};

}  // namespace rigor::test
