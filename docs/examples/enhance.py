"""A single-step enhancer of Difix's kind, from its checkpoint to pictures that went through it.

``python docs/examples/enhance.py OUT`` writes a checkpoint in Difix's layout, exports it in
float16, draws splats whose colours are as noisy as in the middle of training, and puts the pictures
without and with ``--post`` side by side: OUT/enhanced.png.
"""

# %%
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from gsgen.formats import write_ply
from gsgen.reference_plugins.synthetic import torus_knot, write_difix

FRAMES = 3
CAMERA = "--frames 3 --camera orbit:20,30 --turn 300 --width 240 --height 240"
NOISE = 0.25  # of colours from 0 to 1
C0 = 0.28209479177387814  # the first of the spherical harmonics


def gsgen(*words: object) -> None:
    """Run the program."""
    subprocess.run([sys.executable, "-m", "gsgen.cli", *map(str, words)], check=True)


def main(out: Path) -> None:
    """Make everything anew."""
    # %% A checkpoint, and splats that want cleaning.
    run = write_difix(out / "run")
    knot = torus_knot(20_000)
    noise = np.random.default_rng(1).normal(size=(len(knot.sh), 3)) * NOISE / C0
    sh = knot.sh.copy()
    sh[:, 0] += noise.astype(np.float32)
    write_ply(out / "early.ply", replace(knot, sh=sh))

    # %% The model: tiles of 96 × 96, values as renderers have them, timestep 199.
    model = out / "enhance.onnx"
    words = ("--difix", run / "model.pkl", "--size", "96x96", "--values", "unit")
    gsgen("export", "denoiser", "--checkpoint", run, *words, "--dtype", "float16", "-o", model)

    # %% Pictures, as they are drawn and as they come out of the model.
    view = (*CAMERA.split(), "--background", "#16181d")
    gsgen("render", out / "early.ply", "-o", out / "before", *view)
    gsgen("render", out / "early.ply", "-o", out / "after", *view, "--post", model)
    pictures = [
        Image.open(out / kind / f"frame_{frame:04d}.png").convert("RGB")
        for frame in range(FRAMES)
        for kind in ("before", "after")
    ]
    strip = np.concatenate([np.asarray(picture) for picture in pictures], axis=1)
    Image.fromarray(strip).save(out / "enhanced.png")


# %%
if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/enhance"))
