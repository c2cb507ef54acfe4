"""Writes the files that the training code of several methods has in common."""

__all__ = ["splat_columns", "write_cfg_args", "write_columns"]

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gsgen.formats import Splats


def write_cfg_args(folder: Path, options: Mapping[str, Any]) -> None:
    """Write ``cfg_args``, the printed ``argparse.Namespace`` of a training run."""
    folder.mkdir(parents=True, exist_ok=True)
    defaults = {"source_path": "/data/scene", "model_path": "output/synthetic", "eval": True}
    text = str(argparse.Namespace(**(defaults | dict(options))))
    (folder / "cfg_args").write_text(text, "utf-8")


def write_columns(
    path: Path, columns: Mapping[str, Float[np.ndarray, " n"]], infos: Sequence[str] = ()
) -> None:
    """Write a binary PLY with one float property for each column, and lines ``obj_info``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table = np.stack(list(columns.values()), axis=1).astype("<f4")
    lines = ["ply", "format binary_little_endian 1.0", *(f"obj_info {info}" for info in infos)]
    lines += [f"element vertex {len(table)}"]
    lines += [f"property float {name}" for name in columns]
    header = "\n".join([*lines, "end_header", ""])
    path.write_bytes(header.encode() + table.tobytes())


def splat_columns(splats: Splats) -> dict[str, Float[np.ndarray, " n"]]:
    """Return splats as named columns of a 3DGS PLY, to which a writer can add columns."""
    count = len(splats)
    columns = dict(zip("xyz", splats.position.T, strict=True))
    columns |= dict.fromkeys(("nx", "ny", "nz"), np.zeros(count))
    tables = {
        "f_dc": splats.sh[:, 0],
        # All coefficients of red come first.
        "f_rest": splats.sh[:, 1:].transpose(0, 2, 1).reshape(count, -1),
        "opacity": splats.logit_opacity,
        "scale": splats.log_scale,
        "rot": splats.rotation,
    }
    for name, table in tables.items():
        if table.ndim == 1:
            columns[name] = table
        else:
            columns |= {f"{name}_{index}": column for index, column in enumerate(table.T)}
    return columns
