# shellcheck shell=bash
# The kernel lane: tests labelled `kernel` on a real kernel's devices. Where the running kernel has them, here; elsewhere
# in one boot of the guest (tools/guest.sh). docs/kernel-lane.md is about both.

# By guest time; with the boot and what is around it the lane stays below 8 minutes.
readonly GUEST_SECONDS=360
# What a kernel does is its own affair: tests that fail are run again, in the same boot, as tools/run_tests.py does.
readonly ATTEMPTS=3 MOST_AGAIN=3
# What the tests need of the running kernel, so that they can run on it.
readonly KERNEL_MODULES=(can_raw can_bcm can_isotp vcan vxcan vivid v4l2loopback uvcvideo dummy_hcd cdc_acm libcomposite
  usb_f_acm usb_f_uvc usb_f_fs vhci_hcd)

# What keeps the tests from running on the running kernel; nothing when they can.
missing_here() {
  [[ $(id -u) -eq 0 ]] || echo root
  local module
  for module in "${KERNEL_MODULES[@]}"; do
    # What is built in has a folder only when it has parameters.
    [[ -d /sys/module/$module ]] ||
      grep -qs "/${module//_/[_-]}\.ko$" "/lib/modules/$(uname -r)/modules.builtin" || echo "$module"
  done
}

run_kernel_tests() { # FOLDER RESULT-FILE COMMAND...: the tests of FOLDER, by ctest behind COMMAND
  local folder=$1 result=$2
  shift 2
  "$@" ctest --test-dir "$folder" --output-on-failure --no-tests=error --repeat "until-pass:$ATTEMPTS" \
    --output-junit "$result"
}

# failed_once LOG: the tests that failed at least once, and how often, by what ctest printed.
failed_once() {
  sed -nE 's/^.*Test +#[0-9]+: ([^ ]+) .*\*\*\*(Failed|Timeout|Exception).*/\1/p' "$1" | sort | uniq -c |
    sed -E 's/^ *([0-9]+) (.*)/\2: failed \1 times/'
}

# Where the lane's tests are.
readonly KERNEL_BUILD=${RIGOR_KERNEL_BUILD:-build/release}

# Builds the lane's tests alone; those of RIGOR_KERNEL_BUILD are taken as they are.
build_kernel_tests() {
  if [[ -n ${RIGOR_KERNEL_BUILD:-} ]]; then
    [[ -f $KERNEL_BUILD/build.ninja ]] || die "RIGOR_KERNEL_BUILD: expected a build folder, got '$KERNEL_BUILD'"
    return
  fi
  configure_preset release
  local -a targets
  mapfile -t targets < <(ninja -C "$KERNEL_BUILD" -t targets all |
    sed -nE 's#^(([^ ]*/)?test_kernel_[a-z0-9_]+): CXX_EXECUTABLE_LINKER.*#\1#p')
  [[ ${#targets[@]} -gt 0 ]] || die "$KERNEL_BUILD has no test test_kernel_*"
  build_preset release "${targets[@]}"
}

lane_kernel() {
  local out=build/guest/out missing status=0 tests
  missing=$(missing_here | paste -sd, | sed 's/,/, /g')
  if [[ -z $missing ]]; then
    say "the running kernel has the devices: the tests run on it, without QEMU"
    out=build/test-results/kernel
  else
    say "the tests run on Debian's kernel in QEMU, for here is no $missing"
    tools/guest/self_test.sh
  fi
  rm -rf "$out/tests" "$out/kernel.xml"
  tests=$(python3 tools/kernel_tests.py "$KERNEL_BUILD" "$out/tests")
  say "$tests tests"
  if [[ -z $missing ]]; then
    run_kernel_tests "$PWD/$out/tests" "$PWD/$out/kernel.xml" env 2>&1 | tee "$RESULTS/kernel.log" || status=$?
  else
    run_kernel_tests /tmp/rigor-out/tests /tmp/rigor-out/kernel.xml \
      tools/guest.sh --timeout "$GUEST_SECONDS" --out "$out" -- 2>&1 | tee "$RESULTS/kernel.log" || status=$?
    case $status in
      124) warn "the tests did not end within $GUEST_SECONDS s of the guest" ;;
      125) warn "there was no guest: see above" ;;
    esac
  fi
  failed_once "$RESULTS/kernel.log" >"$RESULTS/kernel.again"
  if [[ -s $RESULTS/kernel.again ]]; then
    say "failed at least once:"
    cat "$RESULTS/kernel.again"
  fi
  if [[ $(wc -l <"$RESULTS/kernel.again") -gt $MOST_AGAIN ]]; then
    warn "more than $MOST_AGAIN tests failed at least once: that is no accident, and fails the lane"
    status=1
  fi
  [[ -s $out/kernel.xml ]] || die "the tests left no results (status $status)"
  cp "$out/kernel.xml" "$RESULTS/kernel.xml"
  python3 tools/check_skips.py --count "$RESULTS/kernel.xml" >"$RESULTS/kernel.count"
  say "what the tests counted"
  python3 tools/check_skips.py --notes "$RESULTS/kernel.xml"
  python3 tools/check_skips.py "$RESULTS/kernel.xml" || status=1
  if [[ -n $missing ]] && grep -q 'this kernel has no' "$RESULTS/kernel.xml"; then
    warn "a test was skipped for want of a device that the guest must have"
    status=1
  fi
  return "$status"
}
