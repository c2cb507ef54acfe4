#!/usr/bin/env bash
# Put what checks the browser client into .venv/npm: the TypeScript compiler, which reads the types
# in its comments, and three.js at both ends of the range of versions that the client supports.
set -euo pipefail
fetch="$(dirname "$0")/npm_package.sh"
"$fetch" typescript 5.9.3 10e108c9cf7d5f2879053dff18515fb405abf2ccef63eaaf017d9c571687a1d3
"$fetch" @webgpu/types 0.1.74 338b7fd717168ed7fdab61c124bf426cb90e2ffa30f61539e5c7cc6ea0a28062
"$fetch" three 0.180.0 ad66d724565ee29a2467277fa84daa5ed0211d6b8d446e9ef29f6bae0cd14144
"$fetch" three 0.187.0 ff540832ded0cfe919764d24a3d88f3e2a05f23303f876423e4f893841e90728
