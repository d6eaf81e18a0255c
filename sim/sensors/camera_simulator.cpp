#include "sim/sensors/camera_simulator.h"

#include <tbb/task_arena.h>

namespace rigor {
namespace {

/// Pictures of fewer pixels are worked out by one thread: a few milliseconds, in which others would mostly
/// wake up and wait.
constexpr long long kPixelsForThreads = 1'000'000;

}  // namespace

Result<std::unique_ptr<CameraSimulator>> CameraSimulator::create(const CameraSpec& spec,
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
  if (spec.model.bloom.active())
    return fail(ErrorCode::bad_input, spec.name,
                "bloom: expected none, which the renderer scene does not draw; give the channel a "
                "`renderer`");
  auto sensor =
      SensorStage::create({.name = spec.name, .model = spec.model, .seed = spec.seed, .noise = spec.noise});
  if (!sensor) return tl::unexpected<Error>(sensor.error());
  out->sensor_ = std::move(*sensor);
  using render::SceneColours;
  render::SceneRendererOptions options;
  options.camera = spec.model;
  options.colours = is_mono(spec.format)                          ? SceneColours::mono
                    : out->sensor_->rate_planes(spec.format) == 1 ? SceneColours::mosaic
                                                                  : SceneColours::rgb;
  auto renderer = render::SceneRenderer::create(std::move(scene), options);
  if (!renderer) {
    Error e = renderer.error();
    e.where = spec.name + ": " + e.where;
    return tl::unexpected(std::move(e));
  }
  out->renderer_ = std::move(*renderer);
  return out;
}

Status CameraSimulator::capture(const CaptureRequest& request, const world::WorldSnapshot& snapshot,
                                std::span<std::byte> pixels_out) {
  const auto pixels = static_cast<long long>(spec_.model.width_px) * spec_.model.height_px;
  if (pixels >= kPixelsForThreads) return expose(request, snapshot, pixels_out);
  tbb::task_arena alone(1);
  return alone.execute([&] { return expose(request, snapshot, pixels_out); });
}

Status CameraSimulator::expose(const CaptureRequest& request, const world::WorldSnapshot& snapshot,
                               std::span<std::byte> pixels_out) {
  render::PictureRequest q;
  // Checked here because the poses are looked up before the renderer can refuse.
  if (snapshot.joints.size() == scene_->nodes.size())
    q.T_world_sensor = T_world_sensor(snapshot, request.t_capture);
  q.t_capture = request.t_capture;
  q.region = request.region;
  if (q.region.width_px == 0) q.region = {0, 0, spec_.model.width_px, spec_.model.height_px};
  // Sizes that the renderer refuses must not be allocated first.
  rates_.resize(0);
  const render::Region& r = q.region;
  if (r.width_px >= 1 && r.height_px >= 1 && r.width_px <= spec_.model.width_px &&
      r.height_px <= spec_.model.height_px)
    rates_.resize(renderer_->planes() * static_cast<std::size_t>(r.width_px) *
                  static_cast<std::size_t>(r.height_px));
  if (auto s = renderer_->draw(q, snapshot, rates_); !s) return s;
  return sensor_->expose_rates(
      {.capture_index = request.capture_index,
       .exposure_s = request.exposure.seconds(),
       .gain_db = request.gain_db,
       .format = spec_.format,
       .region = {q.region.offset_x_px, q.region.offset_y_px, q.region.width_px, q.region.height_px}},
      rates_, pixels_out);
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
