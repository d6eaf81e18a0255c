// Where the samples of a dataset are taken: a list of poses, or a distribution that poses are drawn from.
//
//   file      poses.csv: x_m,y_m and z_m (world) or height_m (above the ground); yaw_deg, pitch_deg,
//   roll_deg, or
//             qw,qx,qy,qz; what is left away has the value of the options
//   within    evenly in a rectangle of the world
//   along     evenly along a path (x_m,y_m), facing along it
//
// A pose is that of the carrier: x forward, y left, z up, R = Rz(yaw) Ry(pitch) Rx(roll); positive pitch
// looks down.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <filesystem>
#include <optional>
#include <vector>

#include "bench/dataset/variation.h"

namespace rigor::dataset {

struct PoseChoice {
  enum class Kind : std::uint8_t { rig, list, within, along };
  Kind kind = Kind::rig;             ///< rig: where the rig has its sensors, for each sample
  std::filesystem::path file;        ///< list, along
  std::string where;                 ///< what named the file, for messages
  std::array<double, 4> within{};    ///< x0 y0 x1 y1, m
  std::optional<Interval> height_m;  ///< above the ground; empty: as the rig has its sensors
  std::optional<Interval> yaw_deg;   ///< along: added to the path's; empty: within all round, else 0
  Interval pitch_deg, roll_deg;
  Interval lateral_m;  ///< along: to the left of the path
};

/// A pose before it is put on the ground.
struct WantedPose {
  double x_m = 0, y_m = 0;
  std::optional<double> z_m;       ///< of the world; empty: `height_m` above the ground
  std::optional<double> height_m;  ///< empty: the rig's
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
};

class PoseSource {
 public:
  /// not_found; bad_input with file and line.
  [[nodiscard]] static Result<PoseSource> create(const PoseChoice& choice);
  /// Of a list; 0 elsewhere.
  [[nodiscard]] std::size_t listed() const { return list_.size(); }
  /// Of sample `index`: pose number index, and over again from the first, of a list; else the draw number
  /// `attempt`. Not for Kind::rig.
  [[nodiscard]] WantedPose at(std::uint64_t seed, std::uint64_t index, std::uint32_t attempt) const;

 private:
  PoseChoice choice_;
  std::vector<WantedPose> list_;
  std::vector<Eigen::Vector2d> path_;
  std::vector<double> length_m_;  ///< of the path up to each point
};

[[nodiscard]] Eigen::Matrix3d rotation_of(double yaw_deg, double pitch_deg, double roll_deg);

}  // namespace rigor::dataset
