// A specimen's calibration, in either of the formats that are about:
//
//   YAML of ros-drivers/velodyne (VLP16db.yaml): angles in radians, lengths in metres
//     lasers:
//     - { laser_id: 0, rot_correction: 0.0, vert_correction: -0.2618, dist_correction: 0.0,
//         vert_offset_correction: 0.0112, horiz_offset_correction: 0.0, focal_distance: 0.0, focal_slope:
//         0.0, … }
//     num_lasers: 16
//     distance_resolution: 0.002
//
//   XML of VeloView and of Velodyne's calibration discs (db.xml): degrees and centimetres
//     <points_> <item> <px> <id_>0</id_> <rotCorrection_>… </px> </item> … </points_>
//
// `dist_correction_x` and `_y` belong to the two-point correction of the HDL-64E: a file that asks for it is
// refused. Formats read from ros-drivers/velodyne (calibration.cpp, gen_calibration.py) and VeloView
// (vtkVelodynePacketInterpreter.cxx).
#pragma once

#include <filesystem>
#include <string_view>

#include "drivers/velodyne/velodyne_device.h"

namespace rigor::velodyne {

/// not_found, or bad_input as `file:line:column: …`. Setup.
[[nodiscard]] Result<Calibration> load_calibration(const std::filesystem::path& file, Model model);
/// The same from text; XML where its first character is `<`. `name` is for messages.
[[nodiscard]] Result<Calibration> parse_calibration(std::string_view text, std::string_view name,
                                                    Model model);

}  // namespace rigor::velodyne
