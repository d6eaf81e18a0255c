#!/usr/bin/env bash
# make_world_pictures.sh [RIGOR] [PICTURE…]: makes the pictures of docs/images that show worlds, all or those that are named.
# The stand AV06 needs the SRTM tile n40_w105 and the tree list of the plots (RIGOR_SRTM, RIGOR_STANDS: their paths); without
# them its picture is left as it is.
set -euo pipefail
cd "$(dirname "$0")/.."
rigor=${1:-build/release/rigor}
shift || true
wanted=" ${*:-all} "
out=docs/images
forest=configs/worlds/forest.import.yaml
hills=configs/worlds/hills.import.yaml
within=("--eye=-8,-84,1.7" "--target=6,0,9" --above-ground --width 960 --height 540)
noon=(--time 2024-06-21T11:00:00Z)

picture() {
  local name=$1
  shift
  [[ $wanted == *" all "* || $wanted == *" $name "* ]] || return 0
  "$rigor" world render "$@" -o "$out/world-$name.png"
}

picture forest-noon "$forest" "${within[@]}" "${noon[@]}"
picture forest-plain "$forest" "${within[@]}" "${noon[@]}" --plain
picture forest-dusk "$forest" "${within[@]}" --time 2024-06-21T19:25:00Z --brighter=-2
picture forest-fog "$forest" "${within[@]}" "${noon[@]}" --set Atmosphere.fog_visibility_m=150 --brighter 0.7
picture forest-rain "$forest" "${within[@]}" "${noon[@]}" --set Atmosphere.rain_mm_per_h=25 --set Atmosphere.cloud_cover=1 \
  --set Atmosphere.wetness=1 --set Atmosphere.wind_speed_m_per_s=5
picture forest-snow "$forest" "${within[@]}" --time 2024-01-21T11:00:00Z --set Atmosphere.snow_mm_per_h=2 \
  --set Atmosphere.cloud_cover=0.9 --set Atmosphere.snow_depth_m=0.3
picture forest-nir "$forest" "${within[@]}" "${noon[@]}" --bands false-colour
above=("--eye=-130,-210,38" "--target=0,0,8" --above-ground --width 960 --height 540)
picture hills "$hills" "${above[@]}" --time 2024-06-21T08:00:00Z
picture hills-plain "$hills" "${above[@]}" --time 2024-06-21T08:00:00Z --plain
if [[ -f ${RIGOR_SRTM:-} && -f ${RIGOR_STANDS:-} ]] && [[ $wanted == *" all "* || $wanted == *" av06 "* ]]; then
  world=$(mktemp -d)/av06.rigor
  "$rigor" world import configs/worlds/real-stand.import.yaml -o "$world" \
    --set "sources.0.elevation=$RIGOR_SRTM" --set "sources.1.trees=$RIGOR_STANDS" --set half_extent_m=4500 --set spacing_m=15
  picture av06 "$world" "--eye=-70,-120,12" "--target=15,20,22" --above-ground --width 960 --height 540 \
    --time 2024-06-21T16:00:00Z --set Atmosphere.visibility_m=40000 --set Atmosphere.cloud_cover=0.3
  rm -rf "$(dirname "$world")"
fi
