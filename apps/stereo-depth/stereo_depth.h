// Depth from two cameras: rectifies pairs of pictures after the cameras' sensor models, matches them by
// semi-global matching, and where a channel with true ranges is given says how wrong the result is. It knows
// channels by name and nothing of what is behind them: simulated, real or replayed.
//
//   application:
//     name: stereo-depth
//     left:                     # kind image, Mono8
//       channel: left
//       model: ../sensors/stereo-module-left.yaml
//       T_base_sensor: { position_m: [0, 0.1, 1.2], roll_pitch_yaw_deg: [-90, 0, -90] }   # its mount
//     right: { channel: right, model: …, T_base_sensor: … }
//     pinholes: false           # true: the pictures have no distortion, whatever the sensor models say
//     truth:                    # optional: range_image of a pinhole that stands where the left camera does
//       channel: truth
//       model: ../sensors/stereo-truth.yaml
//     matcher: { disparities: 128, block_px: 5, uniqueness_percent: 10, left_right_px: 1,
//                speckle_px: 100, full: false }
//     within_ms: 1              # captures of a pair differ by no more
//     wait: false               # true: the loop waits for each pair (virtual time)
//     output: report/stereo     # folder: result.json, and view-000.png, … of the first `pictures` pairs
//     pictures: 1
//     picture_width_px: 376     # of each of a picture's columns; that of the rectified picture
//
// The loop hands leases to a thread of the application's own, which does the work. Without `wait` a pair that
// comes while two are waiting is skipped and counted.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {
[[nodiscard]] NamedApplication stereo_depth_application();
}
