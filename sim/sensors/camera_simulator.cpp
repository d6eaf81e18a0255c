#include "sim/sensors/camera_simulator.h"

#include <cmath>

#include "sensor-hal/models/philox.h"

namespace rigor {

Result<std::unique_ptr<CameraSimulator>> CameraSimulator::create(const CameraSpec& spec,
                                                                 std::shared_ptr<render::Device> device,
                                                                 std::shared_ptr<const world::Scene> scene) {
  auto out = std::unique_ptr<CameraSimulator>(new CameraSimulator());
  out->spec_ = spec;
  out->scene_ = scene;
  if (spec.parent_node) {
    out->parent_ = world::find_node(*scene, *spec.parent_node);
    if (!out->parent_)
      return fail(ErrorCode::bad_input, spec.name,
                  "parent node: expected the name of a node of the world, got '" + *spec.parent_node + "'");
  }
  if (!spec.T_parent_sensor.matrix().allFinite())
    return fail(ErrorCode::bad_input, spec.name, "T_parent_sensor: expected finite numbers");
  render::RendererOptions options;
  options.camera = spec.model;
  options.format = spec.format;
  options.supersampling = spec.supersampling;
  options.noise = spec.noise;
  options.key = models::channel_key(spec.seed, models::channel_id_from_name(spec.name));
  auto renderer = render::Renderer::create(std::move(device), std::move(scene), options);
  if (!renderer) {
    Error e = renderer.error();
    e.where = spec.name + ": " + e.where;
    return tl::unexpected(std::move(e));
  }
  out->renderer_ = std::move(*renderer);
  return out;
}

Status CameraSimulator::capture(const CaptureRequest& request, const world::WorldSnapshot& snapshot,
                                std::span<std::byte> pixels_out, render::StageTimes* times) {
  render::PictureRequest q;
  // Checked here because the poses are looked up before the renderer can refuse.
  if (snapshot.joints.size() == scene_->nodes.size())
    q.T_world_sensor = T_world_sensor(snapshot, request.t_capture);
  q.t_capture = request.t_capture;
  q.exposure_s = request.exposure.seconds();
  q.gain = std::pow(10.0, request.gain_db / 20.0);
  q.capture_index = request.capture_index;
  q.region = request.region;
  if (q.region.width_px == 0) q.region = {0, 0, spec_.model.width_px, spec_.model.height_px};
  return renderer_->draw(q, snapshot, pixels_out, times);
}

std::size_t CameraSimulator::full_region_bytes() const {
  return image_bytes(spec_.format, static_cast<std::size_t>(spec_.model.width_px),
                     static_cast<std::size_t>(spec_.model.height_px));
}

Eigen::Isometry3d CameraSimulator::T_world_sensor(const world::WorldSnapshot& snapshot, BenchTime t) const {
  return world::T_world_node(*scene_, snapshot, parent_, t) * spec_.T_parent_sensor;
}

std::optional<PixelPosition> CameraSimulator::project_world(const Eigen::Vector3d& p_world,
                                                            const world::WorldSnapshot& snapshot,
                                                            BenchTime t) const {
  const Eigen::Vector3d p = T_world_sensor(snapshot, t).inverse() * p_world;
  return project(spec_.model, {p.x(), p.y(), p.z()});
}

std::vector<std::optional<PixelPosition>> CameraSimulator::project_chessboard(
    std::size_t body, const world::WorldSnapshot& snapshot, BenchTime t) const {
  std::vector<std::optional<PixelPosition>> out;
  const Eigen::Isometry3d T_world_body = world::T_world_body(*scene_, snapshot, body, t);
  for (const Eigen::Vector3d& corner : world::chessboard_corners_in_body(scene_->bodies[body]))
    out.push_back(project_world(T_world_body * corner, snapshot, t));
  return out;
}

Eigen::Isometry3d look_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& target,
                          const Eigen::Vector3d& up) {
  const Eigen::Vector3d forward = (target - eye).normalized();
  const Eigen::Vector3d right = forward.cross(up).normalized();
  Eigen::Isometry3d T_world_sensor = Eigen::Isometry3d::Identity();
  T_world_sensor.linear().col(0) = right;
  T_world_sensor.linear().col(1) = forward.cross(right);
  T_world_sensor.linear().col(2) = forward;
  T_world_sensor.translation() = eye;
  return T_world_sensor;
}

}  // namespace rigor
