#!/usr/bin/env bash
# tools/guest.sh says what goes wrong: one boot with few modules, and what needs none.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

failed=0
expect() { # WHAT FOUND EXPECTED-PATTERN
  # shellcheck disable=SC2053
  if [[ $2 != $3 ]]; then
    echo "guest self-test: $1: expected $3, got: $2" >&2
    failed=1
  fi
}

run() { # ARGS...: sets output and status
  status=0
  output=$("$@" 2>&1) || status=$?
}

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

run tools/guest.sh
expect "no command: status" "$status" 125

# A machine with everything but QEMU.
for program in /usr/bin/* /usr/sbin/* /bin/* /sbin/*; do
  [[ $(basename "$program") == qemu-system-* ]] || ln -sf "$program" "$folder/$(basename "$program")"
done
run env PATH="$folder" tools/guest.sh true
expect "no QEMU: status" "$status" 125
expect "no QEMU: message" "$output" '*qemu-system-x86_64 is missing*apt-get install*qemu-system-x86*'

run tools/guest.sh --boot-timeout 1 true
expect "guest that is not up in time: status" "$status" 125
expect "guest that is not up in time: message" "$output" '*did not come up within 1 s*'

printf 'vcan\nno_such_module\n' >"$folder/modules"
# shellcheck disable=SC2016
RIGOR_SELF_TEST='it is "seen"' run tools/guest.sh --modules "$folder/modules" --bind "$folder" --timeout 60 bash -c '
  echo "to stdout $RIGOR_GUEST $RIGOR_SELF_TEST"; echo "to stderr" >&2
  ip link add rigor0 type vcan && echo "vcan is there"
  cat "$1/modules" >"$RIGOR_OUT/copy"
  touch /rigor-must-not-be-written 2>/dev/null && echo "the root can be written"
  exit 7' bash "$folder"
expect "the command's status" "$status" 7
expect "a module that is missing" "$output" '*modules that do not load: no_such_module*'
expect "stdout and the environment" "$output" '*to stdout 1 it is "seen"*'
expect "stderr" "$output" '*to stderr*'
expect "a device" "$output" '*vcan is there*'
[[ $output != *"can be written"* ]] || expect "the root" "$output" "read-only"
expect "what it wrote" "$(cat build/guest/out/copy)" "$(cat "$folder/modules")"

[[ $failed -eq 0 ]] && echo "guest self-test: passed"
exit "$failed"
