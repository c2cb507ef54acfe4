#!/usr/bin/env bash
# Put PlayCanvas' splat-transform into .venv/splat-transform.
#
# The benchmark of SOG compares gsgen's files with those of this program, of an exact version and
# digest, and lets each read the other's.
set -euo pipefail
cd "$(dirname "$0")/.."
VERSION=3.7.0
SHA256=82a7d06478ea6514e0babbf9c586153a3bdf5f741d23d3c2bf7fbf9427f5f19a
PLACE=.venv/splat-transform

explain() {
    echo "splat-transform: $1" >&2
    exit 1
}

if [ "$(cat "$PLACE/VERSION" 2>/dev/null)" != "$VERSION" ]; then
    command -v npm >/dev/null || explain "no npm, with which splat-transform is fetched"
    mkdir -p .venv
    rm -rf "$PLACE"
    mkdir "$PLACE"
    (cd "$PLACE" && npm pack --silent "@playcanvas/splat-transform@$VERSION" >/dev/null) ||
        explain "npm pack @playcanvas/splat-transform@$VERSION failed"
    archive=playcanvas-splat-transform-$VERSION.tgz
    echo "$SHA256  $PLACE/$archive" | sha256sum --check --quiet || explain "the package is another one"
    npm install --silent --no-audit --no-fund --prefix "$PLACE" "$PLACE/$archive" ||
        explain "npm install of $archive failed"
    echo "$VERSION" >"$PLACE/VERSION"
fi
echo "splat-transform: $PLACE/node_modules/.bin/splat-transform, version $VERSION"
