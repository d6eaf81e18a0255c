// The world that simulated sensors measure in: a world database, the view of it, and its joints as the bench
// says they stand. One for a process; sensors on any thread take turns.
//
//   auto world = SensorWorld::open("worlds/turntable.yaml");
//   SensorWorld::Moment moment(**world, motion);          // the world with these joints
//   lidar->capture(request, {moment, T_world_sensor}, points);
#pragma once

#include <array>
#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "bench/motion/platforms.h"
#include "bench/world/world_assembly.h"
#include "rt-core/stage_time.h"
#include "sensor-hal/channel/providers.h"
#include "sim/platform/ground.h"
#include "sim/platform/platform.h"
#include "sim/render/engine/content_window.h"
#include "sim/world/semantic_types.h"

namespace rigor {

class SensorWorld {
 public:
  /// Small scenes, worlds in YAML, world files and import plans: cli/world/world_assembly.h. Errors:
  /// not_found, bad_input (also more joints than WorldMotion holds), unavailable.
  /// `weather`: attributes of the world's Atmosphere in place of its own; a world without one gets one.
  /// `plugins`: of the world, beside those that it names itself.
  [[nodiscard]] static Result<std::unique_ptr<SensorWorld>> open(
      const std::filesystem::path& file, const std::vector<std::pair<std::string, double>>& weather = {},
      const std::vector<NamedFile>& plugins = {});

  /// Whether it was read from a small scene of boxes and cylinders.
  [[nodiscard]] bool is_scene() const { return opened_.scene; }
  [[nodiscard]] world::Snapshot snapshot() const { return opened_.db->snapshot(); }
  /// Hinge nodes in the order of their ids: joint i of a WorldMotion.
  [[nodiscard]] const std::vector<std::string>& joint_names() const { return joint_names_; }
  /// A node with a frame, by name. bad_input with the nearest name.
  [[nodiscard]] Result<world::NodeId> frame_named(const std::string& name) const;
  [[nodiscard]] const std::vector<std::string>& warnings() const { return opened_.warnings; }
  /// z of the terrain there; NaN where there is none. Any thread; the first call takes as long as a world
  /// takes to show itself.
  [[nodiscard]] double ground_z_m(double x_m, double y_m) const;
  /// What vehicles drive on: the terrain; where there is none, the level of the world's ground plane, or 0.
  [[nodiscard]] Ground ground() const;

  /// The world's trees, in the order of their ids.
  [[nodiscard]] std::vector<Stem> stems() const;

  /// Setup, before the first sensor: the next body of a WorldMotion, as nodes that are seen and move with it.
  [[nodiscard]] Status add_platform(const WorldPlatform& platform);
  /// What is written while the run goes on, by a thread that has nothing to do with it: one attribute, by its
  /// name, as a transaction of its own that the world's rules and limits may refuse (bad_input, with what
  /// they say). The next sample that is measured shows it. `accept`: sees the world after it, and may refuse
  /// it, too: it is then taken back. Any thread; waits for who measures.
  [[nodiscard]] Status edit(world::NodeId node, const std::string& attribute, world::Value value,
                            const std::function<Status(const world::Snapshot&)>& accept);
  /// Sets attributes of all nodes of a type, `Type.attribute=value` each; an Atmosphere is made where the
  /// world has none. Those that went before one that is refused stay set. Any thread; waits for who measures.
  /// Errors: those of set_attribute (bench/world/world_assembly.h).
  [[nodiscard]] Status assign(const std::vector<std::string>& assignments);
  /// Counts edits, and trees that were cut or stand again. Any thread.
  [[nodiscard]] std::uint64_t changes() const { return changes_.load(std::memory_order_relaxed); }
  /// Names and nodes of the platforms, in the order of their bodies.
  [[nodiscard]] std::vector<std::pair<std::string, world::NodeId>> platform_nodes() const;
  /// Index of a body in a WorldMotion.
  [[nodiscard]] std::optional<std::size_t> platform_named(const std::string& name) const;

  /// The world with its joints as a motion has them. Any thread; one thread at a time for each object; the
  /// world outlives it.
  class Moment final : public render::ContentSource {
   public:
    /// `collecting`: counts the time of collect(); may be null.
    Moment(SensorWorld& world, const WorldMotion& motion, StageTime* collecting = nullptr);
    [[nodiscard]] std::shared_ptr<const render::ContentWindow> collect(const render::ContentQuery& query,
                                                                       BenchTime begin, BenchTime end,
                                                                       int instants) override;
    [[nodiscard]] Eigen::Isometry3d T_world_node(world::NodeId node, BenchTime t) const override;
    [[nodiscard]] std::string type_name(world::NodeId node) const override;
    /// Of a body that the motion does not have: where the platform starts.
    [[nodiscard]] Eigen::Isometry3d T_world_platform(std::size_t body, BenchTime t) const;

   private:
    SensorWorld& world_;
    WorldMotion motion_;
    StageTime* collecting_;
    world::Snapshot snapshot_;
  };

 private:
  struct Part {
    world::NodeId node;
    std::size_t joint = 0;  ///< of a WorldMotion
    bool slides = false;
    Eigen::Vector3d axis;
    Eigen::Isometry3d T_parent_part;  ///< with the joint at zero
  };
  struct Carrier {
    std::string name;
    world::NodeId node;
    BodyState start;
    std::vector<Part> parts;  ///< those that move with a joint
    std::shared_ptr<const Platform> platform;
  };
  struct Lying {
    Felling cut;
    world::Vector3 position;  ///< where it stood
  };
  SensorWorld() = default;
  [[nodiscard]] Status fell(world::Transaction& tx, const WorldMotion& motion);
  [[nodiscard]] Status cut(world::Transaction& tx, const Felling& felling);
  [[nodiscard]] Status put_back(world::Transaction& tx);
  [[nodiscard]] Status move_platforms(world::Transaction& tx, const WorldMotion& motion) const;
  void move(const WorldMotion& motion);  // under the mutex
  void make_picture() const;             // under the mutex

  OpenedWorld opened_;
  std::vector<world::NodeId> joints_;
  std::vector<Carrier> carriers_;
  std::vector<Lying> lying_;  ///< in the order in which they were cut
  std::vector<std::string> joint_names_;
  std::atomic<std::uint64_t> changes_{0};
  mutable std::mutex mutex_;
  bool moved_ = false;
  WorldMotion motion_;
  mutable WorldPicture picture_;  // made by the first that needs it
  mutable std::unique_ptr<render::ViewContent> content_;
};

}  // namespace rigor
