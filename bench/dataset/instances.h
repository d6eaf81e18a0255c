// Things in a picture: what stands for each, where it is, and its pixels as a run-length code.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "sim/sensors/measurement.h"
#include "sim/world/graph/snapshot.h"

namespace rigor {

/// A class of a dataset: a type of the world's nodes that can be seen. Ids are from 1 in the order of names,
/// and the same for all datasets of one world.
struct DatasetCategory {
  int id = 0;
  std::string name, base;  ///< of the type, and of the one that it derives from
  bool thing = true;       ///< its nodes are instances with boxes; else ground and what covers it
};
[[nodiscard]] std::vector<DatasetCategory> dataset_categories(const world::Snapshot& world);

/// A node of the world in one picture.
struct DatasetInstance {
  std::uint16_t id = 0;  ///< in the layer `instance`, from 1, in the order of the nodes
  std::uint64_t node = 0;
  int category = 0;
  std::string name;                       ///< of the node; may be empty
  std::array<std::uint32_t, 4> box_px{};  ///< x y width height, of the visible pixels, edges included
  std::uint32_t area_px = 0;              ///< visible pixels
  bool cut_off = false;                   ///< it reaches the picture's edge
  float median_depth_m = 0;
};

struct DatasetLabels {
  std::vector<std::uint8_t> category;   ///< id of each element; 0: nothing, or a type without one
  std::vector<std::uint16_t> instance;  ///< id of each element; 0: nothing, or no thing
  std::vector<DatasetInstance> instances;
};
/// `depth_m`: of each element. Things beyond the 65535th of a picture are none.
[[nodiscard]] DatasetLabels label(const GroundTruth& truth, std::span<const float> depth_m,
                                  const std::vector<DatasetCategory>& categories,
                                  const world::Snapshot& world);

}  // namespace rigor
