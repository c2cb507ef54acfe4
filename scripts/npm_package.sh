#!/usr/bin/env bash
# Fetch an npm package of an exact version and digest, and put it into .venv/npm/NAME-VERSION.
#
# usage: scripts/npm_package.sh NAME VERSION SHA256
set -euo pipefail
cd "$(dirname "$0")/.."
[ $# = 3 ] || { echo "usage: $0 NAME VERSION SHA256" >&2; exit 2; }
PLACE=.venv/npm/${1##*/}-$2

if [ ! -d "$PLACE" ]; then
    command -v npm >/dev/null || { echo "no npm, with which $1 is fetched" >&2; exit 1; }
    work=$(mktemp -d)
    trap 'rm -rf "$work"' EXIT
    (cd "$work" && npm pack --silent "$1@$2" >/dev/null) || { echo "npm pack $1@$2 failed" >&2; exit 1; }
    echo "$3  $(echo "$work"/*.tgz)" | sha256sum --check --quiet || { echo "$1: the package is another one" >&2; exit 1; }
    tar -xzf "$work"/*.tgz -C "$work"
    mkdir -p .venv/npm
    mv "$work/package" "$PLACE"
fi
echo "$PLACE"
