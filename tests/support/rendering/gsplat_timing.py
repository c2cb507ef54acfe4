"""Times gsplat's CUDA rasteriser. Written by its documentation; no GPU has run it so far."""

from typing import Any

import numpy as np

from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.splat_data import SplatData


def gsplat_milliseconds(
    data: SplatData, camera: Camera, warm_frames: int, frames: int
) -> dict[str, Any]:
    """Return the milliseconds of gsplat's CUDA rasteriser, or why there are none."""
    try:
        import gsplat
        import torch
    except ImportError as error:
        return {"not measured": str(error)}
    if not torch.cuda.is_available():
        return {"not measured": "torch finds no CUDA device"}
    rows, n = torch.from_numpy(np.ascontiguousarray(data.rows)).cuda(), len(data)
    upper = rows[:, 4:]
    scene = {
        "means": rows[:, :3].contiguous(),
        "quats": torch.zeros(n, 4, device="cuda"),
        "scales": torch.zeros(n, 3, device="cuda"),
        "opacities": rows[:, 3].contiguous(),
        "colors": torch.from_numpy(data.appearance).cuda().reshape(n, -1, 3),
        "covars": upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(n, 3, 3).contiguous(),
        "viewmats": torch.from_numpy(camera.view[None].astype(np.float32)).cuda(),
        "Ks": torch.tensor(
            [[[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]], device="cuda"
        ),
        "sh_degree": data.degree,
        "width": camera.width,
        "height": camera.height,
    }
    milliseconds = []
    for number in range(frames + warm_frames):
        start_time, ended = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        start_time.record()
        with torch.no_grad():
            gsplat.rasterization(**scene)
        ended.record()
        torch.cuda.synchronize()
        if number >= warm_frames:
            milliseconds.append(start_time.elapsed_time(ended))
    return {
        "version": gsplat.__version__,
        "p50": float(np.median(milliseconds)),
        "p95": float(np.percentile(milliseconds, 95)),
    }
