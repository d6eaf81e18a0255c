# shellcheck shell=bash
# What the project needs of the machine: Debian packages by packages/PART.txt,
# npm packages by tests/npm/package-lock.json.
# Both ask first what is missing, so that a second call is quick and needs no network.

as_root() {
  if [[ $(id -u) -eq 0 ]]; then
    "$@"
  elif command -v sudo >/dev/null; then
    sudo "$@"
  else
    die "installing packages needs root and there is no sudo; as root: $*"
  fi
}

# Node.js 18 or newer with npm, wherever it came from.
have_node() {
  command -v npm >/dev/null && command -v node >/dev/null &&
    [[ $(node --version 2>/dev/null | sed -n 's/^v\([0-9]*\)\..*/\1/p') -ge 18 ]]
}

# The parts that packages/ has, one a line.
package_parts() {
  local file
  for file in packages/*.txt; do basename "$file" .txt; done
}

# missing_packages PART...: the packages of these parts that are not installed.
missing_packages() {
  local -a wanted
  mapfile -t wanted < <(sed 's/#.*//' "${@/%/.txt}" | tr -s ' \t' '\n' | sed '/^$/d' | sort -u)
  # A Node.js from elsewhere than Debian conflicts with Debian's npm and serves as well.
  if have_node; then
    mapfile -t wanted < <(printf '%s\n' "${wanted[@]}" | grep -vxE 'nodejs|npm')
  fi
  local installed
  # dpkg-query fails when it does not know one of the names, which is what we want to find out.
  installed=$(dpkg-query -W -f '${db:Status-Status} ${Package}\n' "${wanted[@]}" 2>/dev/null || true)
  local package
  for package in "${wanted[@]}"; do
    grep -qx "installed $package" <<<"$installed" || echo "$package"
  done
}

# install_packages PART...: the parts of packages/ by name. PACKAGE_SECONDS is how long it took.
PACKAGE_SECONDS=0
install_packages() {
  local part started=$SECONDS log
  local -a missing
  for part in "$@"; do
    [[ -f packages/$part.txt ]] ||
      die "there is no part '$part' of the packages; expected one of: $(package_parts | paste -sd' ')" 2
  done
  mapfile -t missing < <(missing_packages "${@/#/packages/}")
  if [[ ${#missing[@]} -eq 0 ]]; then
    return
  fi
  command -v apt-get >/dev/null ||
    die "this machine has no apt-get; Rigor is built on Debian 12. Missing: ${missing[*]}"
  log=$(log_file packages "$(IFS=-; echo "$*")")
  say "installing ${#missing[@]} Debian packages and what they depend on ($*)"
  : >"$log"
  as_root apt-get update -q >>"$log" 2>&1 || {
    tail -n 20 "$log" >&2
    die "apt-get update failed, and these packages are missing: ${missing[*]}. Is there a network? Log: $log"
  }
  # Only the progress goes through the pipe: maintainer scripts whose output did, too, failed with I/O errors on a
  # machine so busy that the pipe's reader was slow.
  # shellcheck disable=SC2016
  as_root env DEBIAN_FRONTEND=noninteractive bash -c 'exec apt-get "$@" 3>&1 >>"$0" 2>&1' "$log" \
    install -y -q --no-install-recommends -o APT::Status-Fd=3 -o Dpkg::Use-Pty=0 "${missing[@]}" | apt_progress "$log" || {
    tail -n 20 "$log" >&2
    die "apt-get could not install: ${missing[*]}. Log: $log"
  }
  PACKAGE_SECONDS=$((PACKAGE_SECONDS + SECONDS - started))
  say "packages installed in $(minutes $((SECONDS - started)))"
}

# The reference readers of MCAP and ROS 2 messages that a test checks recordings with.
install_npm_packages() {
  local modules=tests/npm/node_modules lock=tests/npm/package-lock.json
  local stamp=$modules/.rigor-lock
  if [[ -f $stamp ]] && cmp -s "$lock" "$stamp"; then
    return
  fi
  say "installing the npm packages of tests/npm"
  if npm ci --prefix tests/npm --no-audit --no-fund --loglevel=error; then
    cp "$lock" "$stamp"
  elif [[ -d $modules ]]; then
    warn "npm ci failed; going on with what $modules holds, which may not match $lock"
  else
    die "npm ci failed and $modules is not there. Is there a network?"
  fi
}
