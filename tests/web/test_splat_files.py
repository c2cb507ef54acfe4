"""Splat files that a page reads, beside what Python reads."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import Splats, open_splats, write_ply, write_spz
from gsgen.formats.glb.nodes import moved
from gsgen.runtime.scene.splat_data import SplatData
from support.web.pages import WebSite, unpacked


def random_splats(degree: int, count: int = 200) -> Splats:
    rng = np.random.default_rng(degree)
    harmonics = rng.normal(size=(count, (degree + 1) ** 2, 3), scale=0.3)
    rotation = rng.normal(size=(count, 4))
    rotation[0] = 0, 0, 0, 2
    return Splats(
        position=rng.normal(size=(count, 3)).astype(np.float32),
        rotation=rotation.astype(np.float32),
        log_scale=rng.uniform(-6, 0, (count, 3)).astype(np.float32),
        logit_opacity=rng.normal(size=count, scale=3).astype(np.float32),
        sh=harmonics.astype(np.float32),
    )


def same_as_python(site: WebSite, path: Path) -> None:
    content = open_splats(path)
    assert isinstance(content, Splats)
    site.contents[f"/{path.name}"] = path.read_bytes()
    result = site.call("splatFile", f"/{path.name}")
    assert "error" not in result, result
    # Rows keep the axes of their file; the transform, its own inverse, leads to those of a camera.
    transform = np.array(result["transform"]).reshape(4, 4)
    np.testing.assert_array_equal(transform @ transform, np.eye(4))
    expected = SplatData.from_splats(moved(content, transform))
    assert result["count"] == len(expected)
    assert result["antialias"] == expected.antialias
    rows = unpacked(result["rows"], np.float32).reshape(-1, 10)
    appearance = unpacked(result["appearance"], np.float32).reshape(len(expected), -1)
    np.testing.assert_allclose(rows, expected.rows, rtol=2e-5, atol=1e-7)
    np.testing.assert_allclose(appearance, expected.appearance, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("degree", range(4))
def test_a_ply_is_read_as_python_reads_it(degree: int, site: WebSite, tmp_path: Path) -> None:
    path = tmp_path / f"degree-{degree}.ply"
    write_ply(path, random_splats(degree))
    same_as_python(site, path)


@pytest.mark.parametrize("version", [1, 2, 3])
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_an_spz_is_read_as_python_reads_it(
    degree: int, version: int, site: WebSite, tmp_path: Path
) -> None:
    path = tmp_path / f"v{version}-{degree}.spz"
    write_spz(path, random_splats(degree), version=version)
    same_as_python(site, path)


def header(*lines: str) -> bytes:
    return "\n".join(["ply", *lines, "end_header", ""]).encode()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"glTF----", "is neither PLY nor SPZ"),
        (b"", "is neither PLY nor SPZ"),
        (b"\x1f\x8bnothing", "cannot be unpacked"),
        (b"NGSP", "ends within the header"),
        (b"NGSP\x04" + bytes(40), "version 4 of SPZ"),
        (header("format ascii 1.0", "element vertex 1"), "is not binary_little_endian"),
        (
            header("format binary_little_endian 1.0", "element vertex 1", "property float x"),
            "ends after",
        ),
        (
            header("format binary_little_endian 1.0", "element vertex 1", "property float x")
            + bytes(4),
            "has no y, z, opacity",
        ),
    ],
)
def test_a_file_that_cannot_be_read_says_why(content: bytes, message: str, site: WebSite) -> None:
    site.contents["/wrong.bin"] = content
    result = site.call("splatFile", "/wrong.bin")
    assert message in result["error"]
    assert result["hint"]
