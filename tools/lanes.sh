# shellcheck shell=bash
# The lanes of ./dev test. Each runs whatever the others did; the summary says which failed, and the last line counts
# what passed, failed and was skipped over all of them. A lane writes `passed failed skipped` to its count file.

# shellcheck source=tools/kernel_lane.sh
source tools/kernel_lane.sh

readonly RESULTS=build/test-results
readonly LANES=(format includes release kernel asan-ubsan tsan fuzz docs skips)
readonly FAST_LANES=(format includes release)
readonly FUZZ_SECONDS=10
# Tests talk to the wall clock, to sockets and to child processes, and a host may hold a virtual machine up for seconds:
# what fails is tried again, and the lane names it.
readonly ATTEMPTS=3

lane_about() {
  case $1 in
    format) echo "sources are as clang-format-14 writes them; scripts pass shellcheck" ;;
    includes) echo "includes run along the arrows of the house; the check finds planted violations" ;;
    release) echo "release build and every test that needs no kernel device" ;;
    kernel) echo "CAN, V4L2 and USB drivers on a real kernel's devices (a guest in QEMU where the running one has none)" ;;
    asan-ubsan) echo "core and decoders under the address and undefined-behaviour sanitizers" ;;
    tsan) echo "core and decoders under the thread sanitizer" ;;
    fuzz) echo "every libFuzzer harness for $FUZZ_SECONDS s on its corpus" ;;
    docs) echo "commands, files and links that the documents name exist" ;;
    skips) echo "no test is skipped that tests/skipped.txt does not allow" ;;
    *) return 1 ;;
  esac
}

count() { echo "$2 $3 $4" >"$RESULTS/$1.count"; }

# check_lane NAME COMMAND...: a lane that is one check.
check_lane() {
  local lane=$1
  shift
  count "$lane" 0 1 0
  "$@"
  count "$lane" 1 0 0
}

# Tests that lie in an address-space layout which the sanitizers' runtimes know: with vm.mmap_rnd_bits above 28 those
# of g++ 12 abort at random.
without_address_randomisation() {
  if setarch -R true 2>/dev/null; then
    setarch -R "$@"
  else
    "$@"
  fi
}

# failed_once LOG: how often each test failed that did, by what ctest printed.
failed_once() {
  sed -nE 's/^.*Test +#[0-9]+: ([^ ]+) .*\*\*\*(Failed|Timeout|Exception).*/\1/p' "$1" | sort | uniq -c
}

# ctest_lane LANE PRESET [CTEST-OPTION...]
ctest_lane() {
  local lane=$1 preset=$2 status=0
  shift 2
  count "$lane" 0 1 0
  build_preset "$preset"
  local -a runner=()
  [[ $preset == release ]] || runner=(without_address_randomisation)
  "${runner[@]}" ctest --test-dir "build/$preset" --parallel 2 --output-on-failure --no-tests=error \
    --repeat "until-pass:$ATTEMPTS" --output-junit "$PWD/$RESULTS/$lane.xml" "$@" |
    tee "$RESULTS/$lane.log" |
    grep -vE '^ +(Start +[0-9]+|Test +#[0-9]+): |^ *[0-9]+/[0-9]+ .* Passed ' || status=$?
  local again
  again=$(failed_once "$RESULTS/$lane.log")
  [[ -z $again ]] || say "failed at least once (times, test):"$'\n'"$again"
  python3 tools/check_skips.py --count "$RESULTS/$lane.xml" >"$RESULTS/$lane.count"
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
}

# Tests labelled `kernel` are the kernel lane's.
lane_release() { ctest_lane release release --label-exclude '^kernel$'; }

# Timing limits mean nothing where every access is instrumented: tests labelled `timing` run in the release lane alone.
lane_asan-ubsan() {
  export ASAN_OPTIONS=detect_stack_use_after_return=1:strict_string_checks=1
  export LSAN_OPTIONS=suppressions=$PWD/tests/lsan.supp:print_suppressions=0
  export UBSAN_OPTIONS=print_stacktrace=1
  ctest_lane asan-ubsan asan-ubsan --label-exclude '^(timing|kernel)$'
}

lane_tsan() {
  export TSAN_OPTIONS=suppressions=$PWD/tests/tsan.supp:second_deadlock_stack=1
  # Tests labelled `one-thread` are long and have nothing for this sanitizer to see.
  ctest_lane tsan tsan --label-exclude '^(timing|kernel|one-thread)$'
}

lane_fuzz() {
  count fuzz 0 1 0
  configure_preset fuzz
  local -a harnesses
  mapfile -t harnesses < <(ninja -C build/fuzz -t targets all |
    sed -nE 's#^(([^ ]*/)?fuzz_[a-z0-9_]+): CXX_EXECUTABLE_LINKER.*#\1#p')
  [[ ${#harnesses[@]} -gt 0 ]] || die "build/fuzz has no harness fuzz_*"
  build_preset fuzz "${harnesses[@]}"
  local status=0 harness
  rm -f "$RESULTS"/fuzz-*.ok
  printf '%s\0' "${harnesses[@]}" | xargs -0 -n 1 -P 2 bash tools/fuzz_one.sh "$FUZZ_SECONDS" "$RESULTS" || status=1
  local passed=0
  for harness in "${harnesses[@]}"; do
    [[ ! -f $RESULTS/fuzz-$(basename "$harness").ok ]] || passed=$((passed + 1))
  done
  count fuzz "$passed" $((${#harnesses[@]} - passed)) 0
  return "$status"
}

lane_docs() {
  check_lane docs check_docs
}
check_docs() {
  build_preset release rigor
  python3 tools/check_docs.py
}

lane_skips() {
  local -a results
  mapfile -t results < <(find "$RESULTS" -name '*.xml' | sort)
  [[ ${#results[@]} -gt 0 ]] || die "no lane with tests ran before this one: ./dev test --lane release --lane skips"
  check_lane skips python3 tools/check_skips.py "${results[@]}"
}

# The kernel lane waits for one emulated core: what the next lane needs is built beside it, on what is left.
build_beside() {
  local preset=$1
  (
    renice -n 19 "$BASHPID" >/dev/null
    build_preset "$preset"
  ) >"$RESULTS/build-$preset.log" 2>&1 &
  BUILDING_BESIDE=$!
}

minutes() { awk -v s="$1" 'BEGIN { printf "%.1f min", s / 60 }'; }

# run_lane NAME: in a subshell, so that a lane may stop at its first error and set its own environment.
run_lane() {
  local lane=$1 started=$SECONDS status=0
  say "lane $lane: $(lane_about "$lane")"
  set +e
  (
    set -e
    "lane_$lane"
  )
  status=$?
  set -e
  local took=$((SECONDS - started))
  echo "$lane $status $took" >>"$RESULTS/lanes"
  say "lane $lane: $([[ $status -eq 0 ]] && echo passed || echo FAILED) in $(minutes $took)"
}

summarise() {
  local lane status took failed=0 passed=0 bad=0 skipped=0 p f s
  echo
  while read -r lane status took; do
    read -r p f s <"$RESULTS/$lane.count"
    # A lane that broke after its tests had passed (or before any ran) counts as one failure.
    [[ $status -eq 0 || $f -gt 0 ]] || f=1
    printf '  %-11s %-7s %9s  %5d passed %4d failed %4d skipped\n' "$lane" \
      "$([[ $status -eq 0 ]] && echo passed || echo FAILED)" "$(minutes "$took")" "$p" "$f" "$s"
    [[ $status -eq 0 ]] || failed=1
    passed=$((passed + p)) bad=$((bad + f)) skipped=$((skipped + s))
  done <"$RESULTS/lanes"
  printf '  %-11s %-7s %9s\n\n' total "" "$(minutes "$1")"
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
  trap 'echo; warn "interrupted"; [[ -z ${BUILDING_BESIDE:-} ]] || kill "$BUILDING_BESIDE" 2>/dev/null; exit 130' INT TERM
  install_packages
  install_npm_packages
  for lane in "${chosen[@]}"; do
    count "$lane" 0 0 0
    if [[ $lane == kernel && " ${chosen[*]} " == *" kernel asan-ubsan "* ]]; then build_beside asan-ubsan; fi
    # The lane builds again and shows what failed.
    if [[ $lane == asan-ubsan && -n ${BUILDING_BESIDE:-} ]]; then wait "$BUILDING_BESIDE" || true; fi
    run_lane "$lane"
  done
  summarise $((SECONDS - started))
}
