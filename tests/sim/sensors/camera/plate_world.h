// Plates before a black sky, lit from behind the camera, that stand or move as a function of time: what a
// camera must make of them is known in closed form.
#pragma once

#include <functional>
#include <utility>

#include "sim/sensors/camera/simulated_camera.h"
#include "tests/sim/render/view/view_fixture.h"

namespace rigor::test {

struct Plate {
  Eigen::Vector3f half;
  std::function<Eigen::Isometry3d(double s)> pose;  ///< T_world_plate
  bool moves = false;
  float reflectance = 1;
};
inline Eigen::Isometry3d at_place(const Eigen::Vector3d& p) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = p;
  return T;
}
inline double seconds_of(BenchTime t) { return static_cast<double>(t.ns()) * 1e-9; }

/// Nodes are numbered from 1, of type "Plate".
class PlateWorld final : public render::ContentSource {
 public:
  PlateWorld() {
    frame_.light.sky = even_sky(0);
    frame_.light.ground_albedo = {};
    frame_.light.direction_to_sun = Eigen::Vector3d(0, -1, 0.05).normalized();
    frame_.light.sun_irradiance = grey(std::numbers::pi_v<float>);
  }
  /// Stands still.
  void put(const Eigen::Vector3f& half, const Eigen::Vector3d& place, float reflectance = 1) {
    add({half, [place](double) { return at_place(place); }, false, reflectance});
  }
  void add(Plate plate) {
    prototypes_.push_back(prototype_of(box_mesh(plate.half, SurfaceOf::grey(plate.reflectance))));
    plates_.push_back(std::move(plate));
    still_.push_back(batch(plates_.size() - 1, 0));
  }
  render::ContentFrame& light() { return frame_; }
  [[nodiscard]] int collected() const { return collected_; }

  std::shared_ptr<const render::ContentWindow> collect(const render::ContentQuery&, BenchTime begin,
                                                       BenchTime end, int instants) override {
    ++collected_;
    auto w = std::make_shared<render::ContentWindow>();
    w->begin = begin;
    w->end = end;
    bool moves = false;
    for (const Plate& p : plates_) moves = moves || p.moves;
    const int n = moves && end > begin ? std::max(instants, 1) : 1;
    for (int i = 0; i < n; ++i) {
      auto f = std::make_shared<render::ContentFrame>(frame_);
      const BenchTime t = n == 1 ? begin : begin + (end - begin) * std::int64_t{i} / std::int64_t{n - 1};
      for (std::size_t k = 0; k < plates_.size(); ++k)
        f->batches.push_back(plates_[k].moves ? batch(k, seconds_of(t)) : still_[k]);
      w->frames.push_back(std::move(f));
    }
    return w;
  }
  Eigen::Isometry3d T_world_node(NodeId node, BenchTime t) const override {
    return node.value >= 1 && node.value <= plates_.size() ? plates_[node.value - 1].pose(seconds_of(t))
                                                           : Eigen::Isometry3d::Identity();
  }
  std::string type_name(NodeId node) const override { return node.value == 0 ? "" : "Plate"; }

 private:
  [[nodiscard]] std::shared_ptr<const Batch> batch(std::size_t k, double s) const {
    const Eigen::Isometry3d T = plates_[k].pose(s);
    Instance i;
    const Eigen::Quaternionf q(T.linear().cast<float>());
    const float xyzw[4] = {q.x(), q.y(), q.z(), q.w()};
    std::copy_n(xyzw, 4, i.rotation);
    auto b = batch_of(prototypes_[k], {i}, k + 1, T.translation());
    b->bounds = Eigen::AlignedBox3d(
        Eigen::Vector3d(T.translation() - Eigen::Vector3d::Constant(plates_[k].half.norm())),
        Eigen::Vector3d(T.translation() + Eigen::Vector3d::Constant(plates_[k].half.norm())));
    return b;
  }
  render::ContentFrame frame_;
  std::vector<Plate> plates_;
  std::vector<std::shared_ptr<const Prototype>> prototypes_;
  std::vector<std::shared_ptr<const Batch>> still_;
  int collected_ = 0;
};

/// 64x48 pixels, the optical axis through their middle.
inline CameraModel small_camera(double f_px = 80) {
  CameraModel m;
  m.width_px = 64;
  m.height_px = 48;
  m.fx_px = m.fy_px = f_px;
  m.cx_px = 31.5;
  m.cy_px = 23.5;
  return m;
}
/// At the world's origin, looking north (+y).
inline Eigen::Isometry3d northward() { return look({0, 0, 0}, {0, 1, 0}); }
/// A point in the optical frame, in the world of a camera that looks north.
inline Eigen::Vector3d in_front(double x, double y, double depth) { return {x, depth, -y}; }

/// Each engine in turn.
class CameraOptics : public ::testing::TestWithParam<CameraEngine> {
 protected:
  void SetUp() override {
    if (GetParam() != CameraEngine::vulkan) return;
    auto device = view_device();
    if (!device) GTEST_SKIP() << "no Vulkan device: " << device.error().text();
    device_ = *device;
    messages_before_ = device_->validation_messages().size();
  }
  void TearDown() override {
    if (!device_) return;
    const auto messages = device_->validation_messages();
    for (std::size_t i = messages_before_; i < messages.size(); ++i) ADD_FAILURE() << messages[i];
  }
  [[nodiscard]] bool rays() const { return GetParam() == CameraEngine::rays; }
  /// Rays to show what the lens does rather than how it is sampled.
  [[nodiscard]] OpticsOptions fine() const {
    OpticsOptions o;
    o.samples = PixelSamples::only(64);
    o.supersampling = 2;
    o.sky_rays = 0;
    o.instants = 8;
    o.allowed_error_px = 0;
    return o;
  }
  [[nodiscard]] OpticsOptions plain() const {
    OpticsOptions o = fine();
    o.samples = PixelSamples::only(1);
    o.supersampling = 1;
    return o;
  }
  std::unique_ptr<CameraOpticsPicture> optics(const CameraModel& m, const OpticsOptions& o) const {
    auto made = rays() ? make_rays_optics(m, o, std::shared_ptr<render::EmbreeCache>())
                       : make_vulkan_optics(m, o, device_);
    EXPECT_TRUE(made) << made.error().text();
    return made ? std::move(*made) : nullptr;
  }
  OpticsPicture shoot(const CameraModel& m, const OpticsOptions& o, const OpticsRequest& request = {},
                      GroundTruth* truth = nullptr) {
    OpticsPicture out;
    auto by = optics(m, o);
    if (!by) return out;
    const Status s = by->form(request, {world_, pose_}, out, truth);
    EXPECT_TRUE(s) << s.error().text();
    return out;
  }
  static float at(const OpticsPicture& p, int u, int v, int band = 0) {
    return p.radiance[4 * static_cast<std::size_t>(v * p.width_px + u) + static_cast<std::size_t>(band)];
  }
  /// Of the light of one band, over some rows: mean place, and variance along u.
  struct Spot {
    double u = 0, v = 0, sum = 0, variance_u = 0;
  };
  static Spot spot(const OpticsPicture& p, int band = 0, int v0 = 0, int v1 = 1 << 20) {
    Spot s;
    double uu = 0;
    for (int v = v0; v < std::min(v1, p.height_px); ++v)
      for (int u = 0; u < p.width_px; ++u) {
        const double w = at(p, u, v, band);
        s.sum += w;
        s.u += w * u;
        s.v += w * v;
        uu += w * u * u;
      }
    s.u /= s.sum;
    s.v /= s.sum;
    s.variance_u = uu / s.sum - s.u * s.u;
    return s;
  }
  static double rms(const OpticsPicture& a, const OpticsPicture& b) {
    double sum = 0;
    for (std::size_t i = 0; i < a.radiance.size(); ++i)
      sum += std::pow(static_cast<double>(a.radiance[i]) - static_cast<double>(b.radiance[i]), 2);
    return std::sqrt(sum / static_cast<double>(a.radiance.size()));
  }

  PlateWorld world_;
  render::PoseFunction pose_ = [](BenchTime) { return northward(); };
  std::shared_ptr<render::Device> device_;
  std::size_t messages_before_ = 0;
};

}  // namespace rigor::test
