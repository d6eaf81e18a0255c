#include "bench/sensing/sensor_world.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor-hal/config/yaml.h"
#include "sim/nature/trees/allometry.h"
#include "sim/platform/harvester.h"
#include "sim/world/pose.h"

namespace rigor {
namespace {

bool same(const WorldMotion& a, const WorldMotion& b) {
  const auto equal = [](const JointState& x, const JointState& y) {
    return x.t_ref == y.t_ref && x.position_rad == y.position_rad && x.rate_radps == y.rate_radps &&
           x.acceleration_radps2 == y.acceleration_radps2;
  };
  const auto equal_body = [](const BodyState& x, const BodyState& y) {
    return x.t_ref == y.t_ref && x.T_world_body.position_m == y.T_world_body.position_m &&
           x.T_world_body.orientation_wxyz == y.T_world_body.orientation_wxyz &&
           x.velocity_mps == y.velocity_mps && x.acceleration_mps2 == y.acceleration_mps2 &&
           x.turn_rate_radps == y.turn_rate_radps;
  };
  return a.count == b.count && a.body_count == b.body_count &&
         std::equal(a.joint.begin(), a.joint.begin() + a.count, b.joint.begin(), equal) &&
         std::equal(a.body.begin(), a.body.begin() + a.body_count, b.body.begin(), equal_body);
}

Eigen::Vector3d vector(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

Status make_atmosphere(world::Database& db) {
  const world::types::Atmosphere atmosphere(db.schema());
  if (!db.snapshot().nodes(atmosphere.type).empty()) return {};
  auto tx = db.begin("an atmosphere");
  if (auto node = tx.create(atmosphere.type); !node) return tl::unexpected<Error>(node.error());
  return tx.commit();
}

Status set_weather(world::Database& db, const std::vector<std::pair<std::string, double>>& weather) {
  if (weather.empty()) return {};
  if (auto s = make_atmosphere(db); !s) return s;
  for (const auto& [attribute, value] : weather)
    if (auto s = set_attribute(db, fmt::format("Atmosphere.{}={:.17g}", attribute, value)); !s) return s;
  return {};
}

}  // namespace

Result<std::unique_ptr<SensorWorld>> SensorWorld::open(
    const std::filesystem::path& file, const std::vector<std::pair<std::string, double>>& weather,
    const std::vector<NamedFile>& plugins) {
  auto opened = open_world(file, plugins);
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

Ground SensorWorld::ground() const {
  const world::Snapshot world = snapshot();
  if (!world.nodes(world::types::Terrain(world.schema()).type).empty()) {
    const std::lock_guard lock(mutex_);
    make_picture();
    return Ground(picture_.ground);
  }
  const world::types::GroundPlane plane(world.schema());
  const auto planes = world.nodes(plane.type);
  if (planes.empty()) return Ground(0);
  const auto first = *std::min_element(planes.begin(), planes.end());
  return Ground(world.T_world_node(first, BenchTime()).translation().z());
}

Status SensorWorld::add_platform(const WorldPlatform& platform) {
  Carrier carrier;
  carrier.name = platform.name;
  carrier.platform = platform.model;
  carrier.start = platform.model->motion_at(BenchTime()).body;
  const world::Schema& schema = opened_.db->schema();
  const world::types::Frame frame(schema);
  const world::types::Body body(schema);
  const world::types::Material material(schema);
  auto tx = opened_.db->begin("platform " + platform.name);
  const auto fill = [&]() -> Status {
    auto root = tx.create(frame.type);
    if (!root) return tl::unexpected<Error>(root.error());
    carrier.node = *root;
    if (auto s = tx.set(*root, frame.name, platform.name); !s) return s;
    const std::vector<PlatformPart> parts = platform.model->parts();
    std::vector<world::NodeId> nodes;
    for (const PlatformPart& part : parts) {
      const bool shown = platform.visible && part.shape != PlatformPart::Shape::none;
      auto node = tx.create(shown ? body.type : frame.type);
      if (!node) return tl::unexpected<Error>(node.error());
      nodes.push_back(*node);
      if (auto s = tx.set(*node, frame.name, platform.name + "." + part.name); !s) return s;
      if (auto s = tx.set(*node, frame.pose, part.T_parent_part); !s) return s;
      const auto parent = part.parent < 0 ? carrier.node : nodes[static_cast<std::size_t>(part.parent)];
      if (auto s = tx.connect(*node, frame.part_of, parent); !s) return s;
      if (part.moves != PlatformPart::Moves::fixed)
        carrier.parts.push_back({*node, platform.first_joint + static_cast<std::size_t>(part.joint),
                                 part.moves == PlatformPart::Moves::slides, part.axis, part.T_parent_part});
      if (!shown) continue;
      const bool round = part.shape == PlatformPart::Shape::cylinder;
      if (auto s = tx.set(*node, body.shape, std::string(round ? "cylinder" : "box")); !s) return s;
      if (auto s = tx.set(*node, body.size_m, part.size_m); !s) return s;
      auto paint = tx.create(material.type);
      if (!paint) return tl::unexpected<Error>(paint.error());
      if (auto s =
              tx.set(*paint, material.reflectance,
                     world::Numbers(std::vector<double>(part.reflectance.begin(), part.reflectance.end())));
          !s)
        return s;
      if (auto s = tx.connect(*node, body.made_of, *paint); !s) return s;
    }
    return {};
  };
  if (auto s = fill(); !s) return s;
  if (auto s = tx.commit(); !s) return s;
  carriers_.push_back(std::move(carrier));
  return {};
}

Status SensorWorld::edit(world::NodeId node, const std::string& attribute, world::Value value,
                         const std::function<Status(const world::Snapshot&)>& accept) {
  const std::lock_guard lock(mutex_);
  auto tx = opened_.db->begin("edit");
  if (auto s = tx.set(node, attribute, std::move(value)); !s) return s;
  if (auto s = tx.commit(); !s) return s;
  if (auto s = accept(snapshot()); !s) {
    if (auto back = opened_.db->undo(); !back) return back;
    return s;
  }
  ++changes_;
  return {};
}

Status SensorWorld::assign(const std::vector<std::string>& assignments) {
  const std::lock_guard lock(mutex_);
  for (const std::string& assignment : assignments) {
    if (assignment.starts_with("Atmosphere."))
      if (auto s = make_atmosphere(*opened_.db); !s) return s;
    if (auto s = set_attribute(*opened_.db, assignment); !s) return s;
  }
  ++changes_;
  return {};
}

std::vector<std::pair<std::string, world::NodeId>> SensorWorld::platform_nodes() const {
  std::vector<std::pair<std::string, world::NodeId>> all;
  for (const Carrier& c : carriers_) all.emplace_back(c.name, c.node);
  return all;
}

std::optional<std::size_t> SensorWorld::platform_named(const std::string& name) const {
  for (std::size_t i = 0; i < carriers_.size(); ++i)
    if (carriers_[i].name == name) return i;
  return std::nullopt;
}

std::vector<Stem> SensorWorld::stems() const {
  const world::Snapshot world = snapshot();
  const world::types::Tree tree(world.schema());
  std::vector<world::NodeId> nodes = world.nodes(tree.type);
  std::sort(nodes.begin(), nodes.end());
  const Ground under = ground();
  std::vector<Stem> stems;
  for (const world::NodeId node : nodes) {
    const world::Vector3& at = world.get_or_default(node, tree.position);
    const double z_m = std::isnan(at.z()) ? under.height_m(at.x(), at.y()) : at.z();
    if (std::isfinite(at.x() + at.y() + z_m)) stems.push_back({node.value, at.x(), at.y(), z_m});
  }
  return stems;
}

namespace {
/// Ids of what is made of a cut tree: far from those that worlds give, and the same whenever it is made.
world::NodeId stump_of(std::uint64_t tree) { return {tree | std::uint64_t{1} << 40}; }
world::NodeId wood_of(std::uint64_t tree) { return {tree | std::uint64_t{1} << 41}; }
world::NodeId trunk_of(std::uint64_t tree) { return {tree | std::uint64_t{1} << 42}; }
world::NodeId bark_of(std::uint64_t tree) { return {tree | std::uint64_t{1} << 43}; }
constexpr double kStump_m = 0.25;
/// What lies is the trunk without its branches and its top, as one cylinder: three quarters of the height,
/// with the diameter of the middle of such a piece of a cone.
constexpr double kTrunkShare = 0.75, kTrunkTaper = 1 - kTrunkShare / 2;

Status make_body(world::Transaction& tx, const world::Schema& schema, world::NodeId node,
                 world::NodeId material, const char* name, const world::Vector3& size_m,
                 const std::vector<double>& reflectance) {
  const world::types::Body body(schema);
  if (tx.view().contains(node)) return {};
  const world::types::Material kind(schema);
  if (auto s = tx.create_as(material, kind.type); !s) return s;
  if (auto s = tx.set(material, kind.reflectance, world::Numbers(reflectance)); !s) return s;
  if (auto s = tx.create_as(node, body.type); !s) return s;
  if (auto s = tx.set(node, body.name, std::string(name)); !s) return s;
  if (auto s = tx.set(node, body.shape, std::string("cylinder")); !s) return s;
  if (auto s = tx.set(node, body.size_m, size_m); !s) return s;
  return tx.connect(node, body.made_of, material);
}
}  // namespace

/// Brings the world to the trees that stand at the motion's instant. A request for an earlier one, of a
/// simulated side that measures after the fact or of a slower thread, finds them standing again: what a
/// sensor sees depends on its request alone.
Status SensorWorld::fell(world::Transaction& tx, const WorldMotion& motion) {
  std::vector<Felling> wanted;
  for (std::size_t i = 0; i < carriers_.size() && i < motion.body_count; ++i)
    for (const Felling& f : carriers_[i].platform->fellings())
      if (f.t <= motion.body[i].t_ref) wanted.push_back(f);
  std::stable_sort(wanted.begin(), wanted.end(),
                   [](const Felling& a, const Felling& b) { return a.t < b.t; });
  const auto same_cut = [](const Felling& f, const Lying& l) { return f.node == l.cut.node; };
  std::size_t common = 0;
  while (common < wanted.size() && common < lying_.size() && same_cut(wanted[common], lying_[common]))
    ++common;
  changes_ += lying_.size() - common + wanted.size() - common;
  while (lying_.size() > common)
    if (auto s = put_back(tx); !s) return s;
  for (std::size_t i = common; i < wanted.size(); ++i)
    if (auto s = cut(tx, wanted[i]); !s) return s;
  return {};
}

/// The node stays, because ids are never used again, and a request for an earlier instant must find it; a
/// tree without a place is not there for anybody who looks.
Status SensorWorld::cut(world::Transaction& tx, const Felling& felling) {
  constexpr double kNowhere = std::numeric_limits<double>::quiet_NaN();
  const world::Snapshot world = tx.view();
  const world::types::Tree tree(world.schema());
  const world::NodeId node{felling.node};
  if (!world.is_a(node, tree.type))
    return fail(ErrorCode::internal, "felling", "the tree that was cut is not in the world");
  const world::Vector3 at = world.get_or_default(node, tree.position);
  if (auto s = tx.set(node, tree.position, world::Vector3(kNowhere, kNowhere, kNowhere)); !s) return s;
  lying_.push_back({felling, at});
  const world::types::Body body(world.schema());
  const auto ground_m = [&](double x_m, double y_m) {
    const double z_m = picture_.ground ? picture_.ground->height_at(x_m, y_m) : kNowhere;
    return std::isnan(z_m) ? at.z() : z_m;
  };
  const double foot_m = std::isnan(at.z()) ? ground_m(at.x(), at.y()) : at.z();
  if (!std::isfinite(foot_m)) return {};
  // What stays: a stump of fresh wood, ...
  const nature::TreeSize size = nature::size_of(
      *nature::find_species(world.get_or_default(node, tree.species)).species,
      {world.get_or_default(node, tree.dbh_m), world.get_or_default(node, tree.height_m), 0, 0});
  const double wide_m = 1.15 * size.dbh_m;
  if (auto s = make_body(tx, world.schema(), stump_of(felling.node), wood_of(felling.node), "stump",
                         {wide_m, wide_m, kStump_m}, {0.55, 0.42, 0.25, 0.62, 0.62, 0.5});
      !s)
    return s;
  world::Pose pose = world::Pose::Identity();
  pose.translation() = Eigen::Vector3d(at.x(), at.y(), foot_m + kStump_m / 2);
  if (auto s = tx.set(stump_of(felling.node), body.pose, pose); !s) return s;
  // ... and the trunk on the ground before it.
  const double length_m = kTrunkShare * size.height_m, thick_m = kTrunkTaper * size.dbh_m;
  if (auto s = make_body(tx, world.schema(), trunk_of(felling.node), bark_of(felling.node), "lying stem",
                         {thick_m, thick_m, length_m}, {0.22, 0.18, 0.14, 0.4, 0.42, 0.4});
      !s)
    return s;
  const Eigen::Vector2d away(std::cos(felling.yaw_rad), std::sin(felling.yaw_rad));
  const Eigen::Vector2d begin = at.head<2>() + wide_m * away, end = begin + length_m * away;
  const Eigen::Vector3d from(begin.x(), begin.y(), ground_m(begin.x(), begin.y()) + thick_m / 2);
  const Eigen::Vector3d to(end.x(), end.y(), ground_m(end.x(), end.y()) + thick_m / 2);
  pose = world::Pose::Identity();
  pose.linear() = rotation_between(Eigen::Vector3d::UnitZ(), to - from).toRotationMatrix();
  pose.translation() = (from + to) / 2;
  return tx.set(trunk_of(felling.node), body.pose, pose);
}

Status SensorWorld::put_back(world::Transaction& tx) {
  const Lying lying = lying_.back();
  lying_.pop_back();
  const world::types::Tree tree(opened_.db->schema());
  const world::types::Body body(opened_.db->schema());
  world::Pose nowhere = world::Pose::Identity();
  nowhere.translation().setConstant(std::numeric_limits<double>::quiet_NaN());
  for (const world::NodeId made : {stump_of(lying.cut.node), trunk_of(lying.cut.node)})
    if (tx.view().contains(made))
      if (auto s = tx.set(made, body.pose, nowhere); !s) return s;
  return tx.set(world::NodeId{lying.cut.node}, tree.position, lying.position);
}

Status SensorWorld::move_platforms(world::Transaction& tx, const WorldMotion& motion) const {
  const world::types::Frame frame(opened_.db->schema());
  const auto set = [&](world::NodeId node, const world::Motion& m) -> Status {
    if (auto s = tx.set(node, frame.motion, m); !s) return s;
    return tx.set(node, frame.moves, true);
  };
  for (std::size_t i = 0; i < carriers_.size(); ++i) {
    const Carrier& c = carriers_[i];
    const BodyState& b = i < motion.body_count ? motion.body[i] : c.start;
    world::Motion m;
    m.t_ref = b.t_ref;
    m.T_parent_node = isometry_of(b.T_world_body);
    m.velocity_m_per_s = vector(b.velocity_mps);
    m.acceleration_m_per_s2 = vector(b.acceleration_mps2);
    m.angular_velocity_rad_per_s = m.T_parent_node.linear() * vector(b.turn_rate_radps);
    if (auto s = set(c.node, m); !s) return s;
    for (const Part& part : c.parts) {
      const JointState j = part.joint < motion.count ? motion.joint[part.joint] : JointState{};
      const Eigen::Vector3d axis = part.T_parent_part.linear() * part.axis;
      m = {};
      m.t_ref = j.t_ref;
      if (part.slides) {
        m.T_parent_node = part.T_parent_part * Eigen::Translation3d(part.axis * j.position_rad);
        m.velocity_m_per_s = axis * j.rate_radps;
        m.acceleration_m_per_s2 = axis * j.acceleration_radps2;
      } else {
        m.T_parent_node = part.T_parent_part * Eigen::AngleAxisd(j.position_rad, part.axis);
        m.angular_velocity_rad_per_s = axis * j.rate_radps;
        m.angular_acceleration_rad_per_s2 = axis * j.acceleration_radps2;
      }
      if (auto s = set(part.node, m); !s) return s;
    }
  }
  return {};
}

void SensorWorld::move(const WorldMotion& motion) {
  if ((joints_.empty() && carriers_.empty()) || (moved_ && same(motion, motion_))) return;
  // Where trees were cut, what is left of them lies on the ground that the picture knows.
  if (std::any_of(carriers_.begin(), carriers_.end(),
                  [](const Carrier& c) { return !c.platform->fellings().empty(); }))
    make_picture();
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
    m.angular_acceleration_rad_per_s2 = rest.linear() * axis * state.acceleration_radps2;
    // A node of this type has these attributes, so that neither write can be refused.
    (void)tx.set(joints_[i], hinge.motion, m);
    (void)tx.set(joints_[i], hinge.moves, true);
  }
  (void)move_platforms(tx, motion);  // these nodes have these attributes, too
  (void)fell(tx, motion);            // a tree that cannot be cut stands
  moved_ = tx.commit().has_value();
  motion_ = motion;
}

SensorWorld::Moment::Moment(SensorWorld& world, const WorldMotion& motion, StageTime* collecting)
    : world_(world), motion_(motion), collecting_(collecting) {
  const std::lock_guard lock(world_.mutex_);
  world_.move(motion_);
  snapshot_ = world_.snapshot();
}

std::shared_ptr<const render::ContentWindow> SensorWorld::Moment::collect(const render::ContentQuery& query,
                                                                          BenchTime begin, BenchTime end,
                                                                          int instants) {
  const StageTime::Scope scope(collecting_);
  const std::lock_guard lock(world_.mutex_);
  world_.make_picture();
  world_.move(motion_);  // another sensor may have moved it since
  return world_.content_->collect(query, begin, end, instants);
}

Eigen::Isometry3d SensorWorld::Moment::T_world_node(world::NodeId node, BenchTime t) const {
  return snapshot_.contains(node) ? snapshot_.T_world_node(node, t) : Eigen::Isometry3d::Identity();
}

Eigen::Isometry3d SensorWorld::Moment::T_world_platform(std::size_t body, BenchTime t) const {
  return isometry_of((body < motion_.body_count ? motion_.body[body] : world_.carriers_[body].start).at(t));
}

std::string SensorWorld::Moment::type_name(world::NodeId node) const {
  const auto type = snapshot_.type_of(node);
  return type ? snapshot_.schema().type(*type).name : std::string();
}

}  // namespace rigor
