// Content over a stretch of time: what a sensor sees that does not measure in one instant (rows of a rolling
// shutter, four taps of a time-of-flight camera, the firings of a turning LiDAR).
#pragma once

#include <Eigen/Geometry>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "rt-core/time.h"
#include "sim/render/content/world_view.h"

namespace rigor::render {

/// What stands still is one and the same Batch object in all frames; what moves is a batch of its own in
/// each, in the same place of the order, with the same prototype and node. Between two frames poses go
/// linearly (rotations by slerp).
struct ContentWindow {
  BenchTime begin{}, end{};
  std::vector<std::shared_ptr<const ContentFrame>>
      frames;  ///< at equal steps from begin to end; at least one

  [[nodiscard]] const ContentFrame& first() const { return *frames.front(); }
  /// 0 at begin … 1 at end; 0 where the window is one instant.
  [[nodiscard]] double time_of(BenchTime t) const;
};

/// Where a sensor's content comes from. One thread at a time.
class ContentSource {
 public:
  virtual ~ContentSource() = default;
  /// The world at `instants` instants from begin to end (1: at begin); `query.t` is not looked at. A source
  /// that knows that nothing moves gives one frame whatever was asked. Never null.
  [[nodiscard]] virtual std::shared_ptr<const ContentWindow> collect(const ContentQuery& query,
                                                                     BenchTime begin, BenchTime end,
                                                                     int instants) = 0;
  /// For ground truth: pose of a node (identity where it has none) and the name of its type ("" where there
  /// is no such node).
  [[nodiscard]] virtual Eigen::Isometry3d T_world_node(NodeId node, BenchTime t) const = 0;
  [[nodiscard]] virtual std::string type_name(NodeId node) const = 0;
};

/// A frame that never changes: tests and benches.
class StillContent final : public ContentSource {
 public:
  explicit StillContent(std::shared_ptr<const ContentFrame> frame) : frame_(std::move(frame)) {}
  [[nodiscard]] std::shared_ptr<const ContentWindow> collect(const ContentQuery& query, BenchTime begin,
                                                             BenchTime end, int instants) override;
  [[nodiscard]] Eigen::Isometry3d T_world_node(NodeId node, BenchTime t) const override;
  [[nodiscard]] std::string type_name(NodeId node) const override;

 private:
  std::shared_ptr<const ContentFrame> frame_;
};

/// The content of a world by its view. World thread.
class ViewContent final : public ContentSource {
 public:
  /// Both outlive this.
  ViewContent(const world::Database& db, WorldView& view) : db_(db), view_(view) {}
  [[nodiscard]] std::shared_ptr<const ContentWindow> collect(const ContentQuery& query, BenchTime begin,
                                                             BenchTime end, int instants) override;
  [[nodiscard]] Eigen::Isometry3d T_world_node(NodeId node, BenchTime t) const override;
  [[nodiscard]] std::string type_name(NodeId node) const override;

 private:
  const world::Database& db_;
  WorldView& view_;
};

/// Where a sensor is, as a function of time.
using PoseFunction = std::function<Eigen::Isometry3d(BenchTime)>;

/// What a simulator measures in: the world, and its own way through it.
struct SensorView {
  ContentSource& world;
  PoseFunction T_world_sensor;
};

}  // namespace rigor::render
