"""Tilesets of neural tiles in a row, each in a frame of its own."""

import hashlib
import json
from pathlib import Path

import numpy as np
import onnxruntime

from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.formats.shared.origins import join_splats
from gsgen.runtime.scene.scene import SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.tiles.format.neural_tile import NEURAL_TILE_EXTENSION
from gsgen.tiles.gltf.encoding import write_content
from gsgen.tiles.validation.sketches import sample_splats

SPACING = 8.0


def transforms(count: int, seed: int = 0) -> list[np.ndarray]:
    """Random similarities, the n-th of them with its origin at x = 8 n."""
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    matrices = []
    for number, turn in enumerate(rotation_matrix(quaternions)):
        matrix = np.eye(4)
        matrix[:3, :3] = turn * rng.uniform(0.7, 1.3)
        matrix[:3, 3] = SPACING * number, *rng.uniform(-1, 1, 2)
        matrices.append(matrix)
    return matrices


def write_neural_tileset(
    folder: Path,
    models: list[bytes],
    *,
    seed: int = 0,
    roles: tuple[str, ...] = ("time",),
    splats_max: int = 40,
) -> Path:
    """Write a root and one neural leaf for each model; an empty model file is left out."""
    leaves = []
    coarse = []
    (folder / "t").mkdir(parents=True)
    for number, (model, matrix) in enumerate(
        zip(models, transforms(len(models), seed), strict=True)
    ):
        splats = sample_splats(24, (0, 0, 0), degree=1, seed=seed + number)
        (folder / "t" / f"{number}.glb").write_bytes(write_content(splats, np.zeros(3)).data)
        coarse.append(sample_splats(6, tuple(matrix[:3, 3]), degree=1, seed=seed + number))
        if model:
            (folder / "t" / f"{number}.onnx").write_bytes(model)
        leaves.append(
            {
                "boundingVolume": {"box": [0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0, 2]},
                "geometricError": 0,
                "transform": matrix.T.ravel().tolist(),
                "content": {"uri": f"t/{number}.glb"},
                "extensions": {
                    NEURAL_TILE_EXTENSION: {
                        "uri": f"t/{number}.onnx",
                        "contract": "1.0",
                        "sha256": hashlib.sha256(model).hexdigest(),
                        "inputs": list(roles),
                        "splats_max": splats_max,
                        **({"time_range": [0, 1]} if "time" in roles else {}),
                    }
                },
            }
        )
    (folder / "t" / "root.glb").write_bytes(write_content(join_splats(coarse), np.zeros(3)).data)
    reach = SPACING * len(models)
    root = {
        "boundingVolume": {"box": [reach / 2, 0, 0, reach, 0, 0, 0, 8, 0, 0, 0, 8]},
        "geometricError": 10,
        "refine": "REPLACE",
        "content": {"uri": "t/root.glb"},
        "children": leaves,
    }
    document = {
        "asset": {"version": "1.1"},
        "extensionsUsed": [NEURAL_TILE_EXTENSION],
        "geometricError": 100,
        "root": root,
    }
    path = folder / "tileset.json"
    path.write_text(json.dumps(document))
    return path


def generated(model: bytes, matrix: np.ndarray, values: dict[str, np.ndarray]) -> SplatSet:
    """What a generator gives for some inputs, as a splat set that the renderer transforms."""
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    outputs = dict(
        zip([o.name for o in session.get_outputs()], session.run(None, values), strict=True)
    )
    rows = next(array for array in outputs.values() if array.ndim == 2 and array.shape[1] == 10)
    colors = next(array for array in outputs.values() if array.ndim == 2 and array.shape[1] != 10)
    space = "sh" if colors.shape[1] > 4 else "rgb"
    return SplatSet(SplatData(rows, colors, space), matrix)
