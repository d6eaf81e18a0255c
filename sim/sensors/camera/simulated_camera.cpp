#include "sim/sensors/camera/simulated_camera.h"

#include <chrono>
#include <cmath>
#include <utility>

#include "sensor-hal/models/philox.h"

namespace rigor {
namespace {

using Clock = std::chrono::steady_clock;
double ms_between(Clock::time_point a, Clock::time_point b) {
  return std::chrono::duration<double, std::milli>(b - a).count();
}

tl::unexpected<Error> named(const std::string& name, Error e) {
  e.where = e.where.empty() ? name : name + ": " + e.where;
  return tl::unexpected(std::move(e));
}

/// Engines that several cameras measure with.
struct SharedEngines {
  std::shared_ptr<render::ViewRenderer> renderer;
  std::shared_ptr<SharedLight> light;
};

Result<SharedEngines> engines_for(CameraEngine which, const CameraEngines& given) {
  SharedEngines out;
  if (which == CameraEngine::vulkan) {
    auto device = given.device;
    if (!device) {
      auto made = render::Device::create({});
      if (!made) return tl::unexpected(made.error());
      device = *made;
    }
    auto renderer = render::ViewRenderer::create(device);
    if (!renderer) return tl::unexpected(renderer.error());
    out.renderer = std::move(*renderer);
    return out;
  }
  out.light = given.light;
  if (out.light) return out;
  auto light = SharedLight::create(given.cache);
  if (!light) return tl::unexpected(light.error());
  out.light = std::move(*light);
  return out;
}

Result<std::unique_ptr<SimulatedCamera>> camera_with(const SimulatedCameraSpec& spec,
                                                     const SharedEngines& engines) {
  auto optics = engines.renderer ? make_vulkan_optics(spec.model, spec.optics, engines.renderer)
                                 : make_rays_optics(spec.model, spec.optics, engines.light);
  if (!optics) return named(spec.name, optics.error());
  return SimulatedCamera::create(spec, std::move(*optics));
}

/// One look at the world for two cameras: what the second one asks for is what the first one got, if it
/// covers the same time.
class SharedLook final : public render::ContentSource {
 public:
  SharedLook(render::ContentSource& world, Eigen::Isometry3d T_left_right, bool same_lens)
      : world_(world), T_left_right_(std::move(T_left_right)), same_lens_(same_lens) {}

  std::shared_ptr<const render::ContentWindow> collect(const render::ContentQuery& query, BenchTime begin,
                                                       BenchTime end, int instants) override {
    if (window_ && begin_ == begin && end_ == end && instants_ == instants) return window_;
    begin_ = begin;
    end_ = end;
    instants_ = instants;
    window_ = world_.collect(wider(query), begin, end, instants);
    return window_;
  }
  Eigen::Isometry3d T_world_node(render::NodeId node, BenchTime t) const override {
    return world_.T_world_node(node, t);
  }
  std::string type_name(render::NodeId node) const override { return world_.type_name(node); }

 private:
  /// Of two cameras that look the same way each half space is moved out to hold both; else all round.
  [[nodiscard]] render::ContentQuery wider(render::ContentQuery q) const {
    if (!same_lens_ || !T_left_right_.linear().isIdentity(1e-9)) q.frustum.clear();
    // The baseline in world axes is not known here, its length is: enough, and exact enough.
    const double baseline = T_left_right_.translation().norm();
    for (auto& plane : q.frustum) plane.offset() += baseline;
    q.shadow_reach_m += q.shadow_reach_m > 0 ? baseline : 0.0;
    return q;
  }
  render::ContentSource& world_;
  Eigen::Isometry3d T_left_right_;
  bool same_lens_;
  std::shared_ptr<const render::ContentWindow> window_;
  BenchTime begin_, end_;
  int instants_ = 0;
};

}  // namespace

Result<std::unique_ptr<SimulatedCamera>> SimulatedCamera::create(const SimulatedCameraSpec& spec,
                                                                 const CameraEngines& engines) {
  const auto made = engines_for(spec.engine, engines);
  if (!made) return named(spec.name, made.error());
  return camera_with(spec, *made);
}

Result<std::unique_ptr<SimulatedCamera>> SimulatedCamera::create(
    const SimulatedCameraSpec& spec, std::unique_ptr<CameraOpticsPicture> optics) {
  auto sensor =
      SensorStage::create({.name = spec.name, .model = spec.model, .seed = spec.seed, .noise = spec.noise});
  if (!sensor) return named(spec.name, sensor.error());
  auto out = std::unique_ptr<SimulatedCamera>(new SimulatedCamera());
  out->spec_ = spec;
  const auto key = models::channel_key(spec.seed, models::channel_id_from_name(spec.name));
  out->optics_seed_ = (std::uint64_t{key.word1} << 32U) | key.word0;
  out->optics_ = std::move(optics);
  out->sensor_ = std::move(*sensor);
  return out;
}

std::size_t SimulatedCamera::bytes(const CameraCapture& request) const {
  const bool whole = request.region.width_px == 0;
  const int w = whole ? spec_.model.width_px : request.region.width_px,
            h = whole ? spec_.model.height_px : request.region.height_px;
  return image_bytes(request.format.value_or(spec_.format), static_cast<std::size_t>(std::max(w, 0)),
                     static_cast<std::size_t>(std::max(h, 0)));
}

Status SimulatedCamera::capture(const CameraCapture& request, const render::SensorView& view,
                                std::span<std::byte> pixels, GroundTruth* truth, CaptureTimes* times) {
  const auto t0 = Clock::now();
  const OpticsRequest optics{.measure = request.measure,
                             .exposure_s = request.exposure.seconds(),
                             .seed = optics_seed_,
                             .region = request.region};
  if (auto s = optics_->form(optics, view, picture_, truth); !s) return named(spec_.name, s.error());
  const auto t1 = Clock::now();
  const SensorStageRequest sensor{.capture_index = request.measure.index,
                                  .exposure_s = request.exposure.seconds(),
                                  .gain_db = request.gain_db,
                                  .format = request.format.value_or(spec_.format),
                                  .region = request.region};
  if (auto s = sensor_->expose(sensor, picture_, pixels); !s) return named(spec_.name, s.error());
  if (times != nullptr) *times = {ms_between(t0, t1), ms_between(t1, Clock::now()), optics_->prepare_ms()};
  return {};
}

Result<std::unique_ptr<StereoCamera>> StereoCamera::create(const SimulatedCameraSpec& left,
                                                           const SimulatedCameraSpec& right,
                                                           const CameraEngines& engines) {
  const auto made = engines_for(left.engine, engines);
  if (!made) return named(left.name, made.error());
  auto a = camera_with(left, *made), b = camera_with(right, *made);
  if (!a) return tl::unexpected(a.error());
  if (!b) return tl::unexpected(b.error());
  auto out = std::unique_ptr<StereoCamera>(new StereoCamera());
  out->left_ = std::move(*a);
  out->right_ = std::move(*b);
  return out;
}

Status StereoCamera::capture(const CameraCapture& request, render::ContentSource& world, const Side& left,
                             const Side& right) {
  const BenchTime t = request.measure.t_capture;
  const CameraModel &a = left_->spec().model, &b = right_->spec().model;
  const bool same_lens = a.width_px == b.width_px && a.height_px == b.height_px && a.fx_px == b.fx_px &&
                         a.fy_px == b.fy_px && a.cx_px == b.cx_px && a.cy_px == b.cy_px &&
                         a.projection == b.projection && a.lens == b.lens && a.fisheye == b.fisheye;
  SharedLook look(world, left.T_world_sensor(t).inverse() * right.T_world_sensor(t), same_lens);
  if (auto s = left_->capture(request, {look, left.T_world_sensor}, left.pixels, left.truth); !s) return s;
  return right_->capture(request, {look, right.T_world_sensor}, right.pixels, right.truth);
}

}  // namespace rigor
