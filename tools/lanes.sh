# shellcheck shell=bash
# The lanes of ./dev test. Each runs whatever the others did; the summary says which failed, and the last line counts
# what passed, failed and was skipped over all of them. A lane writes `passed failed skipped` to its count file.

# shellcheck source=tools/kernel_lane.sh
source tools/kernel_lane.sh

readonly RESULTS=build/test-results
readonly LANES=(format includes release kernel asan-ubsan tsan fuzz docs skips)
readonly FAST_LANES=(format includes release)
readonly BUILDING_LANES="release kernel asan-ubsan tsan fuzz docs"
readonly FUZZ_SECONDS=10
# CI prints a warning when all lanes together take longer.
readonly WHOLE_MINUTES=40

lane_about() {
  case $1 in
    format) echo "sources are as clang-format-14 writes them; scripts pass shellcheck" ;;
    includes) echo "includes run along the arrows of the house; this check and tools/run_tests.py find what is planted" ;;
    release) echo "release build and every test that needs no kernel device" ;;
    kernel) echo "CAN, V4L2 and USB drivers on a real kernel's devices (a guest in QEMU where the running one has none)" ;;
    asan-ubsan) echo "core and decoders under the address and undefined-behaviour sanitizers" ;;
    tsan) echo "core and decoders under the thread sanitizer" ;;
    fuzz) echo "every libFuzzer harness for $FUZZ_SECONDS s on its corpus" ;;
    docs) echo "commands that the documents give run, or a reason is named; files and links exist" ;;
    skips) echo "no test is skipped that tests/skipped.txt does not allow" ;;
    *) return 1 ;;
  esac
}

# The parts of packages/ that a lane needs.
lane_parts() {
  case $1 in
    format | includes | skips) echo check ;;
    release) echo run test live python ;;
    kernel) echo run test kernel ;;
    asan-ubsan | tsan | fuzz) echo run test clang ;;
    docs) echo run test check ;;
  esac
}

count() { echo "$2 $3 $4" >"$RESULTS/$1.count"; }

# check_lane NAME COMMAND...: a lane that is one check. The last lines of what a failed one printed go into the summary.
check_lane() {
  local lane=$1 status
  shift
  count "$lane" 0 1 0
  rm -f "$RESULTS/$lane.failed"
  set +e
  (
    set -e
    "$@"
  ) 2>&1 | tee "$RESULTS/$lane.log"
  status=${PIPESTATUS[0]}
  set -e
  [[ $status -eq 0 ]] || {
    tail -n 8 "$RESULTS/$lane.log" >"$RESULTS/$lane.failed"
    return "$status"
  }
  count "$lane" 1 0 0
}

# Tests that lie in an address-space layout which the sanitizers' runtimes know: with vm.mmap_rnd_bits above 28 those
# of clang 16 abort at random.
without_address_randomisation() {
  if setarch -R true 2>/dev/null; then
    setarch -R "$@"
  else
    "$@"
  fi
}

# build_lane LANE: builds what a lane needs; nothing for those that need nothing.
build_lane() {
  local -a harnesses
  case $1 in
    release | asan-ubsan | tsan) build_preset "$1" ;;
    kernel) build_kernel_tests ;;
    fuzz)
      configure_preset asan-ubsan
      mapfile -t harnesses < <(list_harnesses)
      [[ ${#harnesses[@]} -gt 0 ]] || die "build/asan-ubsan has no harness fuzz_*"
      build_preset asan-ubsan "${harnesses[@]}"
      ;;
    docs) build_preset release rigor ;;
  esac
}

list_harnesses() {
  ninja -C build/asan-ubsan -t targets all | sed -nE 's#^(([^ ]*/)?fuzz_[a-z0-9_]+): CXX_EXECUTABLE_LINKER.*#\1#p'
}

# ctest_lane LANE PRESET [CTEST-OPTION...]: a failed test fails; tools/run_tests.py says which are run again.
ctest_lane() {
  local lane=$1 preset=$2 status=0
  shift 2
  local -a runner=()
  [[ $preset == release ]] || runner=(without_address_randomisation)
  "${runner[@]}" python3 tools/run_tests.py "build/$preset" "$RESULTS" "$lane" "$@" || status=$?
  [[ ! -s $RESULTS/$lane.xml ]] || python3 tools/check_skips.py --count "$RESULTS/$lane.xml" >"$RESULTS/$lane.count"
  return "$status"
}

lane_format() { check_lane format check_format; }
check_format() {
  format_sources --check
  shellcheck -x dev .ci/run tools/*.sh tools/guest/*.sh
}

lane_includes() { check_lane includes check_includes; }
check_includes() {
  python3 tools/check_includes.py --self-test
  python3 tools/check_includes.py
  python3 tools/run_tests.py --self-test
  /usr/bin/python3 benches/light_error.py --self-test
  /usr/bin/python3 benches/range_error.py --self-test
  python3 tools/check_packages.py --self-test
}

# Tests labelled `kernel` are the kernel lane's.
lane_release() { ctest_lane release release --label-exclude '^kernel$'; }

# The sanitizers' runtimes find llvm-symbolizer on the path; without it, they name no file and line, and no suppression by
# the name of a function holds.
with_symbolizer() { export PATH=/usr/lib/llvm-16/bin:$PATH; }

lane_asan-ubsan() {
  with_symbolizer
  export ASAN_OPTIONS=detect_stack_use_after_return=1:strict_string_checks=1
  export LSAN_OPTIONS=suppressions=$PWD/tests/lsan.supp:print_suppressions=0
  export UBSAN_OPTIONS=print_stacktrace=1
  ctest_lane asan-ubsan asan-ubsan --label-exclude '^kernel$'
}

lane_tsan() {
  with_symbolizer
  export TSAN_OPTIONS=suppressions=$PWD/tests/tsan.supp:second_deadlock_stack=1
  ctest_lane tsan tsan --label-exclude '^kernel$'
}

lane_fuzz() {
  with_symbolizer
  local -a harnesses
  mapfile -t harnesses < <(list_harnesses)
  local status=0 harness
  rm -f "$RESULTS"/fuzz-*.ok "$RESULTS/fuzz.failed"
  printf '%s\0' "${harnesses[@]}" | xargs -0 -n 1 -P 2 bash tools/fuzz_one.sh "$FUZZ_SECONDS" "$RESULTS" || status=1
  local passed=0
  for harness in "${harnesses[@]}"; do
    [[ ! -f $RESULTS/fuzz-$(basename "$harness").ok ]] || passed=$((passed + 1))
  done
  count fuzz "$passed" $((${#harnesses[@]} - passed)) 0
  return "$status"
}

lane_docs() { check_lane docs python3 tools/check_docs.py --run --again "$RESULTS/docs.again"; }

lane_skips() {
  local -a results
  mapfile -t results < <(find "$RESULTS" -name '*.xml' | sort)
  [[ ${#results[@]} -gt 0 ]] || die "no lane with tests ran before this one: ./dev test --lane release --lane skips"
  check_lane skips python3 tools/check_skips.py "${results[@]}"
}

# Tests wait for clocks and sockets, and the kernel lane for one emulated core: what later lanes need is built beside them, on
# what is left. BESIDE holds the presets that are built so; each leaves RESULTS/PRESET.beside, its seconds, when it ends.
BESIDE=()
build_beside() {
  BESIDE=("$@")
  (
    renice -n 19 "$BASHPID" >/dev/null
    for preset in "$@"; do
      BUILD_SECONDS=0
      build_preset "$preset" >"$RESULTS/build-$preset.log" 2>&1 || true
      echo "$BUILD_SECONDS" >"$RESULTS/$preset.beside"
    done
  ) &
  BUILDING_BESIDE=$!
}

# start_building_beside LANE...: what these need beyond the release build, unless that has been started.
start_building_beside() {
  local -a presets=()
  local preset
  for preset in asan-ubsan tsan; do
    [[ " $* " != *" $preset "* ]] || presets+=("$preset")
  done
  [[ ${#BESIDE[@]} -gt 0 || ${#presets[@]} -eq 0 ]] || build_beside "${presets[@]}"
}

# Waits until the lane's preset is built beside, where it is.
wait_for_build_beside() {
  [[ " ${BESIDE[*]} " == *" $1 "* ]] || return 0
  while [[ ! -f $RESULTS/$1.beside ]] && kill -0 "$BUILDING_BESIDE" 2>/dev/null; do
    sleep 0.5
  done
}

# run_lane NAME LANES...: each step in a subshell, so that it may stop at its first error and set its own environment.
run_lane() {
  local lane=$1 started=$SECONDS status=0
  shift
  say "lane $lane: $(lane_about "$lane")"
  count "$lane" 0 1 0
  wait_for_build_beside "$lane"
  set +e
  (
    set -e
    build_lane "$lane"
  )
  status=$?
  set -e
  local compile=$((SECONDS - started))
  if [[ $status -eq 0 ]]; then
    [[ $lane != release && $lane != kernel ]] || start_building_beside "$@"
    set +e
    (
      set -e
      "lane_$lane"
    )
    status=$?
    set -e
  fi
  local took=$((SECONDS - started)) parts=''
  [[ " $BUILDING_LANES " == *" $lane "* ]] || compile=-
  [[ $compile == - ]] || parts=": compile $(minutes "$compile"), test $(minutes $((took - compile)))"
  echo "$lane $status $took $compile" >>"$RESULTS/lanes"
  say "lane $lane: $([[ $status -eq 0 ]] && echo passed || echo FAILED) in $(minutes $took)$parts"
}

# A line of the summary: NAME STATE SECONDS COMPILE-SECONDS; the last is - where nothing was built.
summary_line() {
  local compile=- tests=-
  if [[ $4 != - ]]; then
    compile=$(minutes "$4") tests=$(minutes $(($3 - $4)))
  fi
  printf '  %-11s %-7s %9s %9s %9s' "$1" "$2" "$(minutes "$3")" "$compile" "$tests"
}

# summarise SECONDS
summarise() {
  local lane status took compile failed=0 passed=0 bad=0 skipped=0 p f s a
  printf '\n  %-11s %-7s %9s %9s %9s\n' lane '' whole compile test
  [[ $PACKAGE_SECONDS -eq 0 ]] || { summary_line packages '' "$PACKAGE_SECONDS" - && echo; }
  while read -r lane status took compile; do
    read -r p f s <"$RESULTS/$lane.count"
    # A lane that broke after its tests had passed (or before any ran) counts as one failure.
    [[ $status -eq 0 || $f -gt 0 ]] || f=1
    a=0
    [[ ! -f $RESULTS/$lane.again ]] || a=$(wc -l <"$RESULTS/$lane.again")
    summary_line "$lane" "$([[ $status -eq 0 ]] && echo passed || echo FAILED)" "$took" "$compile"
    printf '  %5d passed %4d failed %4d skipped %4d run again\n' "$p" "$f" "$s" "$a"
    [[ $status -eq 0 ]] || failed=1
    passed=$((passed + p)) bad=$((bad + f)) skipped=$((skipped + s))
  done <"$RESULTS/lanes"
  summary_line total '' "$1" -
  printf '\n\n'
  for lane in "${BESIDE[@]}"; do
    [[ ! -f $RESULTS/$lane.beside ]] || echo "  built beside other lanes: $lane, $(minutes "$(<"$RESULTS/$lane.beside")")"
  done
  # Which tests failed, and by what; nothing where none did.
  find "$RESULTS" -name '*.failed' -size +0 | sort | while read -r lane; do
    sed "s/^/  failed in $(basename "$lane" .failed): /" "$lane"
  done
  # Which tests were run again; nothing where none was.
  find "$RESULTS" -name '*.again' -size +0 | sort | while read -r lane; do
    sed "s/^/  run again in $(basename "$lane" .again): /" "$lane"
  done
  if [[ ${CI:-} == true && $1 -gt $((WHOLE_MINUTES * 60)) ]]; then
    warn "warning: the whole took $(minutes "$1"), more than $WHOLE_MINUTES min"
  fi
  echo "$passed passed, $bad failed, $skipped skipped"
  return "$failed"
}

dev_test() {
  local -a chosen=()
  local started=$SECONDS lane
  while [[ $# -gt 0 ]]; do
    case $1 in
      --lane)
        lane_about "${2:-}" >/dev/null || die "there is no lane '${2:-}'; ./dev test --list names them" 2
        chosen+=("$2")
        shift
        ;;
      --fast) chosen+=("${FAST_LANES[@]}") ;;
      --kernel) chosen+=(kernel) ;;
      --list)
        for lane in "${LANES[@]}"; do printf '%-11s %s\n' "$lane" "$(lane_about "$lane")"; done
        return
        ;;
      *) die "test: expected --lane NAME, --fast, --kernel or --list, got '$1'" 2 ;;
    esac
    shift
  done
  [[ ${#chosen[@]} -gt 0 ]] || chosen=("${LANES[@]}")
  rm -rf "$RESULTS"
  mkdir -p "$RESULTS"
  trap 'echo; warn "interrupted"; [[ ${#BESIDE[@]} -eq 0 ]] || pkill -TERM -P "$BUILDING_BESIDE"; exit 130' INT TERM
  local -a parts
  mapfile -t parts < <(for lane in "${chosen[@]}"; do lane_parts "$lane"; done | tr ' ' '\n' | sort -u)
  install_packages "${parts[@]}"
  [[ " ${parts[*]} " != *" test "* ]] || install_npm_packages
  for lane in "${chosen[@]}"; do
    run_lane "$lane" "${chosen[@]}"
  done
  summarise $((SECONDS - started))
}
