"""2DGS: a PLY with two scales, against discs in float64."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.spec import layout
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.static import surfels_plugin as plugin
from gsgen.reference_plugins.static.surfels import read_surfels
from gsgen.reference_plugins.synthetic import write_surfels
from gsgen.reference_plugins.writing.run_files import write_columns
from gsgen.sdk.exporting.constant_generator import export_constant
from support.checkpoints.plugin_checks import run
from support.checkpoints.spacetime_oracles import raw_columns


def discs(columns: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return covariances s₁² u uᵀ + s₂² v vᵀ and normals u × v, in float64."""
    w, x, y, z = (columns[f"rot_{index}"].astype(float) for index in range(4))
    square = w * w + x * x + y * y + z * z
    # The axes q e q̄ / |q|² of the disc, by products of quaternions.
    u = np.stack([w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)
    v = np.stack([2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)], axis=1)
    u, v = u / square[:, None], v / square[:, None]
    sizes = [np.exp(2 * columns[f"scale_{index}"].astype(float)) for index in range(2)]
    pairs = zip(sizes, (u, v), strict=True)
    covariance = sum(size[:, None, None] * axis[:, :, None] * axis[:, None] for size, axis in pairs)
    return np.asarray(covariance), np.cross(u, v)


@pytest.mark.parametrize("degree", [0, 2, 3])
@pytest.mark.parametrize("seed", range(2))
def test_gaussians_are_the_discs_of_the_method(seed: int, degree: int, tmp_path: Path) -> None:
    folder = write_surfels(tmp_path / "run", count=37, degree=degree, seed=seed)
    path, settings = tmp_path / "out.onnx", Settings(level=Level.STATIC)
    exported = export_constant(plugin.build(folder), path, settings=settings)
    assert exported.report.verdict == "conforms"
    rows, color = run(path, {})[:2]
    columns = raw_columns(read_surfels(folder).cloud)
    covariance, normal = discs(columns)
    upper = covariance[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    trace = np.trace(covariance, axis1=1, axis2=2)
    assert (np.abs(rows[:, 4:] - upper).max(axis=1) <= 1e-6 * trace).all()
    matrix = rows[:, 4:][:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3).astype(float)
    normal_variance = np.einsum("ni,nij,nj->n", normal, matrix, normal)
    assert (np.abs(normal_variance) <= 1e-6 * trace).all()  # a disc has no thickness
    np.testing.assert_array_equal(rows[:, :3], np.stack([columns[a] for a in "xyz"], axis=1))
    opacity = 1 / (1 + np.exp(-columns["opacity"].astype(float)))
    np.testing.assert_allclose(rows[:, 3], opacity, atol=1e-6)
    count = (degree + 1) ** 2
    sh = np.stack([columns[f"f_dc_{index}"] for index in range(3)], axis=1)
    np.testing.assert_array_equal(color[:, :3], sh)
    for channel in range(3):  # the file lists all coefficients of red first
        for k in range(1, count):
            stored = columns[f"f_rest_{channel * (count - 1) + k - 1}"]
            np.testing.assert_array_equal(color[:, 3 * k + channel], stored)
    assert layout.decode(rows, color, "sh").position.shape == (37, 3)


def test_a_file_of_another_kind_is_named(tmp_path: Path) -> None:
    cloud = read_surfels(write_surfels(tmp_path / "run", count=5)).cloud
    columns = raw_columns(cloud)
    write_columns(tmp_path / "discs.ply", columns)
    assert len(read_surfels(tmp_path / "discs.ply").splats) == 5
    write_columns(tmp_path / "full.ply", columns | {"scale_2": columns["scale_0"]})
    with pytest.raises(CheckpointInvalid, match="three scales") as caught:
        read_surfels(tmp_path / "full.ply")
    assert "gsgen export static" in caught.value.hint
    write_columns(tmp_path / "one.ply", {k: v for k, v in columns.items() if k != "scale_1"})
    with pytest.raises(CheckpointInvalid, match="scale_1 are missing"):
        read_surfels(tmp_path / "one.ply")
    cloud.unlink()
    with pytest.raises(CheckpointInvalid, match="is missing: the flat Gaussians"):
        read_surfels(tmp_path / "run")
