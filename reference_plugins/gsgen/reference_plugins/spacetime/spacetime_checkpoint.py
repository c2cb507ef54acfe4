"""Reads checkpoints of SpacetimeGaussians: a PLY with motion, and the decoder of the full model.

The layout is that of oppo-us-research/SpacetimeGaussians (``scene/ourslite.py``,
``scene/oursfull.py``). The columns tell the lite model, whose ``f_dc`` are colours, from the full
one, whose features a network decodes in each pixel.
"""

__all__ = ["FeatureDecoder", "SpacetimeCheckpoint", "SpacetimeSplats", "read_spacetime"]

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.formats import ply_properties, read_ply_columns
from gsgen.reference_plugins.loading.cfg_args import CfgArgs
from gsgen.reference_plugins.loading.errors import CheckpointInvalid, format_faults
from gsgen.reference_plugins.loading.states import load_state, require_tensors
from gsgen.reference_plugins.loading.training_run import TrainingRun, open_cloud

Activation = Literal["sigmoid", "clamp"]

# ``rgbfunction`` of the training → what its decoder applies to colours. The last one clips the
# picture, after a fisheye warp.
_ACTIVATIONS: dict[str, Activation] = {
    "sandwich": "sigmoid",
    "sandwichnoact": "clamp",
    "sandwichnoactss": "clamp",
}
_HIDDEN_CHANNELS = 6
_LAYER_SHAPES = {
    "mlp1.weight": (_HIDDEN_CHANNELS, 12, 1, 1),
    "mlp2.weight": (3, _HIDDEN_CHANNELS, 1, 1),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class SpacetimeSplats:
    """N Gaussians with their motion, before activation, float32."""

    position: Float[Tensor, "n 3"]  # centres at the temporal centre
    motion: Float[Tensor, "n 3 3"]  # coefficients of dt, dt² and dt³, for x, y and z
    rotation: Float[Tensor, "n 4"]  # quaternions (w, x, y, z) at the temporal centre
    omega: Float[Tensor, "n 4"]  # change of the quaternion per unit of time
    log_scale: Float[Tensor, "n 3"]  # logarithms of the standard deviations
    logit_opacity: Float[Tensor, "n 1"]  # opacity before the sigmoid
    temporal_centre: Float[Tensor, "n 1"]  # time of the highest opacity
    log_duration: Float[Tensor, "n 1"]  # logarithm of the time over which opacity falls to 1/e
    # lite: RGB; full: RGB, three specular features, and three that grow with dt
    features: Float[Tensor, "n c"]

    def __len__(self) -> int:
        return self.position.shape[0]


@dataclass(frozen=True, slots=True)
class FeatureDecoder:
    """Two dense layers without bias, which decode features and a viewing ray to a colour."""

    hidden: Float[Tensor, "6 12"]
    color: Float[Tensor, "3 6"]
    activation: Activation


@dataclass(frozen=True, slots=True)
class SpacetimeCheckpoint:
    """The Gaussians of a SpacetimeGaussians checkpoint, and the decoder of the full model."""

    run: TrainingRun
    cloud: Path  # the PLY
    splats: SpacetimeSplats
    decoder: FeatureDecoder | None  # None for the lite model

    @property
    def files(self) -> tuple[Path, ...]:
        """The checkpoint files that the weights come from."""
        return (
            (self.cloud,) if self.decoder is None else (self.cloud.with_suffix(".pt"), self.cloud)
        )

    def describe(self) -> str:
        """Return the number of Gaussians and the model variant of a checkpoint as one line."""
        decoder = self.decoder
        variant_name = "lite model" if decoder is None else f"full model ({decoder.activation})"
        return f"{self.cloud}: {len(self.splats):,} Gaussians, {variant_name}"


def read_spacetime(path: Path, iteration: int | None = None) -> SpacetimeCheckpoint:
    """Read a checkpoint of SpacetimeGaussians: the folder of a run, or a PLY of any name."""
    run, cloud = open_cloud("spacetime-gaussians", path, iteration, "the Gaussians with motion")
    with format_faults(cloud):
        splats = _read_splats(cloud)
    is_full_model = splats.features.shape[1] > 3
    decoder = _read_decoder(cloud.with_suffix(".pt"), run.cfg) if is_full_model else None
    return SpacetimeCheckpoint(run, cloud, splats, decoder)


def _read_splats(path: Path) -> SpacetimeSplats:
    present_names = ply_properties(path)
    is_full_model = "f_t_0" in present_names or "f_dc_3" in present_names
    features = (
        [*_numbered_names("f_dc", 6), *_numbered_names("f_t", 3)]
        if is_full_model
        else _numbered_names("f_dc", 3)
    )
    groups = {
        "position": ["x", "y", "z"],
        "motion": _numbered_names("motion", 9),
        "rotation": _numbered_names("rot", 4),
        "omega": _numbered_names("omega", 4),
        "log_scale": _numbered_names("scale", 3),
        "logit_opacity": ["opacity"],
        "temporal_centre": ["trbf_center"],
        "log_duration": ["trbf_scale"],
        "features": features,
    }
    tables: dict[str, Any] = {
        name: torch.from_numpy(table) for name, table in read_ply_columns(path, groups).items()
    }
    tables["motion"] = tables["motion"].reshape(-1, 3, 3)
    return SpacetimeSplats(**tables)


def _numbered_names(name: str, count: int) -> list[str]:
    return [f"{name}_{index}" for index in range(count)]


def _read_decoder(path: Path, cfg: CfgArgs) -> FeatureDecoder:
    weights = require_tensors(
        path, load_state(path, "the decoder of the full model"), _LAYER_SHAPES
    )
    function = cfg.word("rgbfunction", "sandwich")
    if function not in _ACTIVATIONS:
        message = f"rgbfunction is {function!r}, expected {' or '.join(map(repr, _ACTIVATIONS))}"
        raise CheckpointInvalid(message, where=str(cfg.path))
    hidden, color = (weights[name].flatten(1) for name in _LAYER_SHAPES)
    return FeatureDecoder(hidden, color, _ACTIVATIONS[function])
