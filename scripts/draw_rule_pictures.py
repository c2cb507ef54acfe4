"""Draw the pictures of rules that see a wrong picture, into docs/assets/rules.

The left half of each picture is a right scene, the right half the fixture that breaks the rule;
both are drawn by the renderer itself. A rule of motion has a strip of frames: the upper row is
right, the lower one wrong.
Run it after a change to such a fixture, with the rules to draw, or all of them without any:
.venv/bin/python scripts/draw_rule_pictures.py [RULE…]
"""

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import onnxruntime
from convention_pictures.mistakes import draw_mistakes
from convention_pictures.sketch import PAPER, beside, drawn
from draw_conventions import COLORS
from PIL import Image
from scipy.spatial.transform import Rotation

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.moving import drifting
from gsgen.conformance.fixtures.builders.scenes import Kind, pack, photographed, scene
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData

ASSETS = Path(__file__).parents[1] / "docs" / "assets" / "rules"
SIZE = 240
# Side of a frame of a strip, and the gap between its two rows, in pixels.
STRIP_SIZE, GAP = 160, 8

# Rule → the fixture that breaks it, the kind of the right scene, its rows and its SH degree.
PICTURES: dict[str, tuple[str, Kind, int, int | None]] = {
    "GV040": ("unsquared_scales", "surface", 160, 0),
    "GV041": ("quaternions_in_another_order", "surface", 160, 0),
    "GV042": ("rotation_left_out", "surface", 160, 0),
    "GV043": ("opacity_of_two_sigmoids", "cloud", 160, 0),
    "GV044": ("premultiplied_colors", "surface", 160, None),
    "GV045": ("rgb_as_constant_term", "surface", 160, 0),
    "GV046": ("colors_not_loaded", "surface", 160, 3),
    "GV047": ("colors_sorted_alone", "surface", 400, 1),
    "GV048": ("sh_as_in_ply", "surface", 160, 3),
    "GV049": ("positions_in_bfloat16", "surface", 1200, 0),
    "GV063": ("rgb_of_two_sigmoids", "surface", 160, None),
}
# Rule → how much smaller the Gaussians of its right scene are, as those of its fixture.
SHRUNK = {"GV049": 0.4}

_TURN = Rotation.from_rotvec([0.4, 1.1, 0.3]).as_matrix().astype(np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """Two fixture models with inputs, or one at two frames, for the picture of a rule.

    Attributes:
        right: The fixture on the left, and `wrong` that on the right.
        values: Their inputs by name, besides the view matrix, which the camera gives.
        wrong_values: The inputs of the wrong one, where they differ.
    """

    right: str
    wrong: str
    values: dict[str, np.ndarray] = field(default_factory=dict)
    wrong_values: dict[str, np.ndarray] = field(default_factory=dict)


def _frame(number: int) -> dict[str, np.ndarray]:
    return {"time": np.array([(number + 0.5) / 20], np.float32)}


DRIVEN = {
    "GB030": Driven(right="lit_from_the_camera", wrong="camera_taken_for_its_inverse"),
    "GB031": Driven(right="culls_what_lies_behind", wrong="culls_what_lies_ahead"),
    "GB035": Driven(
        right="person_turned_by_a_matrix", wrong="covariances_stay_at_rest", values={"turn": _TURN}
    ),
    "GB036": Driven(
        right="person_turned_by_a_matrix",
        wrong="pose_in_degrees",
        values={
            "turn": Rotation.from_rotvec([0, 0, 0.8]).as_matrix().astype(np.float32),
            "pose": np.array([[0, 0, 0.8]], np.float32),
        },
    ),
    "GB043": Driven(
        right="nan_in_one_frame", wrong="nan_in_one_frame", values=_frame(5), wrong_values=_frame(6)
    ),
    "GB044": Driven(
        right="opaque_beyond_one_in_a_frame",
        wrong="opaque_beyond_one_in_a_frame",
        values=_frame(5),
        wrong_values=_frame(6),
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Strip:
    """Four frames of a correct and of a wrong model, for the picture of a rule of motion.

    Attributes:
        right: Returns the correct model; `wrong` is the fixture that breaks the rule.
        values: The values of the input ``name`` in the four frames.
    """

    right: Callable[[], ModelSpec]
    wrong: str
    values: tuple[float, ...] = (0.0, 0.3, 0.6, 0.9)
    name: str = "time"
    dtype: str = "float32"


def _every_frame() -> ModelSpec:
    """Return the model whose frames differ, where the fixture's show two pictures."""
    spec = find("frames_divided_as_integers").draw()
    table = np.linspace(*spec.weights["table"], 24).astype(np.float32)
    return spec.weighing(table=table, rate=np.ones(1, np.int32))


STRIPS = {
    "GB032": Strip(right=lambda: drifting(40), wrong="time_moves_too_little"),
    "GB033": Strip(right=lambda: drifting(40), wrong="frames_fed_as_fractions"),
    "GB034": Strip(
        right=lambda: find("waves_thrice").draw(),
        wrong="time_in_degrees",
        values=(0.5, 0.51, 0.52, 0.53),
    ),
    "GB040": Strip(
        right=_every_frame,
        wrong="frames_divided_as_integers",
        values=(0, 4, 8, 11),
        name="frame",
        dtype="int32",
    ),
}


def _camera_around(rows: np.ndarray, size: int = SIZE) -> Camera:
    low, high = rows[:, :3].min(axis=0), rows[:, :3].max(axis=0)
    middle, radius = (low + high) / 2, 1.1 * float(np.linalg.norm(high - low))
    return Camera.orbit(
        middle.tolist(), radius, azimuth=30.0, elevation=20.0, width=size, height=size
    )


def _drawn(renderer: Renderer, spec: ModelSpec) -> Image.Image:
    """Draw a model without inputs."""
    assert isinstance(spec.manifest, GeneratorManifest)
    rows = spec.weights["rows"].astype(np.float32)
    splats = SplatData(
        rows, spec.weights["colors"].astype(np.float32), spec.manifest.outputs.appearance.space
    )
    return drawn(renderer, Scene([SplatSet(splats)]), _camera_around(rows))


def _driven(renderer: Renderer, pair: Driven) -> list[Image.Image]:
    """Draw a correct and a wrong model with inputs, from one camera around the correct model."""
    pictures, camera = [], None
    for name, values in ((pair.right, pair.values), (pair.wrong, pair.values | pair.wrong_values)):
        spec = find(name).draw()
        assert isinstance(spec.manifest, GeneratorManifest)
        outputs = spec.manifest.outputs
        if camera is None:
            camera = _camera_around(_run(spec, values, None)[outputs.gaussians.name])
        frame = _run(spec, values, camera)
        splats = SplatData(
            frame[outputs.gaussians.name], frame[outputs.appearance.name], outputs.appearance.space
        )
        pictures.append(drawn(renderer, Scene([SplatSet(splats)]), camera))
    return pictures


def _strip(renderer: Renderer, strip: Strip) -> list[Image.Image]:
    """Draw frames of a correct model and of a wrong one, side by side: two rows of pictures."""
    models = (strip.right(), find(strip.wrong).draw())
    fed = [{strip.name: np.array([value], strip.dtype)} for value in strip.values]
    assert isinstance(models[0].manifest, GeneratorManifest)
    outputs = models[0].manifest.outputs
    first = [_run(models[0], values, None)[outputs.gaussians.name] for values in fed]
    camera = _camera_around(np.concatenate(first), STRIP_SIZE)
    rows = []
    for spec in models:
        frames = [_run(spec, values, camera) for values in fed]
        scenes = [
            Scene([SplatSet(SplatData(*(frame[part.name] for part in parts), parts[1].space))])
            for frame in frames
            if (parts := (outputs.gaussians, outputs.appearance))
        ]
        rows.append(beside([drawn(renderer, scene, camera) for scene in scenes]))
    return rows


def _run(
    spec: ModelSpec, values: dict[str, np.ndarray], camera: Camera | None
) -> dict[str, np.ndarray]:
    """Run a model and return its outputs by name; without a camera, the view is the identity."""
    view = np.eye(4) if camera is None else np.asarray(camera.view)
    with tempfile.TemporaryDirectory() as folder:
        spec.write(Path(folder) / "model.onnx")
        session = onnxruntime.InferenceSession(str(Path(folder) / "model.onnx"))
    known = {**values, "view": view.T.astype(np.float32)}
    names = [entry.name for entry in session.get_outputs()]
    fed = {entry.name: known[entry.name] for entry in session.get_inputs()}
    return dict(zip(names, session.run(names, fed), strict=True))


def _save(picture: Image.Image, name: str) -> None:
    palette = picture.quantize(COLORS, dither=Image.Dither.NONE)
    palette.save(ASSETS / f"{name}.png", optimize=True)


def main(rules: list[str]) -> None:
    """Draw the documentation pictures of the given rules, or of all rules if none is given."""
    ASSETS.mkdir(parents=True, exist_ok=True)
    renderer = Renderer(rasteriser="tiles")
    for rule in rules or (*PICTURES, *DRIVEN, *STRIPS):
        if rule in STRIPS:
            upper, lower = _strip(renderer, STRIPS[rule])
            picture = Image.new("RGB", (upper.width, 2 * upper.height + GAP), PAPER)
            picture.paste(upper, (0, 0))
            picture.paste(lower, (0, upper.height + GAP))
            _save(picture, f"{rule}-frames")
            continue
        if rule in DRIVEN:
            halves = _driven(renderer, DRIVEN[rule])
        else:
            fixture, kind, count, degree = PICTURES[rule]
            parts = scene(kind, count)
            parts = replace(parts, scale=SHRUNK.get(rule, 1.0) * parts.scale)
            right = photographed(pack(parts, degree))
            halves = [_drawn(renderer, spec) for spec in (right, find(fixture).draw())]
        _save(beside(halves), rule)
    if not rules:
        draw_mistakes(renderer, ASSETS.with_name("mistakes"))


if __name__ == "__main__":
    main(sys.argv[1:])
