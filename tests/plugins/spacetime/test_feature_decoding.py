"""The full model of SpacetimeGaussians, exactly: passes of features, and their decoder."""

import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.spacetime import spacetime_gaussians_plugin as plugin
from gsgen.reference_plugins.spacetime.feature_decoding import (
    FeaturePasses,
    FeatureScale,
    PixelDecoder,
)
from gsgen.reference_plugins.spacetime.spacetime_checkpoint import (
    SpacetimeCheckpoint,
    read_spacetime,
)
from gsgen.reference_plugins.synthetic import write_spacetime
from gsgen.runtime import Camera, GeneratorPlayer, PostProcessor, Scene, SplatData, SplatSet
from gsgen.runtime.oracle.render import render
from gsgen.sdk import export, export_post_process
from support.checkpoints.plugin_checks import ALLOWED, MARGIN, eager, run
from support.commands import gsgen_here, shared
from support.reports.pages import DOCS

SIZE = (12, 16)
PAGE = (DOCS / "plugins/spacetime-gaussians.md").read_text("utf-8")
BLOCKS = dict(
    re.findall(r"^<!-- test: (\S+) -->\n```\w+\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
)
EXAMPLE: dict[str, Any] = {"__name__": "decode"}
exec(BLOCKS["program"], EXAMPLE)


def moment(value: float) -> np.ndarray:
    return np.array([value], np.float32)


def test_passes_are_the_features_of_the_method() -> None:
    case = shared("data/checkpoints/stg_full")
    read = read_spacetime(case / "ckpt")
    golden = np.load(case / "golden.npz")
    generator, scale = FeaturePasses(read.splats), FeatureScale.of(read.splats)
    for frame, time in enumerate(golden["in_time"]):
        passes = [eager(generator, moment(time), moment(index))[1] for index in range(3)]
        scaled = np.concatenate(passes, axis=1)
        assert scaled.min() >= 0
        assert scaled.max() <= 1
        features = scale.low.numpy() + scale.width.numpy() * scaled
        expected = golden[f"out{frame}_features"]
        error = np.abs(features - expected).max() / np.abs(expected).max()
        assert error <= ALLOWED["color"] / MARGIN


@pytest.mark.parametrize("frame", [0, 3])
def test_the_exported_decoder_gives_the_pixels_of_the_method(frame: int, tmp_path: Path) -> None:
    case = shared("data/checkpoints/stg_full")
    golden = np.load(case / "golden.npz")
    features, rays, expected = (golden[f"pp{frame}_{name}"] for name in ("features", "rays", "rgb"))
    model = plugin.build(case / "ckpt", decode="decoder", size="40x30")
    assert isinstance(model, PixelDecoder)
    settings = Settings(level=Level.STATIC)
    path = export_post_process(model, tmp_path / "decoder.onnx", settings=settings).path
    scale = FeatureScale.of(read_spacetime(case / "ckpt").splats)
    scaled = (features.transpose(1, 2, 0) - scale.low.numpy()) / scale.width.numpy()
    opaque = np.concatenate([scaled[..., :3], np.ones((30, 40, 1))], axis=2)
    known = np.concatenate([scaled[..., 3:], rays[3:].transpose(1, 2, 0)], axis=2)
    values = {
        "image": opaque.transpose(2, 0, 1)[None].astype(np.float32),
        "conditioning": known.reshape(1, -1, 9).astype(np.float32),
        "origin": rays[:3, 0, 0].reshape(1, 1, 3),
    }
    (decoded,) = run(path, values)
    np.testing.assert_allclose(decoded[0, :3], expected, atol=2e-6)
    assert (decoded[0, 3] == 1).all()


def test_rays_go_through_the_middle_of_pixels() -> None:
    golden = np.load(shared("data/checkpoints/stg_full/golden.npz"))
    for frame in (0, 3):
        width, height = golden["in_size"][frame]
        focal = np.array([width, height]) / (2 * np.tan(golden["in_FoV"][frame] / 2))
        view = golden["in_world_view_transform"][frame].T.astype(float)
        rays = EXAMPLE["rays"](
            Camera(
                view,
                fx=focal[0],
                fy=focal[1],
                cx=width / 2,
                cy=height / 2,
                width=width,
                height=height,
            )
        )
        expected = golden[f"pp{frame}_rays"][3:].transpose(1, 2, 0)
        np.testing.assert_allclose(rays, expected, atol=2e-6)


@pytest.mark.parametrize("seed", range(3))
def test_drawn_passes_are_decoded_like_nine_blended_features(seed: int, tmp_path: Path) -> None:
    read = read_spacetime(write_spacetime(tmp_path, count=24, full=True, seed=seed))
    assert read.decoder is not None
    read.splats.features[:, 4] = 0.0  # a feature that is zero everywhere
    camera = Camera.look_at((0.5, -2.0, 3.5), (0, 0, 0), width=SIZE[1], height=SIZE[0])
    generator, time = FeaturePasses(read.splats), moment(0.3)
    drawn = []
    for index in range(3):
        rows, color = eager(generator, time, moment(index))
        drawn.append(render(Scene([SplatSet(SplatData(rows, color, "rgb"))]), camera).rgba)
    assert (drawn[0][..., 3] == 0).any()
    assert (drawn[0][..., 3] > 0.5).any()
    alpha = drawn[0][..., 3:]
    image = np.concatenate([drawn[0][..., :3] / np.where(alpha > 0, alpha, 1), alpha], axis=2)
    decoder = PixelDecoder(read.decoder, FeatureScale.of(read.splats), SIZE)
    with torch.no_grad():
        decoded = decoder(
            torch.from_numpy(image.transpose(2, 0, 1)[None].astype(np.float32)),
            *map(torch.from_numpy, EXAMPLE["decoder_values"](drawn[1:], camera).values()),
        )
    expected = _decoded_in_float64(read, rows, float(time[0]), camera)
    np.testing.assert_allclose(decoded[0, :3].numpy().transpose(1, 2, 0), expected, atol=2e-6)


def _decoded_in_float64(
    read: SpacetimeCheckpoint, rows: np.ndarray, time: float, camera: Camera
) -> np.ndarray:
    """Blend the nine features as they are, and decode each pixel in float64."""
    assert read.decoder is not None
    raw = read.splats.features.double().numpy()
    raw[:, 6:] *= time - read.splats.temporal_centre.double().numpy()
    blended, rays = _weights(rows, camera) @ raw, EXAMPLE["rays"](camera)
    hidden, color = (part.double().numpy() for part in (read.decoder.hidden, read.decoder.color))
    image = np.zeros((camera.height, camera.width, 3))
    for y, x in np.ndindex(*image.shape[:2]):
        entries = np.concatenate([blended[y, x, 3:], camera.eye, rays[y, x]])
        total = blended[y, x, :3] + color @ np.maximum(hidden @ entries, 0)
        image[y, x] = 1 / (1 + np.exp(-total))
    return image


def _weights(rows: np.ndarray, camera: Camera) -> np.ndarray:
    """Return each Gaussian's share of each pixel, by colours that are 1 for one Gaussian."""
    count = len(rows)
    shares = np.zeros((camera.height, camera.width, count))
    for first in range(0, count, 3):
        color = np.zeros((count, 3), np.float32)
        color[np.arange(first, first + 3), np.arange(3)] = 1
        drawn = render(Scene([SplatSet(SplatData(rows, color, "rgb"))]), camera)
        shares[..., first : first + 3] = drawn.rgba[..., :3]
    return shares


@pytest.mark.slow
def test_the_page_exports_both_models_and_draws_with_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_spacetime(tmp_path / "DIR", count=30, full=True)
    monkeypatch.chdir(tmp_path)
    for line in BLOCKS["commands"].splitlines():
        completed = gsgen_here(*shlex.split(line)[1:])
        assert completed.code == 0, completed.err
    exec(BLOCKS["program"], {"__name__": "__main__"})
    camera = Camera.orbit((0, 0, 0), 4, width=32, height=24)
    with GeneratorPlayer("features.onnx") as player, PostProcessor(Path("decoder.onnx")) as post:
        frame = EXAMPLE["decoded"](player, post, camera, 0.5)
    read = read_spacetime(tmp_path / "DIR")
    rows = eager(FeaturePasses(read.splats), moment(0.5), moment(0))[0]
    expected = _decoded_in_float64(read, rows, 0.5, camera)
    np.testing.assert_allclose(frame.rgba[..., :3], expected, atol=2e-3)  # GPU thresholds
    assert np.median(np.abs(frame.rgba[..., :3] - expected)) <= 1e-5


@pytest.mark.slow
def test_the_passes_are_exported_in_half_precision(tmp_path: Path) -> None:
    run_folder = write_spacetime(tmp_path / "run", count=30, full=True)
    model = plugin.build(run_folder, decode="features")
    settings = Settings(level=Level.STATIC)
    exported = export(model, tmp_path / "half.onnx", dtype="float16", settings=settings)
    assert exported.report.verdict == "conforms"
    assert [entry.role for entry in exported.manifest.inputs] == ["time", "control"]


def test_a_decoder_needs_a_size(tmp_path: Path) -> None:
    run_folder = write_spacetime(tmp_path, count=3, full=True)
    with pytest.raises(ConfigInvalid, match="'any' is not an image size for --decode decoder"):
        plugin.build(run_folder, decode="decoder", size="any")
