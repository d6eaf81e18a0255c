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

}  // namespace

Result<std::unique_ptr<SensorWorld>> SensorWorld::open(const std::filesystem::path& file) {
  auto opened = open_world(file);
  if (!opened) return tl::unexpected<Error>(opened.error());
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
  if (!world_.content_) {
    world_.picture_ = make_world_picture(world_.opened_);
    world_.content_ = std::make_unique<render::ViewContent>(*world_.opened_.db, *world_.picture_.view);
  }
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
