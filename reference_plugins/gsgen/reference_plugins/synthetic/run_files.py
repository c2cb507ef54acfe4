"""Writes the files that the training code of several methods has in common."""

__all__ = ["write_cfg_args", "write_columns"]

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float


def write_cfg_args(folder: Path, options: Mapping[str, Any]) -> None:
    """Write ``cfg_args``, the printed ``argparse.Namespace`` of a training run."""
    folder.mkdir(parents=True, exist_ok=True)
    defaults = {"source_path": "/data/scene", "model_path": "output/synthetic", "eval": True}
    text = str(argparse.Namespace(**(defaults | dict(options))))
    (folder / "cfg_args").write_text(text, "utf-8")


def write_columns(path: Path, columns: Mapping[str, Float[np.ndarray, " n"]]) -> None:
    """Write a binary PLY with one float property for each column."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table = np.stack(list(columns.values()), axis=1).astype("<f4")
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    lines += [f"property float {name}" for name in columns]
    header = "\n".join([*lines, "end_header", ""])
    path.write_bytes(header.encode() + table.tobytes())
