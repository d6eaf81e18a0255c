# shellcheck shell=bash
# What ./dev and its lanes share: messages, builds, the list of sources.

say() { printf '\033[1m==>\033[0m %s\n' "$*" | if [[ -t 1 ]]; then cat; else sed 's/\x1b\[[0-9;]*m//g'; fi; }
warn() { printf 'dev: %s\n' "$*" >&2; }
die() {
  warn "$1"
  exit "${2:-1}"
}

# need_program PROGRAM PART: installs the part of packages/ that has it where it is missing.
need_program() {
  command -v "$1" >/dev/null || install_packages "$2"
}

minutes() { awk -v s="$1" 'BEGIN { printf "%.1f min", s / 60 }'; }

# How many compilers at once: one a core, and 1.5 GB of memory for each.
build_jobs() {
  local by_memory
  by_memory=$(awk '/^MemAvailable/ { n = int($2 / 1572864); print (n < 1 ? 1 : n) }' /proc/meminfo)
  local jobs=${RIGOR_JOBS:-$(nproc)}
  echo $((jobs < by_memory ? jobs : by_memory))
}

# What building took.
BUILD_SECONDS=0

# configure_preset PRESET: once; afterwards ninja itself sees to changes of the CMake files. With WITHOUT_TESTS=yes a new
# build folder leaves the tests out, and needs no GoogleTest; otherwise a folder without tests is configured again.
configure_preset() {
  local preset=$1 dir=build/$1 started=$SECONDS tests=ON log
  if [[ ${WITHOUT_TESTS:-no} == yes ]] && ! grep -qs '^RIGOR_TESTS:BOOL=ON' "$dir/CMakeCache.txt"; then
    tests=OFF
  fi
  if [[ -f $dir/build.ninja && ! CMakePresets.json -nt $dir/build.ninja ]] &&
    { [[ $tests == OFF ]] || ! grep -qs '^RIGOR_TESTS:BOOL=OFF' "$dir/CMakeCache.txt"; }; then
    return
  fi
  say "configuring $dir"
  log=$(log_file configure "$preset")
  cmake --preset "$preset" "-DRIGOR_TESTS=$tests" >"$log" 2>&1 ||
    { tail -n 40 "$log" >&2 && die "configuring $dir failed. Log: $log"; }
  BUILD_SECONDS=$((BUILD_SECONDS + SECONDS - started))
}

# What ccache was asked for, and what of that it had; nothing where it is not installed.
ccache_counts() {
  ! command -v ccache >/dev/null ||
    ccache --print-stats 2>/dev/null | awk '/^(direct|preprocessed)_cache_hit/ { h += $2 } /^cache_miss/ { m += $2 } END { print h + m, h + 0 }'
}

# build_preset PRESET [TARGET...]
build_preset() {
  local preset=$1 started log asked_before=0 had_before=0 asked had
  shift
  configure_preset "$preset"
  started=$SECONDS log=$(log_file build "$preset")
  say "building build/$preset${*:+: $*}"
  local -a targets=()
  [[ $# -eq 0 ]] || targets=(--target "$@")
  : >"$log"
  read -r asked_before had_before < <(ccache_counts) || true
  NINJA_STATUS='[%f/%t %e] ' cmake --build "build/$preset" --parallel "$(build_jobs)" "${targets[@]}" 2>&1 |
    ninja_progress "$log" building || die "building build/$preset failed. Log: $log"
  BUILD_SECONDS=$((BUILD_SECONDS + SECONDS - started))
  read -r asked had < <(ccache_counts) || return 0
  [[ $asked -eq $asked_before ]] || say "of $((asked - asked_before)) files, ccache had $((had - had_before))"
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
  for folder in rt-core sensor-hal sim drivers calibration bench cli apps benches tests; do
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
