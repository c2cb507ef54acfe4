#!/usr/bin/env bash
# Put SwiftShader, a second software Vulkan driver, into .venv/swiftshader, if it is nowhere yet.
#
# Some tests draw on it, too, and are skipped without it. Debian has it in its package chromium-common, of
# which two files are unpacked here: nothing is installed, and no root is needed.
set -euo pipefail
cd "$(dirname "$0")/.."
PLACE=.venv/swiftshader

for file in "$PLACE" /usr/lib/chromium /usr/lib/chromium-browser; do
    if [ -e "$file/vk_swiftshader_icd.json" ]; then
        echo "drivers: SwiftShader is in $file"
        exit 0
    fi
done

skip() {
    echo "drivers: no SwiftShader, so tests on it are skipped: $1" >&2
    exit 0
}

command -v apt-get >/dev/null || skip "no apt on this system"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
chmod 755 "$work"
(cd "$work" && apt-get download -qq chromium-common >/dev/null 2>&1) || skip "apt-get download chromium-common failed"
dpkg-deb --fsys-tarfile "$work"/chromium-common_*.deb |
    tar -x -C "$work" --wildcards '*/libvk_swiftshader.so' '*/vk_swiftshader_icd.json' 2>/dev/null ||
    skip "the package chromium-common has none"
mkdir -p .venv
mv "$work"/usr/lib/chromium "$PLACE"
echo "drivers: SwiftShader is in $PLACE"
