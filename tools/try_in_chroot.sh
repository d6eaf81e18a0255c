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

repository=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

die() {
  echo "try_in_chroot: $*" >&2
  exit 1
}
# shellcheck source=tools/bare_root.sh
source "$repository/tools/bare_root.sh"
own_mounts "$0" "$@"

keep=no data='' ca=''
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
trap 'remove_root "$keep"' EXIT
trap 'exit 130' INT TERM

make_root ''
mount_root
rm -rf "$root/home/rigor"
git clone --quiet --no-hardlinks "$repository" "$root/home/rigor"
if [[ -n $data ]]; then
  mkdir -p "$root/home/shared/data"
  mount --bind -o ro "$data" "$root/home/shared/data"
fi
if [[ -n $ca ]]; then
  cp "$ca" "$root/etc/extra-certificates.pem"
  environment+=(NODE_EXTRA_CA_CERTS=/etc/extra-certificates.pem)
fi

started=$SECONDS status=0
# shellcheck disable=SC2016
in_root /bin/bash -c 'cd /home/rigor && exec "$@"' bash "$@" || status=$?
echo "try_in_chroot: '$*' ended with $status after $((SECONDS - started)) s; the root takes" \
  "$(du -shx "$root" | cut -f1)"
exit "$status"
