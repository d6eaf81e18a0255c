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

missing=()
while read -r module options; do
  # shellcheck disable=SC2086
  modprobe "$module" $options || missing+=("$module")
done <"$JOB/modules"
[[ ${#missing[@]} -eq 0 ]] || echo "guest: modules that do not load: ${missing[*]}" >&3
mount -t configfs configfs /sys/kernel/config 2>/dev/null || true
mountpoint -q /sys/kernel/config || echo "guest: configfs is not mounted: no USB gadgets" >&3

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
