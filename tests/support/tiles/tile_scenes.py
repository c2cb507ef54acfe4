"""Random scenes for tests of building tilesets."""

import hashlib
from pathlib import Path

import numpy as np

from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.formats import Splats
from gsgen.formats.merging.mixture import Mixture


def mixture(rng: np.random.Generator, count: int, *, origin: float = 0.0) -> Mixture:
    scale = np.exp(rng.normal(-2, 1, (count, 3)))
    rotation = rng.normal(size=(count, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    turned = rotation_matrix(rotation) * scale[:, None, :]
    full = turned @ turned.transpose(0, 2, 1)
    rows, columns = np.triu_indices(3)
    return Mixture(
        code=np.sort(rng.integers(0, 1 << 63, count, dtype=np.uint64)),
        mean=rng.normal(size=(count, 3)) + origin,
        covariance=full[:, rows, columns],
        scale=scale,
        rotation=rotation.astype(np.float32),
        opacity=rng.uniform(0.01, 1, count),
        sh=rng.normal(size=(count, 4, 3)).astype(np.float32),
    )


def scattered(count: int, *, degree: int = 0, seed: int = 0, origin: float = 0.0) -> Splats:
    """A wavy sheet of splats, a few of them large, a few far away, a few doubled."""
    rng = np.random.default_rng(seed)
    position = rng.normal(size=(count, 3)) * [5, 0.05, 5]
    position[:, 1] += np.sin(position[:, 0])
    log_scale = rng.normal(-3.5, 0.5, (count, 3))
    large_rows = rng.choice(count, max(1, count // 500), replace=False)
    log_scale[large_rows] += 4
    position[rng.choice(count, max(1, count // 1000))] *= 40
    position[-5:] = position[:5]
    sh = rng.normal(size=(count, (degree + 1) ** 2, 3)) * 0.3
    return Splats(
        position=(position + origin).astype(np.float32),
        rotation=rng.normal(size=(count, 4)).astype(np.float32),
        log_scale=log_scale.astype(np.float32),
        logit_opacity=rng.normal(size=count).astype(np.float32),
        sh=sh.astype(np.float32),
    )


def digests(folder: Path) -> dict[str, str]:
    """The sha256 of every file in a folder."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
