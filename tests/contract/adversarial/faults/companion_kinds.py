"""Faulty cells, post-process models and trajectory predictors."""

from functools import partial
from typing import Any

import numpy as np

from contract.adversarial.case import Draft, Sentence, fault
from contract.adversarial.companions import cell_model, post_process, trajectory
from contract.adversarial.scenes import scene

FAMILY = "companions"

CELLS: list[tuple[str, str, dict[str, Any], Sentence, str]] = [
    ("cells_per_cell_wrong", "Declares eight rows a cell where there are four.", {"per_cell": 8}, Sentence("manifest.md", "`per_cell` times the number of cells is the capacity."), r"per_cell|capacity|cells"),
    ("cells_without_weighted_sum_blend", "Exported cells and left the blend at alpha.", {"blend": "alpha"}, Sentence("manifest.md", "`cells` stands there if, and only if, `blend` is `wsr`"), r"blend|wsr|cells"),
    ("cells_visibility_in_bytes", "Left the visibility in 0…255.", {"visibility": 255.0}, Sentence("cells.md", "**visibility**: in [0, 1]."), r"255|byte|8.?bit"),
    ("cells_visibility_is_nan", "The visibility network divides zero by zero.", {"visibility": np.nan}, Sentence("cells.md", "All values of all cells are finite."), r"\bnan\b|finite"),
    ("cells_covariance_negative", "Stored the inverse sign of the cells' covariances.", {"covariance_factor": -1.0}, Sentence("layout.md", "Σ is symmetric and positive semi-definite."), r"cells?.{0,60}covarianc|covarianc|variance|semi.?definite"),
    ("cells_behind_the_count_visible", "The last cells hold only padding and are visible.", {"count": 48}, Sentence("cells.md", "A cell of which every row lies at or behind the count has visibility exactly 0"), r"visib|behind|count"),
    ("cells_declared_half", "Declares cells as float16 where the graph has float32.", {}, Sentence("manifest.md", "`dtype` equals that of the graph, and may differ from that of the Gaussians."), r"dtype|float16"),
]  # fmt: skip
for name, mistake, options, sentence, cause in CELLS:

    def _build(options: dict[str, Any] = options, name: str = name) -> Draft:
        draft = cell_model(scene("room", seed=50), **options)
        if name == "cells_declared_half":
            assert isinstance(draft.manifest, dict)
            draft.manifest["outputs"]["cells"]["dtype"] = "float16"
        return draft

    fault(name, FAMILY, mistake, cause, build=_build, sentence=sentence)

SIZE = Sentence("manifest.md", "gives an image of the same size")
PICTURES: list[tuple[str, str, dict[str, Any], Sentence | None, str]] = [
    ("picture_half_the_size", "Left the pooling of the training resolution in.", {"pool": True, "out_layout": (1, 3, "h2", "w2")}, SIZE, r"size|resolution|height|width|shape"),
    ("picture_channels_last", "Exported channels last, as TensorFlow does.", {"layout": (1, "h", "w", 3)}, Sentence("roles.md", "Pictures, channels first: of the scene, or the rendered one."), r"channel|NHWC|shape|\[1, 3"),
    ("picture_without_batch", "Exported the picture without its first axis.", {"layout": (3, "h", "w")}, Sentence("roles.md", "[1, 3, H, W] or [1, 4, H, W]"), r"rank|axes|shape|\[1, 3"),
    ("picture_with_an_open_batch", "Left the first axis open.", {"layout": ("b", 3, "h", "w")}, Sentence("roles.md", "all other sizes are static."), r"static|open|dynamic|batch"),
    ("picture_in_bytes", "The output is in 0…255 and declared in 0…1.", {"scale": 255.0}, None, r"range|255"),
    ("picture_signed", "The output is in −1…1 and declared in 0…1.", {"scale": 2.0, "offset": -1.0}, None, r"range|-1|negative"),
    ("picture_with_noise", "Left the noise of the sampler in.", {"noise": True}, Sentence("manifest.md", "Two executions of the same model"), r"random|determinis|noise"),
]  # fmt: skip
for name, mistake, options, sentence, cause in PICTURES:
    fault(
        name,
        FAMILY,
        mistake,
        cause,
        build=partial(post_process, **options),
        sentence=sentence,
        loads=name != "picture_without_batch",
    )

STATES: list[tuple[str, str, dict[str, Any], Sentence | None, str]] = [
    ("path_without_step_seconds", "Forgot the time between two states.", {"step_seconds": None}, Sentence("manifest.md", "| `step_seconds` | number (≥ 0) | required |"), r"step_seconds"),
    ("path_of_six_declared_as_quaternion", "Declares quaternions for states of six numbers.", {"state": 6}, Sentence("manifest.md", "either as a quaternion (w, x, y, z), S = 7"), r"\b7\b|quaternion|representation|columns|shape"),
    ("path_steps_stale", "Declares more steps than the model gives.", {"declared_steps": 5}, Sentence("manifest.md", "The output with predicted camera states, [time steps, values], nearest in time first."), r"steps|shape"),
    ("path_uncertainty_per_step", "Gives one uncertainty a step.", {"sigma_columns": 1}, Sentence("manifest.md", "`standard-deviation` is [steps, S], one number for each of the state's."), r"uncertainty|sigma|shape|columns"),
    ("path_uncertainty_is_log_variance", "Gives the logarithm of the variance as a standard deviation.", {"sigma": -1.3}, Sentence("manifest.md", "The output with the uncertainty of predicted camera states, one row per time step."), r"uncertainty|sigma|negative|deviation|log"),
    ("path_covariance_declared_as_deviation", "Declares an upper triangle as standard deviations.", {"sigma_columns": 28}, Sentence("manifest.md", "`standard-deviation` is [steps, S], one number for each of the state's."), r"uncertainty|sigma|shape|columns|28"),
    ("path_representation_unknown", "Declares the rotation as Euler angles.", {"representation": "position+euler"}, Sentence("manifest.md", '| `representation` | one of `"position+quaternion-wxyz"`, `"position+axis-angle"` |'), r"representation"),
    ("path_quaternions_not_normalised", "Extrapolates quaternions and does not normalise them.", {"normalise": False}, None, r"quaternion|normalis|normaliz|unit|length"),
    ("path_of_vectors_extrapolated", "Extrapolates rotation vectors as if they were places.", {"state": 6, "representation": "position+axis-angle"}, Sentence("manifest.md", "Axis-angle vectors must have a length of at most π"), r"length|π|constant speed"),
]  # fmt: skip
for name, mistake, options, sentence, cause in STATES:
    fault(name, FAMILY, mistake, cause, build=partial(trajectory, **options), sentence=sentence)
