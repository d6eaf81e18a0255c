// A world with grids made from functions, and eyes for what a terrain provider answers.
#pragma once

#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "sim/nature/providers.h"
#include "sim/render/content/content.h"
#include "sim/world/graph/database.h"
#include "sim/world/semantic_types.h"

namespace rigor::ground_test {

using render::Batch;
using render::ContentFrame;
using render::ContentQuery;
using world::NodeId;

struct GridSpec {
  int columns = 65, rows = 65;
  double x_m = 0, y_m = 0, spacing_m = 1;
};
using HeightFunction = std::function<double(double x, double y)>;

class GroundWorld {
 public:
  GroundWorld();
  NodeId add_terrain(const GridSpec& grid, const HeightFunction& height);
  NodeId add_cover(const GridSpec& grid, const std::string& classes,
                   const std::function<int(double x, double y)>& cell);
  NodeId add_vegetation(const std::string& cover, const std::string& plant, double per_m2, double height_m,
                        std::int64_t seed = 1);
  NodeId add_water(std::vector<double> outline, double level_m);
  /// New heights for the cells of a grid; tells the listeners.
  void change_heights(NodeId terrain, const std::function<float(int column, int row, float was)>& edit);
  void commit(const std::function<void(world::Transaction&)>& write);
  /// Keeps a provider up to date.
  void follow(render::ContentProvider& provider);
  [[nodiscard]] world::Snapshot now() const { return db->snapshot(); }

  std::unique_ptr<world::Database> db;

 private:
  std::vector<world::Subscription> subscriptions_;
};

/// Rolling hills with detail down to a few metres.
double hills(double x, double y);

ContentFrame collect(render::ContentProvider& provider, const ContentQuery& query);
/// Everything around an eye.
ContentQuery look_from(double x, double y, double z, double allowed_error_rad = 2e-3);

struct Triangle {
  Eigen::Vector3d a, b, c;
  const Batch* batch;
  [[nodiscard]] Eigen::Vector3d normal() const { return (b - a).cross(c - a); }
};
/// Every triangle of batches whose prototype has this name, finest levels, in the world frame.
std::vector<Triangle> triangles(const ContentFrame& frame, const std::string& prototype = "ground");

/// Heights at which the vertical through (x, y) goes through triangles that face up.
std::vector<double> heights_at(const std::vector<Triangle>& all, double x, double y);
/// First front face along a ray, as a distance; infinity: none.
double first_hit(const std::vector<Triangle>& all, const Eigen::Vector3d& from,
                 const Eigen::Vector3d& direction);

}  // namespace rigor::ground_test
