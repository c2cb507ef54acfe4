#!/usr/bin/env bash
# Exchange splats and frames with gsplat, nerfstudio, viser and Rerun, in an environment of their own.
#
# They are not in the tests' environment: viser needs an older rich than the tests' pins, and the
# four with what they need take 0.6 GB beside torch.
set -euo pipefail
cd "$(dirname "$0")/.."
PLACE=.venv/neighbours
if [ ! -e "$PLACE/ready" ]; then
    "${PYTHON:-python3.11}" -m venv "$PLACE"
    pip=("$PLACE/bin/python" -m pip install -q --disable-pip-version-check)
    "${pip[@]}" "$(grep '^torch==' constraints.txt)"
    "${pip[@]}" -e '.[sdk]' 'gsplat==1.5.3' 'viser==1.1.1' 'rerun-sdk==0.41.0'
    # It pins older versions of the others; its exporter alone is run.
    "${pip[@]}" --no-deps 'nerfstudio==1.1.5'
    touch "$PLACE/ready"
fi
"$PLACE/bin/python" scripts/check_neighbours.py
