"""Splat files that a page reads, beside what Python reads."""

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import Splats, open_splats, write_ply, write_sog, write_spz
from gsgen.formats.glb.nodes import transform_splats
from gsgen.runtime.scene.splat_data import SplatData
from support.web.pages import WebSite, unpacked

pytestmark = pytest.mark.slow


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
    expected = SplatData.from_splats(transform_splats(content, transform))
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


@pytest.mark.parametrize("degree", range(4))
def test_a_sog_is_read_as_python_reads_it(degree: int, site: WebSite, tmp_path: Path) -> None:
    """A byte that the browser's decoder changed would be another number of a codebook."""
    path = tmp_path / f"degree-{degree}.sog"
    splats = random_splats(degree)
    # Colours of pixels whose alpha is 0 or 1 survive only where nothing is multiplied by alpha.
    splats.logit_opacity[:40] = np.repeat([-9, -5.5], 20)
    write_sog(path, splats)
    same_as_python(site, path)


def test_a_sog_of_deflated_files_is_read(site: WebSite, tmp_path: Path) -> None:
    write_sog(tmp_path / "stored.sog", random_splats(1))
    path = tmp_path / "deflated.sog"
    stored = zipfile.ZipFile(tmp_path / "stored.sog")
    with stored, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in stored.namelist():
            archive.writestr(name, stored.read(name))
    same_as_python(site, path)


_GROUPS = {name: {"files": ["a.webp"]} for name in ("means", "scales", "quats", "sh0")}


def sog_of(**changes: object) -> bytes:
    """Return a zip archive that holds nothing but a meta.json."""
    stream = io.BytesIO()
    meta = {"version": 2, "count": 1, **changes}
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("meta.json", json.dumps(meta))
    return stream.getvalue()


def header(*lines: str) -> bytes:
    return "\n".join(["ply", *lines, "end_header", ""]).encode()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"glTF----", "is neither PLY nor SPZ nor SOG"),
        (b"", "is neither PLY nor SPZ nor SOG"),
        (b"\x1f\x8bnothing", "cannot be unpacked"),
        (b"NGSP", "ends within the header"),
        (b"PK\x03\x04" + bytes(40), "zip archive without a directory"),
        (sog_of(version=1), "version 1 of SOG"),
        (sog_of(**_GROUPS), "has no file a.webp"),
        (sog_of()[:-6] + b"\xff\xff\xff\x0f\0\0", "cannot be read"),
        (sog_of(means=3), "cannot be read"),
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
