"""Pictures of 16 and 32 bits: read back by the format's own library, and compared with floats."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.spec.srgb import linear_of_srgb, srgb_of_linear
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.media import deep_pictures
from gsgen.runtime.media.deep_pictures import exr_channels, picture16_of, save_exr, save_png16
from gsgen.runtime.media.pictures import picture_of
from gsgen.runtime.scene.frame import Frame

OpenEXR = pytest.importorskip("OpenEXR")
png = pytest.importorskip("png")


def frame(height: int, width: int, seed: int, space: str = "srgb") -> Frame:
    rng = np.random.default_rng(seed)
    alpha = rng.random((height, width), np.float32)
    alpha[0] = 0  # nothing was drawn
    color = rng.uniform(0, 1.3, (height, width, 3)).astype(np.float32) * alpha[..., None]
    depth = rng.uniform(1, 9, (height, width)).astype(np.float32)
    depth[alpha == 0] = np.inf
    normal = rng.normal(size=(height, width, 3)).astype(np.float32)
    return Frame(
        rgba=np.concatenate([color, alpha[..., None]], axis=-1),
        alpha=alpha,
        depth=depth,
        median_depth=depth,
        ids=np.zeros((height, width), np.int64),
        normal=normal / np.linalg.norm(normal, axis=-1, keepdims=True),
        visible=1,
        pairs=1,
        color_space=space,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize(("height", "width"), [(1, 1), (2, 7), (13, 5)])
@pytest.mark.parametrize("space", ["srgb", "linear"])
def test_exr_has_linear_light_multiplied_by_alpha(
    height: int, width: int, space: str, tmp_path: Path
) -> None:
    drawn = frame(height, width, height * width, space)
    save_exr(tmp_path / "a.exr", drawn, "color")
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        pixels = file.channels()["RGBA"].pixels
    assert pixels.dtype == np.float32
    assert drawn.rgba is not None
    rgba = drawn.rgba.astype(np.float64)
    alpha = rgba[..., 3:]
    straight_color = np.clip(rgba[..., :3] / np.where(alpha > 0, alpha, 1), 0, 1)
    if space == "srgb":  # IEC 61966-2-1, written down again
        straight_color = np.where(
            straight_color <= 0.04045,
            straight_color / 12.92,
            ((straight_color + 0.055) / 1.055) ** 2.4,
        )
    np.testing.assert_allclose(pixels[..., :3], straight_color * alpha, atol=2e-6)
    np.testing.assert_array_equal(pixels[..., 3:], np.float32(alpha))


def test_exr_keeps_depths_and_normals_exactly(tmp_path: Path) -> None:
    drawn = frame(6, 9, 3)
    for mode, names in (("depth", ["Z"]), ("normal", ["N.X", "N.Y", "N.Z"]), ("alpha", ["A"])):
        save_exr(tmp_path / "a.exr", drawn, mode)  # type: ignore[arg-type]
        with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
        assert sorted(channels) == names
        expected = {"depth": drawn.depth, "normal": drawn.normal, "alpha": drawn.alpha}[mode]
        assert expected is not None
        stacked = np.stack([channels[name] for name in names], axis=-1)
        np.testing.assert_array_equal(stacked.reshape(expected.shape), expected)


@pytest.mark.parametrize("mode", ["color", "depth", "normal", "alpha"])
def test_png_of_16_bits_reads_back_and_rounds_to_that_of_8(mode: str, tmp_path: Path) -> None:
    drawn = frame(11, 4, 5)
    picture = picture16_of(drawn, mode)  # type: ignore[arg-type]
    save_png16(tmp_path / "a.png", picture)
    width, height, rows, info = png.Reader(bytes=(tmp_path / "a.png").read_bytes()).read()
    assert (width, height, info["bitdepth"]) == (4, 11, 16)
    values = np.vstack([np.asarray(row, np.uint16) for row in rows]).reshape(picture.shape)
    np.testing.assert_array_equal(values, picture)
    eight_bit = picture_of(drawn, mode).astype(float)  # type: ignore[arg-type]
    assert np.abs(values / 257 - eight_bit).max() <= 0.5 + 1 / 257


def test_srgb_and_linear_light_round_trip() -> None:
    color = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(srgb_of_linear(linear_of_srgb(color)), color, atol=2e-6)


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(deep_pictures, "import_module", absent)
    with pytest.raises(SceneInvalid, match=r"gsgen\[deep\]"):
        save_exr(tmp_path / "a.exr", frame(2, 2, 0), "color")
    assert list(tmp_path.iterdir()) == []
    assert "RGBA" in exr_channels(frame(2, 2, 0), "color")
