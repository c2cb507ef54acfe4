"""Properties and comments of PLY files with which methods change what their splats mean."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import (
    FormatWarning,
    NotSupported,
    Splats,
    read_ply,
    write_compressed_ply,
    write_ply,
)
from support.splat_files import assert_near, opacity, scene


def with_columns(file: Path, splats: Splats, columns: dict[str, np.ndarray]) -> None:
    """Write a PLY file with further columns."""
    write_ply(file, splats)
    head, end, body = file.read_bytes().partition(b"end_header\n")
    rows = np.frombuffer(body, "<f4").reshape(len(splats), -1)
    extra = np.column_stack([column.astype("<f4") for column in columns.values()])
    lines = "".join(f"property float {name}\n" for name in columns).encode()
    file.write_bytes(head + lines + end + np.hstack([rows, extra]).astype("<f4").tobytes())


def test_the_filter_of_mip_splatting_is_applied(tmp_path):
    splats = scene(50, 1)
    size = np.random.default_rng(1).uniform(0, 0.05, 50).astype(np.float32)
    size[:3] = 0
    with_columns(tmp_path / "a.ply", splats, {"filter_3D": size})
    restored = read_ply(tmp_path / "a.ply")
    assert isinstance(restored, Splats)
    assert restored.antialiased
    variance = np.exp(splats.log_scale.astype(float)) ** 2
    filtered_variance = variance + size[:, None].astype(float) ** 2
    np.testing.assert_allclose(
        np.exp(restored.log_scale.astype(float)) ** 2, filtered_variance, rtol=2e-5
    )
    expected = opacity(splats) * np.sqrt(variance.prod(axis=1) / filtered_variance.prod(axis=1))
    np.testing.assert_allclose(opacity(restored), expected, rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(restored.logit_opacity[:3], splats.logit_opacity[:3])
    np.testing.assert_array_equal(restored.log_scale[:3], splats.log_scale[:3])


@pytest.mark.parametrize(
    ("names", "method"),
    [
        (("trbf_center", "trbf_scale", "motion_0", "omega_0"), "SpacetimeGaussians"),
        (("binding_0",), "GaussianAvatars"),
    ],
)
def test_splats_that_move_are_not_drawn_still(tmp_path, names, method):
    with_columns(tmp_path / "a.ply", scene(3, 0), {name: np.zeros(3) for name in names})
    with pytest.raises(NotSupported) as caught:
        read_ply(tmp_path / "a.ply")
    assert f"{', '.join(names)}: splats of {method}" in str(caught.value)
    assert "plugin" in caught.value.hint or "gsgen export" in caught.value.hint


def test_other_properties_are_named(tmp_path):
    columns = {"nx": np.zeros(3), "confidence": np.ones(3), "label": np.ones(3)}
    with_columns(tmp_path / "a.ply", scene(3, 0), columns)
    with pytest.warns(FormatWarning, match="not used: properties confidence, label$"):
        assert_near(read_ply(tmp_path / "a.ply"), scene(3, 0))


@pytest.mark.parametrize("write", [write_ply, write_compressed_ply])
@pytest.mark.parametrize("antialiased", [True, False])
def test_antialiased_splats_stay_so(tmp_path, write, antialiased):
    write(tmp_path / "a.ply", scene(300, 1, antialiased=antialiased))
    assert (b"comment SplatRenderMode: mip" in (tmp_path / "a.ply").read_bytes()) is antialiased
    restored = read_ply(tmp_path / "a.ply")
    assert isinstance(restored, Splats)
    assert restored.antialiased is antialiased


@pytest.mark.parametrize(
    ("comments", "antialiased"),
    [
        (("SplatRenderMode: mip",), True),
        (("  SPLATRENDERMODE:  MIP  ",), True),
        (("antialiased 1",), True),
        (("antialiased 0",), False),
        (("SplatRenderMode: default",), False),
        (("SplatRenderMode: banana",), False),
        (("antialiased 1", "SplatRenderMode: default"), False),
        (("SplatRenderMode: default", "antialiased 1"), True),
        (("made by antialiased 1",), False),
    ],
)
def test_comments_of_other_programs_are_understood(tmp_path, comments, antialiased):
    write_ply(tmp_path / "a.ply", scene(3, 0))
    lines = "".join(f"comment {comment}\n" for comment in comments).encode()
    content = (tmp_path / "a.ply").read_bytes().replace(b"element", lines + b"element", 1)
    (tmp_path / "a.ply").write_bytes(content)
    restored = read_ply(tmp_path / "a.ply")
    assert isinstance(restored, Splats)
    assert restored.antialiased is antialiased
