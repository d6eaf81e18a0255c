#!/usr/bin/env bash
# The pictures of docs/sensors.md: every sensor without effects, with each of them alone, and with all.
#
# usage: tools/make_sensor_pictures.sh [RIGOR]     default build/release/rigor
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

readonly RIGOR=${1:-build/release/rigor}
readonly RIG=configs/rigs/sensor-effects.yaml
readonly OUT=docs/images
rm -f "$OUT"/sensor-*.png

# shot NAME CHANNEL [OPTION...]
shot() {
  local name=$1 channel=$2
  shift 2
  "$RIGOR" sense "$RIG" --channel "$channel" --at 0.5 -o "$OUT/sensor-$name.png" "$@"
}

for channel in camera tof lidar scanner; do
  shot "$channel-none" "$channel" --only none
  shot "$channel-all" "$channel"
done
for effect in lens chromatic depth_of_field vignetting motion_blur rolling_shutter bloom glare shot_noise read_noise \
  dark_current dsnu prnu hot_pixels processing; do
  shot "camera-$effect" camera --only "$effect"
done
for effect in lens limits saturation; do
  shot "tof-$effect" tof --only "$effect"
done
for effect in wiggling_bias trembling fixed_pattern flying_pixels motion multipath quantisation; do
  shot "tof-$effect" tof --only "$effect" --difference
done
shot tof-sine_like_noise tof --only trembling,sine_like_noise --difference
shot tof-ambient tof --only trembling,ambient --difference
shot tof-filters tof --only trembling,filters --difference
for effect in footprint detection range_noise beam_bias remission_noise remission_scale quantisation; do
  shot "lidar-$effect" lidar --only "$effect"
done
shot lidar-crosstalk lidar --only remission_scale,crosstalk
