#!/usr/bin/env bash
# make_manual.sh RIGOR FOLDER: writes the manual pages of the command and of all its subcommands into FOLDER (rigor.1, rigor-run.1,
# rigor-calibrate-camera.1, …), from what --help says. Needs help2man. The date of the pages is that of the release.
set -euo pipefail

[[ $# -eq 2 && -x $1 ]] || { echo "usage: make_manual.sh RIGOR FOLDER" >&2 && exit 2; }
rigor=$1 folder=$2
changelog=$(dirname "${BASH_SOURCE[0]}")/../CHANGELOG.md
version=$("$rigor" --version | sed -n '1s/^rigor //p')
SOURCE_DATE_EPOCH=$(date --utc -d "$(sed -nE 's/^## [0-9.]+ \(([0-9-]+)\)$/\1/p' "$changelog" | head -n 1)" +%s)
export SOURCE_DATE_EPOCH LC_ALL=C.UTF-8
rm -rf "$folder"
mkdir -p "$folder"

# page ABOUT [COMMAND...]: its page, and those of the commands below it.
page() {
  local about=$1 name help command text
  shift
  name=$(IFS=-; echo "rigor${*:+-$*}")
  help2man --no-info --locale=C.UTF-8 --version-string="$version" --name="${about%.}" "$rigor${*:+ $*}" |
    sed -E "s/^(\.TH) RIGOR /\1 ${name^^} /; s/^rigor${*:+ $*} (\\\\-)/$name \1/; s/\"rigor${*:+ $*} $version\"/\"rigor $version\"/" \
      >"$folder/$name.1"
  help=$("$rigor" "$@" --help)
  [[ $help == *Subcommands:* ]] || return 0
  while read -r command text; do
    page "$text" "$@" "$command"
  done < <(sed -n '/^Subcommands:/,/^$/s/^  \([a-z]\)/\1/p' <<<"$help")
}
page "hardware-in-the-loop test bench of real and simulated sensors"
