#!/usr/bin/env bash
# Run all tests on every core, and ask for 90 % of the contract's lines.
set -euo pipefail
cd "$(dirname "$0")/.."
BIN=.venv/bin

# Each worker computes in one thread: those of several workers would wait for each other, and keep
# the cores busy meanwhile.
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

# Tests write some hundred thousand small files, most of them for processes that run models. Where
# there is room they are in memory: a file takes a quarter of the time that it takes on a disk.
ROOM=12000000 # KiB
if [ "$(df --output=avail /dev/shm 2>/dev/null | tail -n 1)" -gt "$ROOM" ] 2>/dev/null; then
  TMPDIR=$(mktemp -d /dev/shm/gsgen-tests.XXXXXX)
  export TMPDIR
  trap 'rm -rf "$TMPDIR"' EXIT
fi

$BIN/coverage erase
# A file's tests stay together: they share models that were judged once. Those that take longest
# come first, as tests/conftest.py orders them. Collecting messages of libraries for each step of a
# test takes a sixth of what pytest takes, and no test reads them.
$BIN/coverage run -m pytest -q -n auto --dist loadfile --no-loadscope-reorder --slowest-files 50 \
  -p no:logging "$@"
$BIN/coverage combine --quiet
$BIN/coverage report --include='contract/*' --fail-under=90 | tail -n 25
