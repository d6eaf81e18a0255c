# shellcheck shell=bash
# What ./dev and its lanes share: messages, builds, the list of sources.

say() { printf '\033[1m==>\033[0m %s\n' "$*" | if [[ -t 1 ]]; then cat; else sed 's/\x1b\[[0-9;]*m//g'; fi; }
warn() { printf 'dev: %s\n' "$*" >&2; }
die() {
  warn "$1"
  exit "${2:-1}"
}

need_program() {
  command -v "$1" >/dev/null || install_packages
}

# How many compilers at once: one a core, and 1.5 GB of memory for each.
build_jobs() {
  local by_memory
  by_memory=$(awk '/^MemAvailable/ { n = int($2 / 1572864); print (n < 1 ? 1 : n) }' /proc/meminfo)
  local jobs=${RIGOR_JOBS:-$(nproc)}
  echo $((jobs < by_memory ? jobs : by_memory))
}

# configure_preset PRESET: once; afterwards ninja itself sees to changes of the CMake files.
configure_preset() {
  local preset=$1 dir=build/$1
  if [[ -f $dir/build.ninja && ! CMakePresets.json -nt $dir/build.ninja ]]; then
    return
  fi
  say "configuring $dir"
  cmake --preset "$preset" >"$(log_file configure "$preset")" 2>&1 ||
    { tail -n 40 "$(log_file configure "$preset")" >&2 && die "configuring $dir failed"; }
}

# build_preset PRESET [TARGET...]
build_preset() {
  local preset=$1
  shift
  configure_preset "$preset"
  say "building build/$preset${*:+: $*}"
  local -a targets=()
  [[ $# -eq 0 ]] || targets=(--target "$@")
  cmake --build "build/$preset" --parallel "$(build_jobs)" "${targets[@]}"
}

# log_file KIND NAME: where a step's output goes.
log_file() {
  mkdir -p build/logs
  echo "build/logs/$1-$2.log"
}

# Every C++ source of the project, NUL-separated. Files *.glsl.h are shaders first: their tables are kept as drawn.
list_sources() {
  local -a folders=()
  local folder
  for folder in rt-core sensor-hal sim drivers calibration cli apps benches tests; do
    [[ ! -d $folder ]] || folders+=("$folder")
  done
  find "${folders[@]}" -name node_modules -prune -o -type f \
    \( -name '*.h' -o -name '*.cpp' \) -not -name '*.glsl.h' -print0 | sort -z
}

format_sources() {
  case ${1:-} in
    --check)
      local wrong
      clang-format-14 --version >/dev/null
      wrong=$({ list_sources | xargs -0 -r -n 20 -P "$(nproc)" clang-format-14 --dry-run --Werror 2>&1 || true; } |
        sed -nE 's/^([^:]+):([0-9]+):[0-9]+: error: .*/\1/p' | sort | uniq -c)
      [[ -z $wrong ]] || die "places that ./dev format would change, by file:"$'\n'"$wrong"
      ;;
    '') list_sources | xargs -0 -r -n 20 -P "$(nproc)" clang-format-14 -i ;;
    *) die "format: expected --check or nothing, got '$1'" 2 ;;
  esac
}
