#!/usr/bin/env bash
# try_in_chroot.sh [--keep] [--dir DIR] [--data DIR] [--ca FILE] ./dev COMMAND...
#
# Runs a ./dev command of the committed tree in a fresh, minimal Debian 12 with nothing installed by hand. Needs root,
# debootstrap and a network; 2 to 5 GB below DIR (default: a new folder in /var/tmp), which is deleted at the end.
# `./dev run` ends with what packages, building and the start took.
#   --keep      leaves the root there; with --dir, a root that is already there is used again
#   --data DIR  shows DIR, read-only, as the test data
#   --ca FILE   lets npm trust the certificates in FILE, too: for networks behind a proxy that signs for others
set -euo pipefail

readonly MIRROR=${DEBIAN_MIRROR:-http://deb.debian.org/debian}
repository=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

die() {
  echo "try_in_chroot: $*" >&2
  exit 1
}

# Mounts live in a namespace of our own: they go when we go, however we go.
if [[ ${RIGOR_CHROOT_INSIDE:-} != yes ]]; then
  [[ $(id -u) -eq 0 ]] || die "needs root"
  command -v debootstrap >/dev/null || die "needs debootstrap: apt-get install debootstrap"
  RIGOR_CHROOT_INSIDE=yes exec unshare --mount --propagation private "$0" "$@"
fi

keep=no root='' data='' ca=''
while [[ ${1:-} == --* ]]; do
  case $1 in
    --keep) keep=yes ;;
    --dir) root=$2 && shift ;;
    --data) data=$2 && shift ;;
    --ca) ca=$2 && shift ;;
    *) die "expected --keep, --dir DIR, --data DIR or --ca FILE, got '$1'" ;;
  esac
  shift
done
[[ $# -gt 0 ]] || die "which command? For example: ./dev test"
[[ -n $root ]] || root=$(mktemp -d /var/tmp/rigor-chroot.XXXXXX)
root=$(realpath -m "$root")
[[ $root != / && $root != "$repository"* ]] || die "will not use $root"

# shellcheck disable=SC2317  # the trap calls it
clean_up() {
  local mounted
  for mounted in home/shared/data tmp dev sys proc; do
    umount --recursive --lazy "$root/$mounted" 2>/dev/null || true
  done
  if [[ $keep == yes ]]; then
    echo "try_in_chroot: kept $root"
  elif grep -q " $root/" /proc/self/mounts; then
    echo "try_in_chroot: something is still mounted below $root; not deleting it" >&2
  else
    rm -rf --one-file-system "$root"
  fi
}
trap clean_up EXIT
trap 'exit 130' INT TERM

if [[ ! -x $root/usr/bin/apt-get ]]; then
  debootstrap --variant=minbase bookworm "$root" "$MIRROR" >"$root.log" 2>&1 ||
    { tail -n 20 "$root.log" && die "debootstrap failed, see $root.log"; }
  rm -f "$root.log"
fi
mount -t proc proc "$root/proc"
mount --rbind /sys "$root/sys"
mount --rbind /dev "$root/dev"
mount -t tmpfs tmpfs "$root/tmp"
mount --make-rslave "$root/sys"
mount --make-rslave "$root/dev"
cp /etc/resolv.conf "$root/etc/resolv.conf"
cp /etc/hosts "$root/etc/hosts"
# Proxies of this machine's apt serve in the root, too.
apt-config dump 2>/dev/null | grep -iE '^Acquire::https?::Proxy' >"$root/etc/apt/apt.conf.d/50proxy" || true

rm -rf "$root/home/rigor"
git clone --quiet --no-hardlinks "$repository" "$root/home/rigor"
if [[ -n $data ]]; then
  mkdir -p "$root/home/shared/data"
  mount --bind -o ro "$data" "$root/home/shared/data"
fi

environment=(HOME=/root "TERM=${TERM:-dumb}")
if [[ -n $ca ]]; then
  cp "$ca" "$root/etc/extra-certificates.pem"
  environment+=(NODE_EXTRA_CA_CERTS=/etc/extra-certificates.pem)
fi

started=$SECONDS status=0
env -i "${environment[@]}" PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
  chroot "$root" /bin/bash -c 'cd /home/rigor && exec "$@"' bash "$@" || status=$?
echo "try_in_chroot: '$*' ended with $status after $((SECONDS - started)) s; the root takes" \
  "$(du -shx "$root" | cut -f1)"
exit "$status"
