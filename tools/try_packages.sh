#!/usr/bin/env bash
# try_packages.sh [--keep] [--dir DIR] [--base TARBALL] [FOLDER]
#
# Installs the packages of FOLDER (default: build/packages, from ./dev package) in a fresh, minimal Debian 12, does what a newcomer does,
# and removes them again: the demo in virtual and in wall-clock time by a user without rights, a picture of a simulated camera, the
# Python module where there is one, each example of the SDK. Says what each step took. Needs root, debootstrap and a network; 3 GB
# below DIR (default: a new folder in /var/tmp), which is deleted at the end. Exit status 1 where a step fails or something is left.
#   --keep           leaves the root there; with --dir, a root that is already there is used again
#   --base TARBALL   keeps the bare system, before anything is installed, from one time to the next
set -euo pipefail

repository=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

die() {
  echo "try_packages: $*" >&2
  exit 1
}
# shellcheck source=tools/bare_root.sh
source "$repository/tools/bare_root.sh"
own_mounts "$0" "$@"

keep=no base=''
while [[ ${1:-} == --* ]]; do
  case $1 in
    --keep) keep=yes ;;
    --dir) root=$2 && shift ;;
    --base) base=$2 && shift ;;
    *) die "expected --keep, --dir DIR or --base TARBALL, got '$1'" ;;
  esac
  shift
done
packages=${1:-$repository/build/packages}
compgen -G "$packages/rigor_*.deb" >/dev/null || die "$packages has no rigor_*.deb: ./dev package makes it"
[[ -n $root ]] || root=$(mktemp -d /var/tmp/rigor-packages.XXXXXX)
root=$(realpath -m "$root")
[[ $root != / && $root != "$repository"* ]] || die "will not use $root"
trap 'remove_root "$keep"' EXIT
trap 'exit 130' INT TERM

log=$(mktemp)
# step WHAT COMMAND...: says what it took; what it said only where it fails.
step() {
  local what=$1 since
  shift
  since=$(date +%s.%N)
  "$@" >"$log" 2>&1 || { cat "$log" && die "$what: failed"; }
  awk -v what="$what" -v from="$since" -v to="$(date +%s.%N)" 'BEGIN { printf "%7.1f s  %s\n", to - from, what }'
}
# What apt said of a download, of the step before.
sizes() { sed -nE 's/^(Need to get .*archives|After this operation.*used)\.?$/           \1/p' "$log"; }
as_user() { in_root setpriv --reuid=1000 --regid=1000 --clear-groups env HOME=/home/user sh -c "cd /home/user && $1"; }
apt() { in_root env DEBIAN_FRONTEND=noninteractive apt-get -q -y -o Dpkg::Use-Pty=0 "$@"; }
# Files and folders that are ours, or that Python made of ours.
ours() { in_root find / -xdev \( -path /proc -o -path /packages -o -path /home -o -path /tmp -o -path /var/log -o -path /var/cache \) -prune -o -iname '*rigor*' -print; }

step "a bare Debian 12" make_root "$base"
mount_root
mkdir -p "$root/packages"
cp "$packages"/*.deb "$root/packages"
in_root useradd --create-home --uid 1000 user 2>/dev/null || true

deb() { (cd "$root" && echo packages/"$1"_*.deb | sed 's,packages,/packages,g'); }
runtime=$(compgen -G "$root/packages/librigor[0-9]*.deb" | sed "s,^$root,,")
step "apt update" apt update
step "apt install ./rigor_*.deb and its libraries" apt install "$(deb rigor)" "$runtime"
sizes
step "rigor --version" as_user "rigor --version"
cat "$log"
step "rigor rigs" as_user "rigor rigs"
step "the first picture: rigor sense demo --channel right --at 2 -o right.png" \
  as_user "rigor sense demo --channel right --at 2 -o right.png && test -s right.png"
step "the first labelled picture: rigor dataset demo --channels right --sample 1 -o data" \
  as_user "rigor dataset demo --channels right --sample 1 -o data && ls data/annotations/*.json"
step "rigor run demo --clock virtual (10 s of bench time, without real-time rights)" as_user "rigor run demo --clock virtual"
step "rigor run demo (10 s of wall-clock time, without real-time rights)" as_user "rigor run demo"
step "expectations and JUnit's XML" as_user \
  "rigor run demo --clock virtual --duration 2 --set 'expect=[{of: right, missing: {max: 0}}]' --junit junit.xml && grep -q 'failures=\"0\"' junit.xml"
step "an application in Python, by root" in_root sh -c "cd /root && rigor run demo --clock virtual --duration 1 \
  --set 'application={command: [python3, /usr/share/rigor/examples/application/detector.py]}'"
if compgen -G "$root/packages/python3-rigor_*.deb" >/dev/null; then
  step "apt install ./python3-rigor_*.deb" apt install "$(deb python3-rigor)"
  sizes
  step "python3 -c 'import rigor'" as_user "python3 -c 'import rigor; print(rigor.__version__)'"
  in_root python3 -c 'import rigor'
fi
step "apt install ./librigor-dev_*.deb, cmake, g++, libgtest-dev" apt install "$(deb librigor-dev)" cmake g++ make libgtest-dev libgmock-dev
for example in $(in_root sh -c 'cd /usr/share/rigor/examples && dirname */CMakeLists.txt'); do
  step "examples/$example: configured and built" as_user \
    "cp -r /usr/share/rigor/examples/$example . && cmake -S $example -B $example/build -DCMAKE_BUILD_TYPE=Release && cmake --build $example/build"
done
step "examples/driver: conformance suite, and a run by the driver" as_user \
  "driver/build/conformance_test && rigor run driver/rig.yaml --clock virtual"
step "examples/embedded: rigs in a test of one's own" as_user "RIGOR_CONFIGS=/usr/share/rigor/configs embedded/build/embedded_test"

mapfile -t names < <(in_root dpkg-query -W | sed -nE 's/^([a-z0-9.-]*rigor[a-z0-9.-]*).*/\1/p')
step "apt purge ${names[*]}" apt purge "${names[@]}"
step "apt autoremove" apt autoremove --purge
left=$(ours)
[[ -z $left ]] || die "left behind after the removal: $left"
echo "           nothing is left behind"
rm -f "$log"
