// One sample as a file: for people (PNG), for programs (OpenEXR with named planes, PCD).
//
//   .png   image        as the report shows it
//          range image  ranges in false colour, blue near to red far, over 0 to a round number of metres that
//                       holds 98 % of them; black: no return
//          point cloud  from above, x up and y to the left, dots in colours of remission on rings of range;
//                       with several beams, below it beams over azimuth: range in colours, remission in grey
//   .exr   image        the sensor's numbers; range image: planes `range` (m, NaN: none) and `amplitude`
//   .pcd   points       binary; x y z intensity t ring return; of a range image x y z intensity by rows
//
// Every file is written under another name and renamed when it is whole.
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/types/sample.h"
#include "sim/sensors/measurement.h"

namespace rigor {

struct RangePicture {
  std::uint32_t width_px = 0, height_px = 0;
  std::span<const float> range_m, amplitude;  ///< `amplitude` may be empty
};
/// Metres that the reddest colour stands for go to `full_scale_m`.
[[nodiscard]] Status write_range_png(const std::filesystem::path& file, const RangePicture& picture,
                                     double& full_scale_m);
/// `range_m` are differences: white none, blue nearer, red farther, by −full_scale_m to full_scale_m (which
/// holds 95 % of them); black: no return.
[[nodiscard]] Status write_difference_png(const std::filesystem::path& file, const RangePicture& picture,
                                          double& full_scale_m);
[[nodiscard]] Status write_range_exr(const std::filesystem::path& file, const RangePicture& picture);
/// `directions`: of each pixel's ray in the sensor's frame, unit length; NaN: none.
[[nodiscard]] Status write_range_pcd(const std::filesystem::path& file, const RangePicture& picture,
                                     std::span<const std::array<float, 3>> directions);

/// Edge of the picture in metres goes to `full_scale_m`.
[[nodiscard]] Status write_points_png(const std::filesystem::path& file, std::span<const LidarPoint> points,
                                      double& full_scale_m);
[[nodiscard]] Status write_points_pcd(const std::filesystem::path& file, std::span<const LidarPoint> points);

/// Planes `node` and `class` (UINT; classes are named in the attribute `class_names`, one a line), `range`,
/// `normal.X/Y/Z` and, of cameras, `flow.X/Y`. Of points: one row in the order of the samples.
[[nodiscard]] Status write_truth(const std::filesystem::path& file, const GroundTruth& truth);

}  // namespace rigor
