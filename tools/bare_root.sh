# shellcheck shell=bash
# A fresh, minimal Debian 12 below the folder `root`, for tools/try_*.sh, which have `die`. Needs root rights, debootstrap and a
# network.
root=''

readonly MIRROR=${DEBIAN_MIRROR:-http://deb.debian.org/debian}

# own_mounts SCRIPT ARG...: the script again, with mounts in a namespace of its own: they go when it goes, however it goes.
own_mounts() {
  [[ ${RIGOR_CHROOT_INSIDE:-} != yes ]] || return 0
  [[ $(id -u) -eq 0 ]] || die "needs root"
  command -v debootstrap >/dev/null || die "needs debootstrap: apt-get install debootstrap"
  RIGOR_CHROOT_INSIDE=yes exec unshare --mount --propagation private "$@"
}

# make_root [TARBALL]: a root in `root`, where none is there. TARBALL keeps the bare system from one time to the next.
make_root() {
  local kept=${1:-}
  [[ ! -x $root/usr/bin/apt-get ]] || return 0
  mkdir -p "$root"
  if [[ -n $kept && -f $kept ]]; then
    tar --numeric-owner -C "$root" -xf "$kept"
    return
  fi
  debootstrap --variant=minbase bookworm "$root" "$MIRROR" >"$root.log" 2>&1 ||
    { tail -n 20 "$root.log" && die "debootstrap failed, see $root.log"; }
  rm -f "$root.log"
  [[ -z $kept ]] || tar --numeric-owner -C "$root" -cf "$kept" .
}

# mount_root: what programs expect of a running system, and this machine's way to the network.
mount_root() {
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
}

# in_root COMMAND...: with nothing of this machine's environment but NAME=VALUE words of `environment`.
environment=(HOME=/root "TERM=${TERM:-dumb}")
in_root() {
  env -i "${environment[@]}" PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin chroot "$root" "$@"
}

# remove_root KEEP: unmounts, and deletes the root unless KEEP is yes.
remove_root() {
  local mounted
  # What is mounted on something else comes first.
  while read -r mounted; do
    umount --recursive --lazy "$mounted" 2>/dev/null || true
  done < <(awk -v under="$root/" 'index($2, under) == 1 { print $2 }' /proc/self/mounts | tac)
  if [[ $1 == yes ]]; then
    echo "kept $root"
  elif grep -q " $root/" /proc/self/mounts; then
    echo "something is still mounted below $root; not deleting it" >&2
  else
    rm -rf --one-file-system "$root"
  fi
}
