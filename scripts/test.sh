#!/usr/bin/env bash
# Run all tests on every core, and ask for 90 % of the contract's lines.
set -euo pipefail
cd "$(dirname "$0")/.."
BIN=.venv/bin

$BIN/coverage erase
$BIN/coverage run -m pytest -n auto --dist worksteal "$@"
$BIN/coverage combine --quiet
$BIN/coverage report --include='contract/*' --fail-under=90
