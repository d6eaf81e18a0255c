// Where the frames of a rig stand: the tree that `/tf_static` and `/tf` tell, with one root.
//
//   FrameTree tree("world");
//   tree.add({.parent = "world", .child = "robot", .moves = FrameLink::Moves::with_body, .index = 0});
//   tree.add({.parent = "robot", .child = "lidar", .T_parent_child = mount});
//   tree.fixed(stamp)                     tf2_msgs/TFMessage of all that never moves: `/tf_static`, once
//   tree.moving(motion, t, t0, stamp, m)  of all that may: `/tf`
//
// Frames are those of docs/conventions.md: x forward, y left, z up, and for cameras `NAME_optical` (z
// forward, x right, y down; REP 103), whose parent is the camera's body `NAME` (add_sensor).
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/channel/providers.h"
#include "sensor-hal/record/ros2_messages.h"

namespace rigor::record {

/// T_a_c from T_a_b and T_b_c.
[[nodiscard]] Pose composed(const Pose& T_a_b, const Pose& T_b_c);
[[nodiscard]] Pose inverse_of(const Pose& T_a_b);

/// One frame in its parent.
struct FrameLink {
  enum class Moves : std::uint8_t {
    fixed,
    with_body,  ///< is body `index` of a WorldMotion; T_parent_child is not used
    turns,      ///< T_parent_child · rotation about `axis` by joint `index`
    slides,     ///< T_parent_child · translation along `axis` by joint `index`
    by_itself   ///< `way` of the time since the start of the run
  };
  std::string parent, child;
  Pose T_parent_child{};
  Moves moves = Moves::fixed;
  std::size_t index = 0;
  std::array<double, 3> axis{0, 0, 1};  ///< in the child's own frame, unit length
  std::function<Pose(Duration since_start)> way{};
};

/// What a recording or a live view tells of frames. One thread at a time.
class FrameSource {
 public:
  virtual ~FrameSource() = default;
  /// All frames that never move; empty: there are none.
  [[nodiscard]] virtual msg::TFMessage fixed(const msg::Time& stamp) const = 0;
  /// Whether any may move.
  [[nodiscard]] virtual bool moves() const = 0;
  /// Those that may, at bench time `t` of a run that began at `t0`; false: nothing is known of that instant.
  [[nodiscard]] virtual bool moving(const WorldMotion& motion, BenchTime t, BenchTime t0,
                                    const msg::Time& stamp, msg::TFMessage& out) = 0;
};

/// Setup: add. The rest: any thread.
class FrameTree {
 public:
  explicit FrameTree(std::string root = "world") : root_(std::move(root)) {}

  [[nodiscard]] const std::string& root() const noexcept { return root_; }
  [[nodiscard]] bool empty() const noexcept { return links_.empty(); }
  [[nodiscard]] const std::vector<FrameLink>& links() const noexcept { return links_; }
  /// The root, or a frame that was added.
  [[nodiscard]] bool contains(std::string_view frame) const;
  /// bad_input: the child has a place already, or its parent has none.
  [[nodiscard]] Status add(FrameLink link);
  /// A sensor's frame. Of one that is called `NAME_optical` the body's frame NAME goes between, where no
  /// other frame has that name: a camera's x forward, which 3D views and robot descriptions expect.
  [[nodiscard]] Status add_sensor(FrameLink link);
  /// T_a_b by frames that never move; empty where a moving one lies between, or one is not there.
  [[nodiscard]] std::optional<Pose> T_fixed(std::string_view a, std::string_view b) const;

  [[nodiscard]] bool moves() const;
  [[nodiscard]] msg::TFMessage fixed(const msg::Time& stamp) const;
  void moving(const WorldMotion& motion, BenchTime t, BenchTime t0, const msg::Time& stamp,
              msg::TFMessage& out) const;

 private:
  [[nodiscard]] const FrameLink* link_of(std::string_view frame) const;
  std::string root_;
  std::vector<FrameLink> links_;
};

/// A tree as a source; it is kept alive.
[[nodiscard]] std::unique_ptr<FrameSource> source_of(std::shared_ptr<const FrameTree> tree);

/// `/tf_static` and `/tf` of a recording, for its replay. `to_utc`: UTC less bench time of the recording.
/// Null where the file has neither. Errors: those of McapReader::open; protocol. Blocks.
[[nodiscard]] Result<std::unique_ptr<FrameSource>> recorded_frames(const std::string& path, Duration to_utc);

}  // namespace rigor::record
