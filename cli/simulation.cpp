#include "cli/simulation.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <map>

#include "sensor-hal/models/camera_yaml.h"
#include "sim/render/device.h"
#include "sim/sensors/camera_simulator.h"
#include "sim/world/scene_graph.h"
#include "sim/world/semantic_types.h"
#include "sim/world/world_yaml.h"

namespace rigor {
namespace {

/// Hinged nodes of the scene, in its order: joint i of WorldMotion is node nodes[i].
std::vector<std::size_t> hinged_nodes(const world::Scene& scene) {
  std::vector<std::size_t> nodes;
  for (std::size_t i = 0; i < scene.nodes.size(); ++i)
    if (scene.nodes[i].hinge) nodes.push_back(i);
  return nodes;
}

/// T_world_sensor: { position_m: [x, y, z], look_at_m: [x, y, z] }  or  { position_m, quaternion_wxyz }.
Eigen::Isometry3d read_pose(ConfigNode n) {
  const auto vector = [](const std::vector<double>& v) { return Eigen::Vector3d(v[0], v[1], v[2]); };
  const Eigen::Vector3d position = vector(n.numbers("position_m", 3));
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  if (n.has("look_at_m")) {
    const Eigen::Vector3d target = vector(n.numbers("look_at_m", 3));
    const Eigen::Vector3d up = n.has("up") ? vector(n.numbers("up", 3)) : Eigen::Vector3d::UnitZ();
    if ((target - position).cross(up).norm() < 1e-9)
      throw n.error(
          "look_at_m",
          "expected a point that is neither the position nor straight along `up` from it; give another `up`");
    pose = look_at(position, target, up);
  } else {
    const std::vector<double> q = n.numbers("quaternion_wxyz", 4);
    const Eigen::Quaterniond rotation(q[0], q[1], q[2], q[3]);
    if (std::abs(rotation.norm() - 1) > 1e-3)
      throw n.error("quaternion_wxyz",
                    fmt::format("expected a quaternion of length 1, got length {:.6g}", rotation.norm()));
    pose.linear() = rotation.normalized().toRotationMatrix();
    pose.translation() = position;
  }
  n.finish();
  return pose;
}

/// A simulated camera behind the HAL's interface. A renderer is made for one pixel format, so there is one
/// for each format that was ever asked for; the default one is ready from the beginning.
class CameraProvider final : public ImageProvider {
 public:
  CameraProvider(CameraSpec spec, Duration exposure, std::shared_ptr<render::Device> device,
                 std::shared_ptr<const world::Scene> scene)
      : spec_(std::move(spec)),
        exposure_(exposure),
        device_(std::move(device)),
        scene_(std::move(scene)),
        joints_(hinged_nodes(*scene_)),
        snapshot_(*scene_) {}

  Status prepare(PixelFormat format) {
    auto camera = camera_for(format);
    return camera ? Status{} : Status(tl::unexpected<Error>(camera.error()));
  }

  [[nodiscard]] Geometry geometry() const override {
    return {static_cast<std::uint32_t>(spec_.model.width_px),
            static_cast<std::uint32_t>(spec_.model.height_px), spec_.format, exposure_,
            spec_.name + "_optical"};
  }

  [[nodiscard]] Status capture(const ImageRequest& request, std::span<std::byte> pixels) override {
    auto camera = camera_for(request.format);
    if (!camera) return tl::unexpected<Error>(camera.error());
    for (std::size_t i = 0; i < joints_.size(); ++i) {
      const JointState j = i < request.motion.count ? request.motion.joint[i] : JointState{};
      snapshot_.joints[joints_[i]] = {j.t_ref, j.position_rad, j.rate_radps};
    }
    CaptureRequest r;
    r.capture_index = request.index;
    r.t_capture = request.t_capture;
    r.exposure = request.exposure.ns() > 0 ? request.exposure : exposure_;
    r.gain_db = request.gain_db;
    r.region = {static_cast<int>(request.offset_x_px), static_cast<int>(request.offset_y_px),
                static_cast<int>(request.width_px), static_cast<int>(request.height_px)};
    return (*camera)->capture(r, snapshot_, pixels);
  }

 private:
  Result<CameraSimulator*> camera_for(PixelFormat format) {
    auto& camera = cameras_[format];
    if (!camera) {
      CameraSpec spec = spec_;
      spec.format = format;
      auto made = CameraSimulator::create(spec, device_, scene_);
      if (!made) return tl::unexpected<Error>(made.error());
      camera = std::move(*made);
    }
    return camera.get();
  }

  CameraSpec spec_;
  Duration exposure_;
  std::shared_ptr<render::Device> device_;
  std::shared_ptr<const world::Scene> scene_;
  std::vector<std::size_t> joints_;
  world::WorldSnapshot snapshot_;
  std::map<PixelFormat, std::unique_ptr<CameraSimulator>> cameras_;
};

}  // namespace

struct Simulation::Impl {
  SimulationConfig config;
  std::unique_ptr<world::Database> db;
  std::shared_ptr<const world::Scene> scene;  ///< the cameras' view of it
  std::vector<std::size_t> joints;
  std::shared_ptr<render::Device> device;

  Result<std::shared_ptr<render::Device>> open_device() {
    if (device) return device;
    render::DeviceOptions options;
    options.name_contains = config.device;
    auto opened = render::Device::create(options);
    if (!opened) return opened;
    device = *opened;
    return device;
  }
};

Simulation::Simulation(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Simulation::~Simulation() = default;

Result<std::unique_ptr<Simulation>> Simulation::open(const SimulationConfig& config) {
  auto impl = std::make_unique<Impl>();
  impl->config = config;
  auto file = world::load_world(config.world);
  if (!file) return tl::unexpected<Error>(file.error());
  impl->db = world::Database::create();
  if (auto s = world::define_semantic_types(*impl->db); !s) return tl::unexpected<Error>(s.error());
  if (auto s = world::put_scene(*impl->db, *file); !s) return tl::unexpected<Error>(s.error());
  auto scene = world::scene_of(impl->db->snapshot());
  if (!scene) return tl::unexpected<Error>(scene.error());
  impl->scene = std::make_shared<const world::Scene>(std::move(*scene));
  impl->joints = hinged_nodes(*impl->scene);
  if (impl->joints.size() > WorldMotion::kMax)
    return fail(
        ErrorCode::bad_input, config.world.string(),
        fmt::format("expected at most {} hinged nodes, got {}", WorldMotion::kMax, impl->joints.size()));
  return std::unique_ptr<Simulation>(new Simulation(std::move(impl)));
}

Result<std::shared_ptr<ImageProvider>> Simulation::camera(ConfigNode params, std::uint64_t seed,
                                                          const std::string& name, bool ideal) {
  struct Keys {
    CameraSheet sheet;
    Eigen::Isometry3d T_world_sensor;
    PixelFormat format;
  };
  auto keys = catch_config([&] {
    auto sheet = load_camera(params.base_dir() / params.text("sensor"));
    if (!sheet) throw ConfigError(sheet.error());
    const std::string format = params.text_or("pixel_format", "Mono8");
    return Keys{std::move(*sheet), read_pose(params.map("T_world_sensor")),
                pixel_format_from(format).value_or(PixelFormat::mono8)};
  });
  if (!keys) return tl::unexpected<Error>(keys.error());
  auto device = impl_->open_device();
  if (!device) return tl::unexpected<Error>(device.error());

  CameraSpec spec;
  spec.name = name;
  spec.model = keys->sheet.model;
  spec.format = keys->format;
  spec.supersampling = keys->sheet.supersampling;
  spec.noise = !ideal;
  spec.seed = seed;
  spec.T_parent_sensor = keys->T_world_sensor;
  auto provider =
      std::make_shared<CameraProvider>(spec, seconds_from(keys->sheet.exposure_s), *device, impl_->scene);
  if (auto s = provider->prepare(keys->format); !s) return tl::unexpected<Error>(s.error());
  return std::shared_ptr<ImageProvider>(std::move(provider));
}

Result<std::size_t> Simulation::joint(const std::string& name) const {
  std::string names;
  for (std::size_t i = 0; i < impl_->joints.size(); ++i) {
    const std::string& node = impl_->scene->nodes[impl_->joints[i]].name;
    if (node == name) return i;
    names += (names.empty() ? "" : ", ") + node;
  }
  return fail(ErrorCode::bad_input, impl_->config.world.string(),
              fmt::format("expected a hinged node of this world ({}), got \"{}\"",
                          names.empty() ? "it has none" : names, name));
}

std::size_t Simulation::joint_count() const { return impl_->joints.size(); }
std::string Simulation::engine() const { return impl_->device ? "vulkan on " + impl_->device->name() : ""; }

std::vector<DoctorFinding> Simulation::doctor() {
  using Level = DoctorFinding::Level;
  const auto devices = render::Device::list();
  if (!devices || devices->empty())
    return {{Level::missing, devices ? "no Vulkan device" : devices.error().text(),
             "apt-get install mesa-vulkan-drivers (a software device), or the driver of your GPU"}};
  std::vector<DoctorFinding> out;
  for (const std::string& name : *devices) {
    const bool software = name.find("llvmpipe") != std::string::npos;
    out.push_back({software ? Level::note : Level::good,
                   "Vulkan device " + name + (software ? ": renders on the CPU, beside the loop" : ""), ""});
  }
  return out;
}

}  // namespace rigor
