#include "cli/sensing/sensor_world.h"

#include <fmt/format.h>

#include <algorithm>

#include "sensor-hal/config/yaml.h"

namespace rigor {
namespace {

bool same(const WorldMotion& a, const WorldMotion& b) {
  const auto equal = [](const JointState& x, const JointState& y) {
    return x.t_ref == y.t_ref && x.position_rad == y.position_rad && x.rate_radps == y.rate_radps;
  };
  return a.count == b.count && std::equal(a.joint.begin(), a.joint.begin() + a.count, b.joint.begin(), equal);
}

Status set_weather(world::Database& db, const std::vector<std::pair<std::string, double>>& weather) {
  if (weather.empty()) return {};
  const world::types::Atmosphere atmosphere(db.schema());
  if (db.snapshot().nodes(atmosphere.type).empty()) {
    auto tx = db.begin("an atmosphere");
    if (auto node = tx.create(atmosphere.type); !node) return tl::unexpected<Error>(node.error());
    if (auto s = tx.commit(); !s) return s;
  }
  for (const auto& [attribute, value] : weather)
    if (auto s = set_attribute(db, fmt::format("Atmosphere.{}={:.17g}", attribute, value)); !s) return s;
  return {};
}

}  // namespace

Result<std::unique_ptr<SensorWorld>> SensorWorld::open(
    const std::filesystem::path& file, const std::vector<std::pair<std::string, double>>& weather) {
  auto opened = open_world(file);
  if (!opened) return tl::unexpected<Error>(opened.error());
  if (auto s = set_weather(*opened->db, weather); !s) return tl::unexpected<Error>(s.error());
  std::unique_ptr<SensorWorld> world(new SensorWorld());
  world->opened_ = std::move(*opened);
  const world::Snapshot snapshot = world->snapshot();
  const world::types::Hinge hinge(snapshot.schema());
  world->joints_ = snapshot.nodes(hinge.type);
  std::sort(world->joints_.begin(), world->joints_.end());
  for (const world::NodeId node : world->joints_)
    world->joint_names_.push_back(snapshot.get_or_default(node, hinge.name));
  if (world->joints_.size() > WorldMotion::kMax)
    return fail(
        ErrorCode::bad_input, file.string(),
        fmt::format("expected at most {} hinged nodes, got {}", WorldMotion::kMax, world->joints_.size()));
  return world;
}

Result<world::NodeId> SensorWorld::frame_named(const std::string& name) const {
  const world::Snapshot world = snapshot();
  const world::types::Frame frame(world.schema());
  if (const auto node = world.find_named(frame.type, name)) return *node;
  std::vector<std::string> names;
  for (const world::NodeId node : world.nodes(frame.type))
    if (const auto& n = world.get_or_default(node, frame.name); !n.empty()) names.push_back(n);
  const std::string near = nearest(name, names);
  return fail(ErrorCode::bad_input, "",
              fmt::format("expected the name of a node with a frame, got \"{}\"{}", name,
                          near.empty() ? "" : "; did you mean " + near + "?"));
}

void SensorWorld::make_picture() const {
  if (content_) return;
  picture_ = make_world_picture(opened_);
  content_ = std::make_unique<render::ViewContent>(*opened_.db, *picture_.view);
}

double SensorWorld::ground_z_m(double x_m, double y_m) const {
  const std::lock_guard lock(mutex_);
  make_picture();
  return picture_.ground->height_at(x_m, y_m);
}

void SensorWorld::move(const WorldMotion& motion) {
  if (joints_.empty() || (moved_ && same(motion, motion_))) return;
  const world::Snapshot before = opened_.db->snapshot();
  const world::types::Hinge hinge(before.schema());
  auto tx = opened_.db->begin("joints");
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    const JointState state = i < motion.count ? motion.joint[i] : JointState{};
    const Eigen::Isometry3d& rest = before.get_or_default(joints_[i], hinge.pose);
    const Eigen::Vector3d& axis = before.get_or_default(joints_[i], hinge.axis);
    world::Motion m;
    m.t_ref = state.t_ref;
    m.T_parent_node = rest * Eigen::AngleAxisd(state.position_rad, axis);
    m.angular_velocity_rad_per_s = rest.linear() * axis * state.rate_radps;
    // A node of this type has these attributes, so that neither write can be refused.
    (void)tx.set(joints_[i], hinge.motion, m);
    (void)tx.set(joints_[i], hinge.moves, true);
  }
  moved_ = tx.commit().has_value();
  motion_ = motion;
}

SensorWorld::Moment::Moment(SensorWorld& world, const WorldMotion& motion) : world_(world), motion_(motion) {
  const std::lock_guard lock(world_.mutex_);
  world_.move(motion_);
  snapshot_ = world_.snapshot();
}

std::shared_ptr<const render::ContentWindow> SensorWorld::Moment::collect(const render::ContentQuery& query,
                                                                          BenchTime begin, BenchTime end,
                                                                          int instants) {
  const std::lock_guard lock(world_.mutex_);
  world_.make_picture();
  world_.move(motion_);  // another sensor may have moved it since
  return world_.content_->collect(query, begin, end, instants);
}

Eigen::Isometry3d SensorWorld::Moment::T_world_node(world::NodeId node, BenchTime t) const {
  return snapshot_.contains(node) ? snapshot_.T_world_node(node, t) : Eigen::Isometry3d::Identity();
}

std::string SensorWorld::Moment::type_name(world::NodeId node) const {
  const auto type = snapshot_.type_of(node);
  return type ? snapshot_.schema().type(*type).name : std::string();
}

}  // namespace rigor
