// Fences and poles: instances of a few parts that all of them share.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "sim/nature/built/ribbon.h"
#include "sim/render/content/content.h"

namespace rigor::nature::built {

enum class FenceStyle : std::uint8_t { wire, rails, boards };

struct FenceSpec {
  Line line;               ///< relative to the origin
  Eigen::Vector3d origin;  ///< of the batches
  double height_m = 1.2, post_spacing_m = 2.5;
  FenceStyle style = FenceStyle::wire;
  /// z of the ground relative to the origin; NaN: unknown.
  std::function<double(const Eigen::Vector2d&)> ground{};
  world::NodeId node{};
  std::shared_ptr<const render::Surface> surface{};  ///< null: wood, wire of metal
};

/// One batch for each kind of part.
[[nodiscard]] std::vector<std::shared_ptr<const render::Batch>> make_fence(const FenceSpec& spec);

struct PoleSpec {
  Eigen::Vector3d foot = Eigen::Vector3d::Zero();  ///< world
  double height_m = 8, diameter_m = 0.2;
  world::NodeId node{};
  std::shared_ptr<const render::Surface> surface{};  ///< null: wood
};
[[nodiscard]] std::shared_ptr<const render::Batch> make_pole(const PoleSpec& spec);

}  // namespace rigor::nature::built
