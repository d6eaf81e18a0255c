// The reference application: finds stems in a 2D scan, knows from a map of stems where it is, and steers
// along a path, or to the stems that are marked for felling. It knows channels and sinks by name and nothing
// of what is behind them.
//
// clang-format off
//   application:
//     name: forest-localization
//     scanner:                                    # or scanners: [ {…}, … ], up to four
//       channel: scanner                          # kind point_cloud, one sweep of one beam a sample
//       T_base_sensor: { position_m: [0.527, 0], yaw_deg: 0, height_m: 0, pitch_deg: 0, roll_deg: 0 }
//       lowest_m: 0.7                             # optional: points below this height are ground
//       ignore_sectors: [ { from_deg: -180, to_deg: 180, within_m: 1.3 } ]    # the vehicle itself
//       step_deg: 0.3333                          # between beams
//       field_of_view_deg: 270                    # symmetrical about the sensor's x
//       range_sigma_mm: 11.6
//       edge_beyond_deg: 0                        # a footprint wider than a step returns beside the stem
//       diameter_m: [0.05, 1.2]                   # of stems
//       max_range_m: 20
//       misfit: 1                                 # where stems are no circles: times the noise's variance
//     odometry: { channel: odometry }             # kind odometry; or registers left_angle, right_angle [rad] with wheel_radius_m
//                                                 # and track_m (the effective one); or wheel_angle [rad], steer [deg] with
//                                                 # wheel_radius_m and wheelbase_m: then the base is the middle of the rear axle
//     imu: { channel: imu, roll_pitch_yaw_deg: [0, 0, 0], levels: false, tilt_sigma_deg: 1 }
//                                                 # optional; its axes in the base; levels (tilt_filter.h): takes the base's tilt
//                                                 # out of scans
//     gnss: { channel: gnss, origin: { latitude_deg, longitude_deg, height_m }, antenna_m: [0, 0] }      # optional
//     map: { file: stems.csv, sigma_m: 0.03, diameter_sigma_m: 0.04 }                                   # stem_map.h
//     start: { position_m: [0, 0], yaw_deg: 0, sigma_m: 0.3, sigma_deg: 5 }                             # optional; without: searches
//     guide: path                                 # path | marked | none
//     path: { points: [ { x_m: 0, y_m: 0 }, … ] } # or file: way.csv with columns x_m, y_m
//     marked: { stand_off_m: 2, dwell_s: 5 }      # drives to each stem with fell: true, the nearest first
//     marked: { along_path: true }                # or along the path: stops where one comes within reach
//     crane: { … }                                # crane_ports.h: cuts the stems there; with along_path
//     drive: { sink: drive, rate_hz: 20, speed_mps: 0.5, max_turn_degps: 45, lookahead_m: 1, stop_within_m: 0.15,
//              steering: { wheelbase_m: 4, max_deg: 35 } }        # optional, see below
//     estimate: { sink: estimate, rate_hz: 20, at_m: [0, 0] }     # optional; of this point of the base
//     search_poses_per_cycle: 100
// clang-format on
//
// `drive` is a sink with values v [m/s] and w [rad/s] (and enable, which is told 1); with `steering` it has v
// and steer_to [deg], the angle of the front wheels, and v is that of the rear axle. It stands while the pose
// is searched for, or too uncertain, at the end, while a crane works, and where the scanners are silent for a
// second and the pose with them. `estimate` is a sink whose values are any of x, y [m], yaw [rad], sigma_x,
// sigma_y, sigma_yaw, state (0 searching, 1 tracking, 2 dead reckoning), stems, matched (of the last scan),
// progress, cross_track [m], target_range [m], target_bearing [rad] (of the marked stem), done, cut (how many
// stems the crane said it cut), out_of_reach (marked stems that it cannot cut from the path): what it is told
// is recorded with the commands.
#pragma once

#include <memory>

#include "sensor-hal/channel/application.h"

namespace rigor {
[[nodiscard]] std::unique_ptr<Application> make_forest_localization();
}
