#!/bin/busybox sh
# shellcheck shell=dash
# The guest's first process, out of its initramfs: mounts the host's files, loads the modules, runs one command, and
# powers off. What it is told comes by the kernel's command line (rigor.*) and by the job share (see tools/guest.sh).
B=/bin/busybox
$B mkdir -p /proc /sys /dev /host
$B mount -t proc proc /proc
$B mount -t sysfs sys /sys
$B mount -t devtmpfs dev /dev

stop() {
  [ -z "$1" ] || echo "rigor-guest: $1" >/dev/kmsg
  $B sync
  $B poweroff -f
  $B sleep 60
}

while read -r module; do
  $B insmod "/modules/$module" || stop "module $module does not load"
done </modules/order

mount_share() { # TAG FOLDER OPTIONS
  $B mount -t 9p -o "trans=virtio,version=9p2000.L,msize=262144,$3" "$1" "$2" || stop "share $1 cannot be mounted"
}
mount_share root /host ro,cache=loose
$B mkdir -p /keep
# Folders of the host that lie below one which the guest covers (/tmp, /run) are bound again on top of the cover.
bound=$($B sed -n 's/.*rigor\.bind=\([^ ]*\).*/\1/p' /proc/cmdline | $B tr ',' ' ')
number=0
for folder in $bound; do
  number=$((number + 1))
  $B mkdir -p "/keep/$number"
  $B mount -o bind "/host$folder" "/keep/$number" || stop "$folder cannot be bound"
done
$B mount -t tmpfs -o mode=1777 tmp /host/tmp
$B mount -t tmpfs -o mode=755 run /host/run
number=0
for folder in $bound; do
  number=$((number + 1))
  $B mkdir -p "/host$folder"
  $B mount -o bind "/keep/$number" "/host$folder" || stop "$folder cannot be bound"
done
$B mkdir -p /host/tmp/rigor-out /host/run/rigor-guest /host/run/lock /host/run/udev
mount_share out /host/tmp/rigor-out rw,cache=none
mount_share job /host/run/rigor-guest rw,cache=none
$B mount -t proc proc /host/proc
$B mount -t sysfs sys /host/sys
$B mount -t devtmpfs dev /host/dev
$B mkdir -p /host/dev/pts /host/dev/shm
$B mount -t devpts -o ptmxmode=666 pts /host/dev/pts
$B mount -t tmpfs -o mode=1777 shm /host/dev/shm
for link in "fd /proc/self/fd" "stdin /proc/self/fd/0" "stdout /proc/self/fd/1" "stderr /proc/self/fd/2"; do
  # shellcheck disable=SC2086
  set -- $link
  [ -e "/host/dev/$1" ] || $B ln -s "$2" "/host/dev/$1"
done

: >/host/run/rigor-guest/up
$B chroot /host /bin/bash /run/rigor-guest/job.sh >/host/run/rigor-guest/job.log 2>&1
stop ""
