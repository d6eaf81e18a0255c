// The reference application: finds stems in a 2D scan, knows from a map of stems where it is, and steers
// along a path, or to the stems that are marked for felling. It knows channels and sinks by name and nothing
// of what is behind them.
//
//   application:
//     name: forest-localization
//     scanner:
//       channel: scanner                          # kind point_cloud, one level sweep a sample
//       T_base_sensor: { position_m: [0.527, 0], yaw_deg: 0 }
//       step_deg: 0.3333                          # between beams
//       field_of_view_deg: 270                    # symmetrical about the sensor's x
//       range_sigma_mm: 11.6
//       edge_beyond_deg: 0                        # a footprint wider than a step returns beside the stem
//       diameter_m: [0.05, 1.2]                   # of stems
//       max_range_m: 20
//       misfit: 1                                 # more where stems are no circles: times the noise's
//       variance
//     odometry: { channel: odometry }             # kind odometry; or registers left_angle, right_angle
//     [rad],
//                                                 # with wheel_radius_m and track_m (the effective one)
//     imu: { channel: imu, roll_pitch_yaw_deg: [0, 0, 0] }                     # optional; its axes in the
//     base gnss: { channel: gnss, origin: { latitude_deg, longitude_deg, height_m }, antenna_m: [0, 0] }  #
//     optional map: { file: stems.csv, sigma_m: 0.03, diameter_sigma_m: 0.04 }          # stem_map.h start: {
//     position_m: [0, 0], yaw_deg: 0, sigma_m: 0.3, sigma_deg: 5 }    # optional; without: searches guide:
//     path                                 # path | marked | none path: { points: [[0, 0], [5, 0]] } # or
//     file: way.csv with columns x_m, y_m marked: { stand_off_m: 2, dwell_s: 5 }      # drives to each stem
//     with fell: true, the nearest first drive: { sink: drive, rate_hz: 20, speed_mps: 0.5, max_turn_degps:
//     45, lookahead_m: 1, stop_within_m: 0.15 } estimate: { sink: estimate, rate_hz: 20 }   # optional
//     search_poses_per_cycle: 100
//
// `drive` is a sink with values v [m/s] and w [rad/s] (and enable, which is told 1). It stands while the pose
// is searched for, or too uncertain, at the end, and where the scanner is silent for a second and the pose
// with it. `estimate` is a sink whose values are any of x, y [m], yaw [rad], sigma_x, sigma_y, sigma_yaw,
// state (0 searching, 1 tracking, 2 dead reckoning), stems, matched (of the last scan), progress, cross_track
// [m], target_range [m], target_bearing [rad] (of the marked stem), done: what it is told is recorded with
// the commands.
#pragma once

#include <memory>

#include "sensor-hal/channel/application.h"

namespace rigor {
[[nodiscard]] std::unique_ptr<Application> make_forest_localization();
}
