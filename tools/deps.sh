# shellcheck shell=bash
# What the project needs of the machine: Debian packages by packages.txt, npm packages by tests/npm/package-lock.json.
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

missing_packages() {
  local -a wanted
  mapfile -t wanted < <(sed 's/#.*//' packages.txt | tr -s ' \t' '\n' | sed '/^$/d')
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

install_packages() {
  local -a missing
  mapfile -t missing < <(missing_packages)
  if [[ ${#missing[@]} -eq 0 ]]; then
    return
  fi
  command -v apt-get >/dev/null ||
    die "this machine has no apt-get; Rigor is built on Debian 12. Missing: ${missing[*]}"
  say "installing ${#missing[@]} Debian packages: ${missing[*]}"
  as_root apt-get update -q ||
    die "apt-get update failed, and these packages are missing: ${missing[*]}. Is there a network?"
  as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "${missing[@]}" ||
    die "apt-get could not install: ${missing[*]}"
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
