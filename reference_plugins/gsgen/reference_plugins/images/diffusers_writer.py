"""Writes networks and noise schedules in the layout of diffusers."""

__all__ = ["SCHEDULE", "config_of", "write_network", "write_schedule"]

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from torch import nn

from gsgen.reference_plugins.diffusion.model_config import ModelConfig
from gsgen.reference_plugins.loading.safetensors import write_safetensors

SCHEDULE: Final[Mapping[str, Any]] = {
    "_class_name": "DDPMScheduler", "num_train_timesteps": 1000, "beta_schedule": "scaled_linear",
    "beta_start": 0.00085, "beta_end": 0.012, "prediction_type": "epsilon",
}  # fmt: skip
"""The noise schedule of Stable Diffusion."""

_WEIGHTS_FILE = "diffusion_pytorch_model.safetensors"


def config_of(values: Mapping[str, Any]) -> ModelConfig:
    """Build a ModelConfig from network options, as if read from a ``config.json``."""
    return ModelConfig(Path("config.json"), values)


def write_network(
    folder: Path, config: Mapping[str, Any], network: nn.Module, name: str = _WEIGHTS_FILE
) -> None:
    """Write a network's weights and its ``config.json`` into the folder."""
    write_safetensors(folder / name, network.state_dict())
    (folder / "config.json").write_text(json.dumps(dict(config)), "utf-8")


def write_schedule(folder: Path, changes: Mapping[str, Any] | None = None) -> None:
    """Write a synthetic noise schedule as ``scheduler/`` into the folder.

    ``changes`` are options that differ from those of :data:`SCHEDULE`.
    """
    path = folder / "scheduler" / "scheduler_config.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**SCHEDULE, **(changes or {})}), "utf-8")
