#!/usr/bin/env bash
# Runs a command as root on Debian's own kernel, in an emulated guest that shares this machine's files: for devices that
# the running kernel lacks (CAN, V4L2, USB). docs/kernel-lane.md says what the guest has.
set -euo pipefail

ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
readonly ROOT
export LC_ALL=C.UTF-8
# shellcheck source=tools/common.sh
source "$ROOT/tools/common.sh"
# shellcheck source=tools/deps.sh
source "$ROOT/tools/deps.sh"
# shellcheck source=tools/guest/prepare.sh
source "$ROOT/tools/guest/prepare.sh"

readonly LOCK=/var/tmp/rigor-guest.lock
# What QEMU could not start, or a guest that did not come up, ends with; the command's own status otherwise.
readonly NO_GUEST=125

usage() {
  cat <<'TEXT'
usage: tools/guest.sh [OPTION...] CMD [ARG...]
       tools/guest.sh --prepare | --fetch

  --timeout S        the command is ended after S seconds of the guest (default 480); status 124 then
  --boot-timeout S   how long the guest may take to come up (default 120)
  --bind DIR         a folder below /tmp or /run that the guest shall see too (it has its own /tmp and /run);
                     the checkout and the working directory are seen wherever they lie
  --out DIR          what the guest has as /tmp/rigor-out, writable ($RIGOR_OUT; default build/guest/out)
  --memory MIB       of the guest (default 1024)
  --modules FILE     loads what FILE lists instead of tools/guest/modules.txt
  --prepare          only fetch and build what the guest needs; nothing is installed
  --fetch            only fetch it

CMD runs as root in the caller's working directory, with RIGOR_GUEST=1; everything but /tmp, /run and /dev is read-only.
Its output comes as it is written, and its exit status is that of this script: 124 after --timeout,
125 when there was no guest. The kernel's messages: build/guest/kernel.log.
TEXT
}

no_guest() {
  warn "$1"
  exit "$NO_GUEST"
}

# The environment and the command, for the guest's bash to source.
write_job() {
  local job=$1 timeout=$2 modules=$3
  shift 3
  {
    printf 'export PATH=%q LC_ALL=C.UTF-8 HOME=/root TMPDIR=/tmp SYSTEMD_IGNORE_CHROOT=1 RIGOR_GUEST=1 RIGOR_OUT=/tmp/rigor-out\n' \
      "$PATH:/usr/sbin:/sbin:$GUEST_TREE/udev/bin"
    printf 'export MODPROBE_OPTIONS=%q\n' "-d $GUEST_TREE"
    local name
    for name in $(compgen -e | grep -E '^(RIGOR_|GTEST_|ASAN_|UBSAN_|LD_LIBRARY_PATH$)' | grep -vxE 'RIGOR_GUEST|RIGOR_OUT'); do
      printf 'export %s=%q\n' "$name" "${!name}"
    done
    printf 'GUEST_TREE=%q GUEST_CHECKOUT=%q\n' "$GUEST_TREE" "$ROOT"
    printf 'GUEST_FOLDER=%q GUEST_TIMEOUT=%q\nGUEST_COMMAND=(' "$PWD" "$timeout"
    printf '%q ' "$@"
    printf ')\n'
  } >"$job/environment"
  cp "$ROOT/tools/guest/job.sh" "$job/job.sh"
  sed -E 's/#.*//; /^ *$/d' "$modules" >"$job/modules"
}

# One guest at a time on a machine, and nobody changes the files of one that runs.
take_lock() {
  exec 9>>"$LOCK"
  if ! flock --nonblock 9; then
    say "another guest is running on this machine; waiting until it ends" >&2
    flock 9
  fi
}

main() {
  local timeout=480 boot_timeout=120 memory=1024 out=$GUEST_CACHE/out modules=$ROOT/tools/guest/modules.txt
  local -a binds=("$ROOT" "$PWD")
  while [[ $# -gt 0 ]]; do
    case $1 in
      --timeout | --boot-timeout | --memory | --bind | --out | --modules)
        [[ $# -ge 2 ]] || { usage >&2 && no_guest "$1 wants a value"; }
        case $1 in
          --timeout) timeout=$2 ;;
          --boot-timeout) boot_timeout=$2 ;;
          --memory) memory=$2 ;;
          --bind) binds+=("$(realpath "$2")") ;;
          --out) out=$2 ;;
          --modules) modules=$2 ;;
        esac
        shift
        ;;
      --prepare)
        mkdir -p "$GUEST_CACHE"
        take_lock
        prepare_guest
        return
        ;;
      --fetch)
        [[ -n $(fetched_kernel) ]] || { take_lock && fetch_guest_packages; }
        return
        ;;
      -h | --help)
        usage
        return
        ;;
      --)
        shift
        break
        ;;
      -*) usage >&2 && no_guest "guest: unknown option '$1'" ;;
      *) break ;;
    esac
    shift
  done
  [[ $# -gt 0 ]] || { usage >&2 && no_guest "guest: which command?"; }

  mkdir -p "$out"
  out=$(realpath "$out")
  take_lock
  prepare_guest

  local bound='' folder
  for folder in "${binds[@]}"; do
    case $folder/ in
      /tmp/* | /run/*) [[ ,$bound, == *",$folder,"* ]] || bound+=${bound:+,}$folder ;;
    esac
  done
  JOB=$(mktemp -d "$GUEST_CACHE/job.XXXXXX")
  QEMU=
  PRINTER=
  # shellcheck disable=SC2086
  trap 'kill $QEMU $PRINTER 2>/dev/null || true; rm -rf "$JOB"' EXIT
  trap 'exit 130' INT TERM
  write_job "$JOB" "$timeout" "$modules" "$@"

  mkfifo "$JOB/output"
  cat "$JOB/output" 9>&- &
  PRINTER=$!
  qemu-system-x86_64 -nodefaults -no-reboot -display none -monitor none \
    -accel tcg,thread=multi -cpu max -smp 2 -m "$memory" \
    -kernel "$GUEST_TREE/vmlinuz" -initrd "$GUEST_TREE/initramfs" \
    -append "console=ttyS0 quiet panic=-1 mitigations=off tsc=reliable random.trust_cpu=on rigor.bind=$bound" \
    -serial "file:$GUEST_CACHE/kernel.log" \
    -device virtio-serial-pci -chardev "file,id=output,path=$JOB/output" \
    -device virtserialport,chardev=output,name=rigor.output \
    -fsdev local,id=root,path=/,security_model=none,multidevs=remap,readonly=on \
    -device virtio-9p-pci,fsdev=root,mount_tag=root \
    -fsdev "local,id=job,path=$JOB,security_model=none" -device virtio-9p-pci,fsdev=job,mount_tag=job \
    -fsdev "local,id=out,path=$out,security_model=none" -device virtio-9p-pci,fsdev=out,mount_tag=out \
    </dev/null 9>&- &
  QEMU=$!

  # Twice the command's time: the guest's clock may run slower than this machine's.
  local started=$SECONDS limit=$((2 * timeout + 60)) up=
  while kill -0 "$QEMU" 2>/dev/null; do
    if [[ -z $up && -e $JOB/up ]]; then
      up=$SECONDS
    elif [[ -z $up && $((SECONDS - started)) -gt $boot_timeout ]]; then
      tail -n 20 "$GUEST_CACHE/kernel.log" >&2 || true
      no_guest "guest: it did not come up within $boot_timeout s; above the end of build/guest/kernel.log"
    elif [[ -n $up && $((SECONDS - up)) -gt $limit ]]; then
      no_guest "guest: it did not end within $limit s"
    fi
    sleep 0.2
  done
  local qemu_status=0
  wait "$QEMU" || qemu_status=$?
  QEMU=
  # A QEMU that never opened the pipe leaves its reader waiting.
  [[ -e $JOB/up ]] || kill "$PRINTER" 2>/dev/null || true
  wait "$PRINTER" || true
  PRINTER=
  if [[ ! -s $JOB/status ]]; then
    tail -n 20 "$GUEST_CACHE/kernel.log" >&2 || true
    cat "$JOB/job.log" >&2 2>/dev/null || true
    no_guest "guest: it stopped before the command had ended (QEMU's status $qemu_status)"
  fi
  [[ ! -s $JOB/job.log ]] || cat "$JOB/job.log" >&2
  [[ ! -f $JOB/dmesg ]] || cp "$JOB/dmesg" "$GUEST_CACHE/kernel.log"
  local trouble
  trouble=$(grep -E 'BUG:|Oops|general protection|WARNING: CPU|refcount_t:' "$GUEST_CACHE/kernel.log" || true)
  [[ -z $trouble ]] || warn "the guest's kernel complained (build/guest/kernel.log): $trouble"
  exit "$(<"$JOB/status")"
}

main "$@"
