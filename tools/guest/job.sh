# shellcheck shell=bash
# Runs in the guest, in the host's root file system: the kernel's devices are brought up, then the command runs. Its
# output goes to the host by a virtio port, its status by the job share.
readonly JOB=/run/rigor-guest
# shellcheck source=/dev/null
source "$JOB/environment"

ip link set lo up

say() { echo "guest: $*" >"$PORT"; }
PORT=
for ((i = 0; i < 100; i++)); do
  for name in /sys/class/virtio-ports/*/name; do
    [[ -r $name && $(<"$name") == rigor.output ]] && PORT=/dev/$(basename "$(dirname "$name")")
  done
  [[ -n $PORT && -c $PORT ]] && break
  sleep 0.1
done
# The port can be opened once at a time; the command writes into a pipe, so that it may open /dev/stdout again.
exec 3>"$PORT"

# Debian's device manager, unpacked: nodes get their groups, libusb its hot-plug events, by the usual rules and by ours.
udev=$GUEST_TREE/udev
mkdir -p /run/udev/rules.d
for rules in 50-udev-default 60-persistent-v4l 60-serial 70-camera; do
  cp "$udev/lib/udev/rules.d/$rules.rules" /run/udev/rules.d/
done
cp "$GUEST_CHECKOUT"/tools/install/udev/*.rules /run/udev/rules.d/ 2>/dev/null || true
# The unpacked program decides by its name what it is.
"$udev/lib/systemd/systemd-udevd" --daemon 2>"$JOB/udev.log" 3>&- || echo "guest: udev does not run: $(<"$JOB/udev.log")" >&3

missing=()
while read -r module options; do
  # shellcheck disable=SC2086
  modprobe "$module" $options || missing+=("$module")
done <"$JOB/modules"
[[ ${#missing[@]} -eq 0 ]] || echo "guest: modules that do not load: ${missing[*]}" >&3
mount -t configfs configfs /sys/kernel/config 2>/dev/null || true
mountpoint -q /sys/kernel/config || echo "guest: configfs is not mounted: no USB gadgets" >&3
"$udev/bin/udevadm" settle --timeout=30 || true

status=0
(
  cd "$GUEST_FOLDER" || exit 125
  exec timeout --kill-after=5 "$GUEST_TIMEOUT" "${GUEST_COMMAND[@]}"
) </dev/null 2>&1 3>&- | cat >&3
status=${PIPESTATUS[0]}
dmesg >"$JOB/dmesg" 2>/dev/null || true
echo "$status" >"$JOB/status"
exec 3>&-
sync
