"""Draw the pictures of rules that see a wrong picture, into docs/assets/rules.

The left half of each picture is a right scene, the right half the fixture that breaks the rule;
both are drawn by the renderer itself. Rules whose fault one still picture hardly shows have none.
Run it after a change to such a fixture, with the rules to draw, or all of them without any:
.venv/bin/python scripts/draw_rule_pictures.py [RULE…]
"""

import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import onnxruntime
from convention_pictures.mistakes import draw_mistakes
from convention_pictures.sketch import beside, drawn
from draw_conventions import COLORS
from PIL import Image
from scipy.spatial.transform import Rotation

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.scenes import Kind, pack, photographed, scene
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData

ASSETS = Path(__file__).parents[1] / "docs" / "assets" / "rules"
SIZE = 240

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
}

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


def _camera_around(rows: np.ndarray) -> Camera:
    low, high = rows[:, :3].min(axis=0), rows[:, :3].max(axis=0)
    middle, radius = (low + high) / 2, 1.1 * float(np.linalg.norm(high - low))
    return Camera.orbit(
        middle.tolist(), radius, azimuth=30.0, elevation=20.0, width=SIZE, height=SIZE
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


def main(rules: list[str]) -> None:
    """Draw the documentation pictures of the given rules, or of all rules if none is given."""
    ASSETS.mkdir(parents=True, exist_ok=True)
    renderer = Renderer(rasteriser="tiles")
    for rule in rules or (*PICTURES, *DRIVEN):
        if rule in DRIVEN:
            halves = _driven(renderer, DRIVEN[rule])
        else:
            fixture, kind, count, degree = PICTURES[rule]
            right = photographed(pack(scene(kind, count), degree))
            halves = [_drawn(renderer, spec) for spec in (right, find(fixture).draw())]
        palette = beside(halves).quantize(COLORS, dither=Image.Dither.NONE)
        palette.save(ASSETS / f"{rule}.png", optimize=True)
    if not rules:
        draw_mistakes(renderer, ASSETS.with_name("mistakes"))


if __name__ == "__main__":
    main(sys.argv[1:])
