"""Generators with known Gaussians, exported once."""

from pathlib import Path

import pytest
import torch

from gsgen.sdk import export
from runtime.baking.generators import HalfSeen, Harmonic
from support.models.generators import Drift, Growing, Lit


@pytest.fixture(scope="session")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with drift, growing, lit, harmonic and halfseen."""
    folder = tmp_path_factory.mktemp("baking")
    for kind in (Drift, Growing, Lit, Harmonic, HalfSeen):
        torch.manual_seed(0)  # the weights of networks do not depend on other tests
        export(kind(), folder / f"{kind.__name__.lower()}.onnx")
    return folder
