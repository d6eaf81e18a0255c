#include "bench/run/rig_frames.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <map>

#include <set>
#include "sim/platform/platform.h"
#include "sim/world/pose.h"

namespace rigor {
namespace {

using record::FrameLink;

constexpr const char* kOdometryFrame = "odom";  // of the headers of nav_msgs/Odometry (sample_codec.h)

/// Kinds whose headers name a place.
bool has_place(SampleKind kind) {
  return kind == SampleKind::image || kind == SampleKind::range_image || kind == SampleKind::point_cloud ||
         kind == SampleKind::imu || kind == SampleKind::nav_fix || kind == SampleKind::odometry;
}

class Builder {
 public:
  Builder(const RigConfig& rig, const Simulation* simulation) : rig_(rig), simulation_(simulation) {
    out_.tree = record::FrameTree(rig.frames.root);
    if (!simulation_) return;
    world_.emplace(simulation_->world().snapshot());
    const world::types::Hinge hinge(world_->schema());
    std::vector<world::NodeId> hinges = world_->nodes(hinge.type);
    std::sort(hinges.begin(), hinges.end());  // joint i of a WorldMotion is the i-th
    for (std::size_t i = 0; i < hinges.size(); ++i) joint_of_[hinges[i]] = i;
    for (const auto& [name, node] : simulation_->world().platform_nodes()) platform_nodes_.push_back(node);
  }

  FramesOfRig build(const std::vector<std::unique_ptr<RunChannel>>& channels) {
    if (simulation_) {
      for (const auto& [node, joint] : joint_of_) (void)frame_of(node);
      for (std::size_t i = 0; i < simulation_->platforms().size(); ++i) add_platform(i);
    }
    for (const auto& c : channels)
      if (has_place(c->entry->kind)) add_sensor(*c->entry, c->source->describe().frame_id);
    for (const FramesConfig::Mount& m : rig_.frames.mounts)
      if (!mounted_.contains(m.frame))
        throw m.node.error("", fmt::format("expected the frame of a sensor ({}), got \"{}\"",
                                           fmt::join(sensors_, ", "), m.frame));
    return std::move(out_);
  }

 private:
  void add(FrameLink link) {
    // Two of one name in a world: the first has it.
    if (!out_.tree.contains(link.child)) (void)out_.tree.add(std::move(link));
  }

  [[nodiscard]] std::string name_of(world::NodeId node) const {
    const world::types::Frame frame(world_->schema());
    const std::string& name = world_->get_or_default(node, frame.name);
    return name.empty() ? fmt::format("node{}", node.value) : name;
  }

  /// The frame of a node of the world, which is added with those that it needs.
  std::string frame_of(world::NodeId node) {
    if (const auto it = frames_.find(node); it != frames_.end()) return it->second;
    const std::string name = name_of(node);
    frames_[node] = name;
    if (const auto p = std::find(platform_nodes_.begin(), platform_nodes_.end(), node);
        p != platform_nodes_.end()) {
      add_platform(static_cast<std::size_t>(p - platform_nodes_.begin()));
      return name;
    }
    if (const auto part = parts_.find(name); part != parts_.end()) {
      add_part(part->second.first, part->second.second);
      return name;
    }
    // The next above it that moves, or is a frame already; between them nothing does.
    const world::types::Frame frame(world_->schema());
    world::NodeId above = world_->target(node, frame.part_of);
    std::size_t steps = 0;
    while (above && !joint_of_.contains(above) && !frames_.contains(above) && ++steps < 1000)
      above = world_->target(above, frame.part_of);
    FrameLink link;
    link.parent = above ? frame_of(above) : out_.tree.root();
    link.child = name;
    const world::Pose T_world_node = world_->T_world_node(node, BenchTime());
    link.T_parent_child =
        pose_of(above ? world_->T_world_node(above, BenchTime()).inverse() * T_world_node : T_world_node);
    if (const auto joint = joint_of_.find(node); joint != joint_of_.end()) {
      const world::types::Hinge hinge(world_->schema());
      const world::Vector3& axis = world_->get_or_default(node, hinge.axis);
      link.moves = FrameLink::Moves::turns;
      link.index = joint->second;
      link.axis = {axis.x(), axis.y(), axis.z()};
    }
    add(std::move(link));
    return name;
  }

  void add_platform(std::size_t body) {
    const WorldPlatform& p = simulation_->platforms()[body];
    if (out_.tree.contains(p.name)) return;
    add({.parent = out_.tree.root(),
         .child = p.name,
         .T_parent_child = p.model->motion_at(BenchTime()).body.T_world_body,
         .moves = FrameLink::Moves::with_body,
         .index = body});
    const std::vector<PlatformPart> parts = p.model->parts();
    for (std::size_t i = 0; i < parts.size(); ++i) parts_[p.name + "." + parts[i].name] = {body, i};
    for (std::size_t i = 0; i < parts.size(); ++i)
      if (parts[i].moves != PlatformPart::Moves::fixed) add_part(body, i);
  }

  void add_part(std::size_t body, std::size_t index) {
    const WorldPlatform& p = simulation_->platforms()[body];
    const std::vector<PlatformPart> parts = p.model->parts();
    const PlatformPart& part = parts[index];
    FrameLink link;
    link.child = p.name + "." + part.name;
    if (out_.tree.contains(link.child)) return;
    link.parent = p.name;
    if (part.parent >= 0) {
      add_part(body, static_cast<std::size_t>(part.parent));
      link.parent = p.name + "." + parts[static_cast<std::size_t>(part.parent)].name;
    }
    link.T_parent_child = pose_of(part.T_parent_part);
    if (part.moves != PlatformPart::Moves::fixed) {
      link.moves =
          part.moves == PlatformPart::Moves::slides ? FrameLink::Moves::slides : FrameLink::Moves::turns;
      link.index = p.first_joint + static_cast<std::size_t>(part.joint);
      link.axis = {part.axis.x(), part.axis.y(), part.axis.z()};
    }
    add(std::move(link));
  }

  /// By `frames.mounts`.
  bool by_rig(FrameLink& link, SensorAxes axes) {
    for (const FramesConfig::Mount& m : rig_.frames.mounts) {
      if (m.frame != link.child) continue;
      mounted_.insert(m.frame);
      link.parent = m.parent;
      if (!out_.tree.contains(m.parent) && simulation_) {
        const auto node = simulation_->world().frame_named(m.parent);
        if (!node) throw m.node.error("parent", node.error().message);
        link.parent = frame_of(*node);
      }
      if (!out_.tree.contains(link.parent))
        throw m.node.error("parent", fmt::format("expected {} or another frame of this rig, got \"{}\"",
                                                 out_.tree.root(), m.parent));
      link.T_parent_child = pose_of(read_pose(m.node, axes));
      return true;
    }
    return false;
  }

  /// By the keys of what measures.
  bool by_keys(FrameLink& link, const ConfigNode& params, SensorAxes axes) {
    if (!params.present() || (!params.has("T_world_sensor") && !params.has("T_parent_sensor"))) return false;
    if (!simulation_) {
      if (!params.has("T_world_sensor") || params.map("T_world_sensor").flag_or("above_ground", false))
        return false;
      link.T_parent_child = pose_of(read_pose(params.map("T_world_sensor"), axes));
      return true;
    }
    const Mount mount = read_mount(params, simulation_->world(), axes);
    if (mount.body >= 0)
      link.parent = simulation_->platforms()[static_cast<std::size_t>(mount.body)].name;
    else if (mount.parent)
      link.parent = frame_of(mount.parent);
    link.T_parent_child = pose_of(mount.T_parent_sensor);
    if (mount.moves()) {
      link.moves = FrameLink::Moves::by_itself;
      link.way = [mount](Duration since_start) { return pose_of(mount.at(since_start)); };
    }
    return true;
  }

  /// Odometry has no pose of its own: it is of a platform's base, or of a mount that moves.
  bool by_platform(FrameLink& link, const ConfigNode& params) {
    if (!simulation_ || !params.present() || !params.has("platform")) return false;
    const auto body = simulation_->platform(params.text("platform"));
    if (!body) return false;
    link.parent = simulation_->platforms()[*body].name;
    return true;
  }

  void add_sensor(const ChannelEntry& entry, const std::string& frame) {
    if (frame.empty() || out_.tree.contains(frame)) return;
    const bool optical = entry.kind == SampleKind::image || entry.kind == SampleKind::range_image;
    const SensorAxes axes = optical ? SensorAxes::optical : SensorAxes::forward;
    const ConfigNode& own = entry.is_pair ? entry.simulated.params : entry.source.params;
    const EmulatorEntry* emulator = rig_.emulator(entry.source.emulated_by);
    const ConfigNode device = emulator ? emulator->emulator.params : ConfigNode();
    FrameLink link;
    link.parent = out_.tree.root();
    link.child = frame;
    sensors_.push_back(frame);
    const bool known =
        by_rig(link, axes) || by_keys(link, own, axes) ||
        (entry.kind == SampleKind::odometry && (by_platform(link, own) || by_platform(link, device))) ||
        by_keys(link, device, axes);
    if (!known) out_.assumed.push_back(frame);
    if (entry.kind == SampleKind::odometry) add_odom(link);
    // The sensor's name may be that of a platform or a node: that one is there already, and stays.
    (void)out_.tree.add_sensor(std::move(link));
  }

  void add_odom(const FrameLink& base) {
    FrameLink odom;
    odom.parent = out_.tree.root();
    odom.child = kOdometryFrame;
    odom.T_parent_child = base.T_parent_child;
    for (const FrameLink& l : out_.tree.links())
      if (l.child == base.parent)
        odom.T_parent_child = record::composed(l.T_parent_child, base.T_parent_child);
    add(std::move(odom));
  }

  const RigConfig& rig_;
  const Simulation* simulation_;
  std::optional<world::Snapshot> world_;
  std::map<world::NodeId, std::size_t> joint_of_;
  std::vector<world::NodeId> platform_nodes_;
  std::map<world::NodeId, std::string> frames_;
  std::map<std::string, std::pair<std::size_t, std::size_t>> parts_;  ///< by name: platform, part
  std::set<std::string> mounted_;
  std::vector<std::string> sensors_;
  FramesOfRig out_;
};

}  // namespace

Result<FramesOfRig> frames_of(const RigConfig& rig, const std::vector<std::unique_ptr<RunChannel>>& channels,
                              const Simulation* simulation) {
  return catch_config([&] { return Builder(rig, simulation).build(channels); });
}

}  // namespace rigor
