"""Invalid example models, each of which breaks one validation rule about drawn frames."""

__all__ = ["render_fixtures", "with_reference"]

import hashlib
import sys
from dataclasses import replace

import numpy as np

from gsgen.conformance.fixtures import Fixture
from gsgen.conformance.fixtures.builders.arrays import f32
from gsgen.conformance.fixtures.builders.clouds import still
from gsgen.conformance.fixtures.builders.fixture import fixtures_in, invalid
from gsgen.conformance.fixtures.builders.moving import drifting_model
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.layout import COVARIANCE
from gsgen.contract.spec.manifest import ReferenceImage
from gsgen.contract.spec.severity import Level


def render_fixtures() -> list[Fixture]:
    """Return invalid example models, one for each validation rule of level ``render``."""
    return fixtures_in(sys.modules[__name__])


@invalid("GB018", level=Level.RENDER)
def too_fine_to_be_seen() -> ModelSpec:
    """Fixture: a model of Gaussians so thin that antialiasing makes all of them invisible."""
    small_splats = still()
    rows = np.array(small_splats.weights["rows"])
    rows[:, COVARIANCE] *= 1e-9
    return small_splats.with_weights(rows=rows).with_manifest(antialias="mip")


@invalid("GB019", level=Level.RENDER)
def invisible_at_start() -> ModelSpec:
    """Fixture: ONNX generator whose Gaussians are invisibly small at time 0 and grow with time."""
    growing_model = drifting_model().replace_text(
        "gaussians = Concat <axis = 1> (moved, opacity, spread)",
        "size = Max (time, least) wide = Mul (spread, size) "
        "gaussians = Concat <axis = 1> (moved, opacity, wide)",
    )
    return growing_model.with_weights(least=f32(1e-9)).with_manifest(antialias="mip")


@invalid("GB020", level=Level.RENDER)
def opaque_behind_opaque() -> ModelSpec:
    """Fixture: two huge opaque Gaussians, black before white; two rasterisers disagree on them."""
    splat_sheets = still(2)
    rows, colors = (np.array(splat_sheets.weights[name]) for name in ("rows", "colors"))
    rows[:, :3], rows[:, 3] = (0.0, 0.0, 0.0), 1.0
    rows[:, COVARIANCE] = 0.0
    rows[:, [4, 7, 9]] = 30.0**2
    colors[0], colors[1] = -1.7, 1.7
    return splat_sheets.with_weights(rows=rows, colors=colors)


@invalid("GB021", level=Level.RENDER)
def unlike_reference_image() -> ModelSpec:
    """Fixture: a model whose reference image is red, unlike the picture that the model draws."""
    from gsgen.runtime.media.pictures import png_of

    red_image = np.zeros((36, 64, 3), np.uint8)
    red_image[..., 0] = 255
    return with_reference(still(), png_of(red_image))


def with_reference(spec: ModelSpec, png: bytes, **changes: object) -> ModelSpec:
    """Return a model with a reference image of 64×36 pixels, from four units away."""
    camera_pose = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 4.0))
    reference = ReferenceImage(
        path="reference.png",
        sha256=hashlib.sha256(png).hexdigest(),
        inputs="no inputs",
        view=camera_pose,
        focal=(50.0, 50.0),
        center=(32.0, 18.0),
    )
    declared = replace(reference, **changes)  # type: ignore[arg-type]
    model_with_file = replace(spec, extra_files={"reference.png": png})
    return model_with_file.with_manifest(reference_images=(declared,))
