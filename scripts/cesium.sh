#!/usr/bin/env bash
# Put CesiumJS into .venv/cesium, and say how to get the browser that runs it.
#
# Tests load tilesets in the real viewer: Debian's chromium, headless, and CesiumJS from npm, of an
# exact version and digest.
set -euo pipefail
cd "$(dirname "$0")/.."
VERSION=1.145.0
SHA256=7e348d18dcc14608bd8b110765f2c00dfd4602c7194647fa49cd4c4a757d4ae1
PLACE=.venv/cesium

explain() {
    echo "cesium: $1" >&2
    exit 1
}

if ! command -v chromium >/dev/null; then
    [ "$(id -u)" = 0 ] || explain "no chromium; as root: apt-get update && apt-get install -y chromium"
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium >/dev/null ||
        explain "apt-get install chromium failed"
fi
if [ "$(cat "$PLACE/VERSION" 2>/dev/null)" != "$VERSION" ]; then
    command -v npm >/dev/null || explain "no npm, with which CesiumJS is fetched"
    work=$(mktemp -d)
    trap 'rm -rf "$work"' EXIT
    (cd "$work" && npm pack --silent "cesium@$VERSION" >/dev/null) || explain "npm pack cesium@$VERSION failed"
    echo "$SHA256  $work/cesium-$VERSION.tgz" | sha256sum --check --quiet || explain "the package is another one"
    tar -xzf "$work/cesium-$VERSION.tgz" -C "$work" package/Build/Cesium
    rm -rf "$PLACE"
    mkdir -p .venv
    mv "$work/package/Build/Cesium" "$PLACE"
    echo "$VERSION" >"$PLACE/VERSION"
fi
echo "cesium: $PLACE, version $VERSION; $(chromium --version 2>/dev/null || echo chromium)"
