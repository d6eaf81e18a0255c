// Small worlds made by hand for the view renderer, and a device whose every validation message fails the
// test.
#pragma once

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <memory>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "sim/render/view/tone_map.h"
#include "sim/render/view/view_renderer.h"

namespace rigor::test {

using namespace rigor::render;

inline Result<std::shared_ptr<Device>> view_device() {
  static const auto device = [] {
    auto made = Device::create({.validation = true});
    return made ? made : Device::create({});
  }();
  return device;
}

inline Spectrum grey(float v) { return {v, v, v, v, v, v}; }
inline double deg(double d) { return d * std::numbers::pi / 180; }
/// From north over east, and up from the horizon.
inline Eigen::Vector3d direction(double azimuth_deg, double elevation_deg) {
  const double a = deg(azimuth_deg), e = deg(elevation_deg);
  return {std::sin(a) * std::cos(e), std::cos(a) * std::cos(e), std::sin(e)};
}

struct SurfaceOf {
  static std::shared_ptr<Surface> grey(float reflectance) {
    auto s = std::make_shared<Surface>();
    s->reflectance = test::grey(reflectance);
    return s;
  }
};

inline void add_quad(Mesh& m, const Eigen::Vector3f& a, const Eigen::Vector3f& b, const Eigen::Vector3f& c,
                     const Eigen::Vector3f& d, float sway_top = 0) {
  const Eigen::Vector3f n = (b - a).cross(d - a).normalized();
  const auto first = static_cast<std::uint32_t>(m.vertices.size());
  const Eigen::Vector3f corners[4] = {a, b, c, d};
  const float uv[4][2] = {{0, 1}, {1, 1}, {1, 0}, {0, 0}};
  for (int i = 0; i < 4; ++i) {
    m.vertices.push_back({{corners[i].x(), corners[i].y(), corners[i].z()},
                          {n.x(), n.y(), n.z()},
                          {uv[i][0], uv[i][1]},
                          i >= 2 ? sway_top : 0.0F});
    m.bounds.extend(corners[i]);
  }
  for (const std::uint32_t k : {0U, 1U, 2U, 0U, 2U, 3U}) m.indices.push_back(first + k);
}

inline std::shared_ptr<Mesh> finished(Mesh m, std::shared_ptr<const Surface> surface) {
  m.parts.push_back({0, static_cast<std::uint32_t>(m.indices.size()), std::move(surface)});
  return std::make_shared<Mesh>(std::move(m));
}

/// A box of these half sizes about (0, 0, 0) … shifted by `centre`.
inline void add_box(Mesh& m, const Eigen::Vector3f& h,
                    const Eigen::Vector3f& centre = Eigen::Vector3f::Zero()) {
  const auto p = [&](int x, int y, int z) {
    return Eigen::Vector3f(centre + h.cwiseProduct(Eigen::Vector3i(x, y, z).cast<float>()));
  };
  add_quad(m, p(1, -1, -1), p(1, 1, -1), p(1, 1, 1), p(1, -1, 1));
  add_quad(m, p(-1, 1, -1), p(-1, -1, -1), p(-1, -1, 1), p(-1, 1, 1));
  add_quad(m, p(1, 1, -1), p(-1, 1, -1), p(-1, 1, 1), p(1, 1, 1));
  add_quad(m, p(-1, -1, -1), p(1, -1, -1), p(1, -1, 1), p(-1, -1, 1));
  add_quad(m, p(-1, -1, 1), p(1, -1, 1), p(1, 1, 1), p(-1, 1, 1));
  add_quad(m, p(-1, 1, -1), p(1, 1, -1), p(1, -1, -1), p(-1, -1, -1));
}
inline std::shared_ptr<Mesh> box_mesh(const Eigen::Vector3f& half, std::shared_ptr<const Surface> s,
                                      const Eigen::Vector3f& centre = Eigen::Vector3f::Zero()) {
  Mesh m;
  add_box(m, half, centre);
  return finished(std::move(m), std::move(s));
}
inline std::shared_ptr<Mesh> plane_mesh(float half, std::shared_ptr<const Surface> s) {
  Mesh m;
  add_quad(m, {-half, -half, 0}, {half, -half, 0}, {half, half, 0}, {-half, half, 0});
  return finished(std::move(m), std::move(s));
}

inline std::shared_ptr<Prototype> prototype_of(std::shared_ptr<const Mesh> mesh) {
  auto p = std::make_shared<Prototype>();
  p->levels.push_back({std::move(mesh), 0});
  return p;
}
inline Instance at(float x, float y, float z) {
  Instance i;
  i.position[0] = x;
  i.position[1] = y;
  i.position[2] = z;
  return i;
}
inline std::shared_ptr<Batch> batch_of(std::shared_ptr<const Prototype> p, std::vector<Instance> instances,
                                       std::uint64_t node = 0,
                                       const Eigen::Vector3d& origin = Eigen::Vector3d::Zero()) {
  auto b = std::make_shared<Batch>();
  b->prototype = std::move(p);
  b->instances = std::move(instances);
  b->origin = origin;
  b->node = NodeId{node};
  return b;
}
inline std::shared_ptr<Batch> one(std::shared_ptr<const Mesh> mesh, std::uint64_t node,
                                  const Eigen::Vector3d& origin = Eigen::Vector3d::Zero()) {
  return batch_of(prototype_of(std::move(mesh)), {at(0, 0, 0)}, node, origin);
}

inline std::shared_ptr<SkyMap> even_sky(float radiance) {
  auto s = std::make_shared<SkyMap>();
  s->width = 32;
  s->height = 8;
  s->radiance.assign(32 * 8, grey(radiance));
  return s;
}

inline Eigen::Isometry3d look(const Eigen::Vector3d& eye, const Eigen::Vector3d& to) {
  const Eigen::Vector3d forward = (to - eye).normalized();
  Eigen::Vector3d right = forward.cross(Eigen::Vector3d::UnitZ());
  if (right.norm() < 1e-6) right = Eigen::Vector3d::UnitX();
  right.normalize();
  Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
  t.linear().col(0) = right;
  t.linear().col(1) = forward.cross(right);
  t.linear().col(2) = forward;
  t.translation() = eye;
  return t;
}
inline Pinhole pinhole(int width, int height, double f) {
  return {width, height, f, f, 0.5 * (width - 1), 0.5 * (height - 1), 0.05};
}

class ViewTest : public ::testing::Test {
 protected:
  void SetUp() override {
    auto device = view_device();
    if (!device) GTEST_SKIP() << "no Vulkan device: " << device.error().text();
    device_ = *device;
    messages_before_ = device_->validation_messages().size();
    auto made = ViewRenderer::create(device_);
    ASSERT_TRUE(made) << made.error().text();
    view_ = std::move(*made);
    frame_.light.sky = even_sky(0);
    request_.pinhole = pinhole(160, 120, 150);
    request_.samples = 1;
  }
  void TearDown() override {
    if (!device_) return;
    const auto messages = device_->validation_messages();
    for (std::size_t i = messages_before_; i < messages.size(); ++i) ADD_FAILURE() << messages[i];
  }

  ViewPicture shoot() { return shoot(frame_, request_); }
  ViewPicture shoot(const ContentFrame& frame, const ViewRequest& request) {
    ViewPicture p;
    const Status s = view_->draw(frame, request, p, &statistics_);
    EXPECT_TRUE(s) << s.error().text();
    return p;
  }
  static const float* pixel(const ViewPicture& p, int u, int v) {
    return &p.radiance[4 * (static_cast<std::size_t>(v) * p.width_px + u)];
  }
  static float depth(const ViewPicture& p, int u, int v) {
    return p.depth_m[static_cast<std::size_t>(v) * p.width_px + u];
  }
  static std::uint64_t node(const ViewPicture& p, int u, int v) {
    return p.nodes[static_cast<std::size_t>(v) * p.width_px + u];
  }
  /// Into the folder RIGOR_VIEW_PICTURES, where that variable is set: to be looked at.
  static void save(const ViewPicture& p, const std::string& name, const ToneMapOptions& options = {}) {
    const char* const folder = std::getenv("RIGOR_VIEW_PICTURES");
    if (folder == nullptr) return;
    auto rgb = tone_map(p, options);
    for (std::size_t i = 0; i + 2 < rgb.size(); i += 3) std::swap(rgb[i], rgb[i + 2]);
    cv::imwrite(std::string(folder) + "/" + name + ".png",
                cv::Mat(p.height_px, p.width_px, CV_8UC3, rgb.data()));
  }
  void set_sun(double azimuth_deg, double elevation_deg, float irradiance) {
    frame_.light.direction_to_sun = direction(azimuth_deg, elevation_deg);
    frame_.light.sun_irradiance = grey(irradiance);
  }

  std::shared_ptr<Device> device_;
  std::unique_ptr<ViewRenderer> view_;
  ContentFrame frame_;
  ViewRequest request_;
  ViewStatistics statistics_;
  std::size_t messages_before_ = 0;
};

}  // namespace rigor::test
