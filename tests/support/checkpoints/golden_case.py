"""The picture that gsplat's CUDA rasteriser makes of four Gaussians."""

import json
from pathlib import Path

import numpy as np

from gsgen.contract.spec.geometry import covariance_upper
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.splat_data import SplatData


def read_safetensors(path: Path) -> dict[str, np.ndarray]:
    """Read float32 tensors: a length, a JSON header, then the bytes."""
    raw = path.read_bytes()
    start = 8 + int.from_bytes(raw[:8], "little")
    header = json.loads(raw[8:start])
    return {
        name: np.frombuffer(
            raw[start + entry["data_offsets"][0] : start + entry["data_offsets"][1]], np.float32
        ).reshape(entry["shape"])
        for name, entry in header.items()
        if name != "__metadata__"
    }


def golden_case(path: Path) -> tuple[SplatData, Camera, np.ndarray]:
    """Return the Gaussians, the camera and the image [82, 123, 4] of the golden file."""
    tensors = read_safetensors(path)
    opacity = 1 / (1 + np.exp(-tensors["opacities"].astype(np.float64)))
    scale = np.exp(tensors["scales"].astype(np.float64))
    columns = [tensors["means"], opacity[:, None], covariance_upper(scale, tensors["quats"])]
    rows = np.concatenate(columns, axis=1).astype(np.float32)
    image = tensors["out_img"]
    height, width = image.shape[:2]
    view = np.eye(4)
    view[:3, 3] = -0.123, -0.456, 8
    camera = Camera(
        view, fx=width / 2, fy=width / 2, cx=width / 2, cy=height / 2, width=width, height=height
    )
    return SplatData(rows, tensors["coeffs"].reshape(4, 48), "sh"), camera, image
