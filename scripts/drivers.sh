#!/usr/bin/env bash
# Install a software Vulkan driver: Mesa's lavapipe, 25 or newer.
#
# ONNX Runtime's WebGPU provider refuses older ones, and only newer ones have
# 16-bit floats in shaders. Debian 12 keeps Mesa 25 in its backports suite.
set -euo pipefail

WANTED=25

installed_major() {
    dpkg-query -W -f '${Version}' mesa-vulkan-drivers 2>/dev/null | sed 's/^[0-9]*://; s/\..*//'
}

# Without -q, grep reads to the end: where it stops at the first match, ldconfig may be killed by the
# closed pipe, and `pipefail` then reads a driver that is there as missing.
is_ready() {
    local major
    major=$(installed_major) || true
    [ -n "$major" ] && [ "$major" -ge "$WANTED" ] && ls /usr/share/vulkan/icd.d/lvp_icd*.json >/dev/null 2>&1 &&
        ldconfig -p | grep libvulkan.so.1 >/dev/null
}

explain() {
    cat >&2 <<TEXT
drivers: $1
  What is needed: a Vulkan loader (libvulkan1) and Mesa's software driver, version $WANTED or newer.
  Debian 12:  add the suite bookworm-backports to your apt sources, then, as root:
              apt-get update && apt-get install -y libvulkan1 && apt-get install -y -t bookworm-backports mesa-vulkan-drivers
  Debian 13, Ubuntu 25.04 and newer, as root:
              apt-get install -y libvulkan1 mesa-vulkan-drivers
  Then run \`gsgen doctor\` to see the adapter.
TEXT
    exit 1
}

if is_ready; then
    echo "drivers: Mesa $(installed_major) lavapipe is installed"
    exit 0
fi
command -v apt-get >/dev/null || explain "no apt on this system, so nothing was installed"
[ "$(id -u)" -eq 0 ] || explain "not root, so nothing was installed"

export DEBIAN_FRONTEND=noninteractive
apt-get update -qq || explain "apt-get update failed"
candidate=$(apt-cache policy mesa-vulkan-drivers | awk '/Candidate:/ {print $2}' | sed 's/^[0-9]*://; s/\..*//')
suite=()
if [ "${candidate:-0}" = "(none)" ] || [ "${candidate:-0}" -lt "$WANTED" ]; then
    # The backports suite lives beside the release in the same archive: take its address
    # from the sources that this system already trusts.
    release=$(. /etc/os-release && echo "$VERSION_CODENAME")
    archive=$(apt-get indextargets --format '$(REPO_URI)|$(RELEASE)' |
        awk -F'|' -v r="$release" '$2 == r {print $1; exit}')
    [ -n "$archive" ] || explain "no apt source for $release was found"
    list=/etc/apt/sources.list.d/gsgen-backports.list
    echo "deb $archive $release-backports main" >"$list"
    apt-get update -qq || { rm -f "$list"; explain "the backports suite could not be read"; }
    suite=(-t "$release-backports")
fi
apt-get install -y -qq --no-install-recommends libvulkan1 >/dev/null || explain "libvulkan1 could not be installed"
apt-get install -y -qq --no-install-recommends "${suite[@]}" mesa-vulkan-drivers >/dev/null ||
    explain "mesa-vulkan-drivers could not be installed"
is_ready || explain "the installed Mesa is older than $WANTED"
echo "drivers: installed Mesa $(installed_major) lavapipe"
