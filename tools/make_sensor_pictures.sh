#!/usr/bin/env bash
# The pictures of docs/sensors.md: every sensor without effects, with each of them alone, and with all.
#
# usage: [PICTURES=PATTERN] tools/make_sensor_pictures.sh [RIGOR]     default build/release/rigor; PICTURES=lidar-* takes
#        those alone
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

readonly RIGOR=${1:-build/release/rigor}
readonly RIG=configs/rigs/sensor-effects.yaml
readonly OUT=docs/images
[[ -n ${PICTURES:-} ]] || rm -f "$OUT"/sensor-*.png

# shot NAME CHANNEL [OPTION...]
shot() {
  local name=$1 channel=$2
  shift 2
  # shellcheck disable=SC2053  # a pattern is meant
  [[ $name == ${PICTURES:-*} ]] || return 0
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
shot lidar-beam_gain lidar --only beam_gain
shot lidar-echoes lidar --only footprint,echoes
shot lidar-fog lidar --only detection,air --set simulation.weather.fog_visibility_m=25
shot lidar-rain lidar --only air --set simulation.weather.rain_mmph=50
# The testbed has no sun: the turntable has one, low in the south-west.
readonly -a SUNNY=(--set simulation.world=../worlds/turntable.yaml --set "channels.lidar.T_world_sensor.position_m=[0.9,2.6,0.9]")
shot lidar-shade lidar --only detection,range_noise "${SUNNY[@]}"
shot lidar-sun lidar --only detection,range_noise,sun "${SUNNY[@]}"
