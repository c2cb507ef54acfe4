"""Cameras and sets of Gaussians as harness.js takes them."""

from typing import Any

import numpy as np

from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import SplatSet
from support.web.pages import packed


def camera_of(camera: Camera) -> dict[str, Any]:
    names = ("fx", "fy", "cx", "cy", "width", "height", "near", "kind")
    values = {name: getattr(camera, name) for name in names}
    if camera.distortion is not None:
        values["distortion"] = camera.distortion.to_dict()
    return {"view": camera.view.ravel().tolist(), **values}


def set_of(splat_set: SplatSet) -> dict[str, Any]:
    data, clip = splat_set.data, splat_set.clip
    degree = data.degree
    if degree is not None and splat_set.degree is not None:
        degree = min(degree, splat_set.degree)
    return {
        "splats": {
            "rows": packed(data.rows.astype(np.float32)),
            "appearance": packed(data.appearance),
            "half": data.appearance.dtype == np.float16,
            "channels": data.appearance.shape[1],
            "space": data.space,
            "count": data.count,
            "capacity": len(data.rows),
        },
        "transform": splat_set.transform.ravel().tolist(),
        "opacityScale": splat_set.opacity_scale,
        "antialias": splat_set.antialias,
        "degree": degree,
        "clip": clip and {"low": list(clip.low), "high": list(clip.high)},
    }
