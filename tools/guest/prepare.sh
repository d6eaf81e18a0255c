# shellcheck shell=bash
# What tools/guest.sh boots: Debian's kernel, those of its modules that tools/guest/modules.txt names, v4l2loopback built
# for it, and an initramfs. Everything is unpacked into build/guest; nothing is installed. Packages come by apt-get
# download, which checks their signatures, once; without a network what is there serves.

# shellcheck disable=SC2153
readonly GUEST_CACHE=$ROOT/build/guest
readonly GUEST_PACKAGES=$GUEST_CACHE/packages
readonly GUEST_TREE=$GUEST_CACHE/tree
# What the initramfs needs to mount the host's files, in the order in which they are loaded.
readonly BOOT_MODULES=(virtio_ring virtio virtio_pci_modern_dev virtio_pci_legacy_dev virtio_pci
  9pnet 9pnet_virtio netfs fscache 9p virtio_console)

need_guest_programs() {
  local -A package_of=([qemu-system-x86_64]=qemu-system-x86 [busybox]=busybox-static [depmod]=kmod [make]=make)
  local program
  for program in "${!package_of[@]}"; do
    PATH=$PATH:/usr/sbin:/sbin command -v "$program" >/dev/null || {
      warn "guest: $program is missing; to get it: ./dev deps kernel, or apt-get install --no-install-recommends ${package_of[$program]}"
      exit 125
    }
  done
}

# The newest kernel that the linux-image-amd64 of the package lists stands for: 6.1.0-NN-amd64.
newest_kernel() {
  apt-cache depends linux-image-amd64 2>/dev/null | sed -nE 's/^ *Depends: linux-image-([0-9].*)$/\1/p' | head -n 1
}

# The .deb of a package in our folder, whatever its version; fails when there is none.
package_file() {
  local file
  for file in "$GUEST_PACKAGES/$1"_*.deb; do
    [[ -s $file ]] && echo "$file" && return
  done
  return 1
}

guest_package_names() {
  echo "linux-image-$1" "linux-headers-$1" "linux-headers-${1%-amd64}-common" linux-kbuild-6.1 v4l2loopback-source udev
}

# The kernel that was fetched with all that belongs to it.
fetched_kernel() {
  local file version name
  for file in "$GUEST_PACKAGES"/linux-image-*.deb; do
    [[ -s $file ]] || continue
    version=$(basename "$file")
    version=${version#linux-image-} version=${version%%_*}
    for name in $(guest_package_names "$version"); do
      package_file "$name" >/dev/null || continue 2
    done
    echo "$version"
  done | sort -V | tail -n 1
}

download_guest_packages() {
  rm -f "$GUEST_PACKAGES"/*.deb
  # shellcheck disable=SC2046
  (cd "$GUEST_PACKAGES" && apt-get download -q -o APT::Sandbox::User=root $(guest_package_names "$1") >&2) && return
  rm -f "$GUEST_PACKAGES"/*.deb
  return 1
}

fetch_guest_packages() {
  [[ -z $(fetched_kernel) ]] || return 0
  local kernel
  kernel=$(newest_kernel)
  if [[ -z $kernel ]]; then
    as_root apt-get update -q >/dev/null 2>&1 || true
    kernel=$(newest_kernel)
  fi
  [[ -n $kernel ]] || { warn "guest: apt knows no linux-image-amd64: apt-get update" && exit 125; }
  say "fetching the guest's kernel $kernel into build/guest (85 MB)" >&2
  mkdir -p "$GUEST_PACKAGES"
  download_guest_packages "$kernel" || {
    # Package lists that are too old name files that are gone.
    as_root apt-get update -q >/dev/null 2>&1 || true
    kernel=$(newest_kernel)
    download_guest_packages "$kernel"
  } || {
    warn "guest: the packages could not be downloaded (apt-get update, then ./dev deps kernel with a network)"
    exit 125
  }
}

# v4l2loopback.ko for the kernel, by the headers unpacked beside it: their absolute names are turned to where they lie.
build_v4l2loopback() {
  local kernel=$1 work=$2 result=$3 name
  local headers=$work/usr/src/linux-headers-$kernel common=$work/usr/src/linux-headers-${kernel%-amd64}-common
  for name in "linux-headers-$kernel" "linux-headers-${kernel%-amd64}-common" linux-kbuild-6.1 v4l2loopback-source; do
    dpkg -x "$(package_file "$name")" "$work"
  done
  sed -i "s#/usr/src/#$work/usr/src/#g" "$headers/Makefile"
  # The compiler is the machine's own.
  sed -i 's/^CC = .*/CC = gcc/' "$headers/.kernelvariables" "$common/.kernelvariables" 2>/dev/null || true
  busybox tar -xjf "$work/usr/src/v4l2loopback.tar.bz2" -C "$work"
  make -C "$headers" M="$work/modules/v4l2loopback" CC=gcc modules >"$work/make.log" 2>&1 || {
    tail -n 20 "$work/make.log" >&2
    warn "guest: v4l2loopback could not be built"
    return 1
  }
  cp "$work/modules/v4l2loopback/v4l2loopback.ko" "$result"
}

# The modules that are named, with all they depend on, out of the unpacked package at WORK into TREE.
copy_modules() {
  local kernel=$1 work=$2 tree=$3 name
  local from=$work/lib/modules/$kernel to=$tree/lib/modules/$kernel
  mkdir -p "$to"
  depmod -b "$work" "$kernel"
  {
    for name in "${BOOT_MODULES[@]}" $(sed -E 's/#.*//' "$ROOT/tools/guest/modules.txt" | awk '{ print $1 }'); do
      modprobe -d "$work" -S "$kernel" --show-depends "$name" ||
        warn "guest: the kernel has no module $name"
    done
  } | sed -nE 's#^insmod ([^ ]+).*#\1#p' | sort -u | while read -r name; do
    install -D -m 644 "$name" "$to/${name#"$from/"}"
  done
  cp "$from/modules.builtin" "$from/modules.builtin.modinfo" "$from/modules.order" "$to/"
  depmod -b "$tree" "$kernel"
}

build_initramfs() {
  local kernel=$1 work=$2 tree=$3 root=$2/initramfs name file
  mkdir -p "$root/bin" "$root/modules"
  cp "$(command -v busybox)" "$root/bin/busybox"
  install -m 755 "$ROOT/tools/guest/init.sh" "$root/init"
  for name in "${BOOT_MODULES[@]}"; do
    file=$(find "$tree/lib/modules/$kernel" -name "$name.ko" -o -name "${name//_/-}.ko" | head -n 1)
    [[ -n $file ]] || continue # built in
    cp "$file" "$root/modules/$name.ko"
    echo "$name.ko" >>"$root/modules/order"
  done
  (cd "$root" && find . | busybox cpio -o -H newc 2>/dev/null) >"$tree/initramfs"
}

prepare_guest() {
  export PATH=$PATH:/usr/sbin:/sbin
  need_guest_programs
  local kernel key
  fetch_guest_packages
  kernel=$(fetched_kernel)
  key=$(cat "$ROOT"/tools/guest/{prepare.sh,init.sh,modules.txt} <(ls -l "$GUEST_PACKAGES") | sha256sum)
  [[ ! -f $GUEST_TREE/key || $(<"$GUEST_TREE/key") != "$key" ]] || return 0
  say "unpacking the guest's kernel $kernel and building its v4l2loopback" >&2
  local work
  work=$(mktemp -d "$GUEST_CACHE/unpack.XXXXXX")
  rm -rf "$GUEST_TREE"
  mkdir -p "$GUEST_TREE"
  dpkg -x "$(package_file "linux-image-$kernel")" "$work"
  cp "$work/boot/vmlinuz-$kernel" "$GUEST_TREE/vmlinuz"
  build_v4l2loopback "$kernel" "$work" "$work/lib/modules/$kernel/v4l2loopback.ko"
  copy_modules "$kernel" "$work" "$GUEST_TREE"
  dpkg -x "$(package_file udev)" "$GUEST_TREE/udev"
  ln -sf ../../bin/udevadm "$GUEST_TREE/udev/lib/systemd/systemd-udevd"
  build_initramfs "$kernel" "$work" "$GUEST_TREE"
  rm -rf "$work"
  echo "$key" >"$GUEST_TREE/key"
}
