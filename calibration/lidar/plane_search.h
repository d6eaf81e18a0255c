// Walls in what a LiDAR saw: the largest planes, one after the other, by random samples of three returns that
// lie near each other (two for a scanner of one plane). A plane is q with q·p = 1 for its points p, so q is
// its unit normal over its distance.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "calibration/lidar/lidar_returns.h"

namespace rigor::calibration {

/// A plane, found or surveyed, in the sensor's frame.
struct LidarPlane {
  std::string name;
  Eigen::Vector3d q_per_m{0, 0, 0};
  std::size_t returns = 0;
  double reflectance = 0;  ///< surveyed; 0: unknown
};

struct PlaneSearch {
  std::vector<LidarPlane> planes;  ///< the one with the most returns first
  std::vector<std::int8_t> label;  ///< of each return: plane, or −1
  double tolerance_m = 0;          ///< square to the plane, within which a return belonged to it
};

/// How a search judges; lengths are relative to the median range, so that units do not matter.
struct PlaneSearchOptions {
  double tolerance = 0.04;     ///< of the median range: biases and noise, not the wall's own shape
  double minimum_share = 0.1;  ///< of all returns
  int most_planes = 8;
  std::uint64_t seed = 1;
};

/// Unit direction and origin of a return's beam.
void beam_of(const models::LidarBeam& beam, double azimuth_rad, Eigen::Vector3d& direction,
             Eigen::Vector3d& origin_m);
/// Whether all beams lie level, so that a plane's tilt cannot be seen.
[[nodiscard]] bool scans_one_plane(const models::LidarScan& scan);

[[nodiscard]] PlaneSearch find_planes(const LidarReturns& returns, const models::LidarScan& scan,
                                      const PlaneSearchOptions& options = {});
/// The returns of planes that are known: nearer to one of them than the tolerance, and to no other.
[[nodiscard]] PlaneSearch assign_planes(const LidarReturns& returns, const models::LidarScan& scan,
                                        const std::vector<LidarPlane>& planes, double tolerance_m);

}  // namespace rigor::calibration
