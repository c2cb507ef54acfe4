"""Models that sessions run, written once; `make drivers` first, for WebGPU without a GPU."""

from pathlib import Path

import pytest

from gsgen.conformance.fixtures.builders.moving import camera_dependent_model, drifting_model
from gsgen.sdk.live.fixtures import live_fixtures


@pytest.fixture(scope="session")
def models(tmp_path_factory) -> dict[str, Path]:
    """Model by name: drift and look in both dtypes, and the examples that break a live rule."""
    folder = tmp_path_factory.mktemp("models")
    dtypes = ("float32", "float16")
    specs = {f"drift-{dtype}": drifting_model(dtype=dtype) for dtype in dtypes}
    specs |= {f"look-{dtype}": camera_dependent_model(dtype=dtype) for dtype in dtypes}
    specs["look-row"] = camera_dependent_model(order="row")
    for name, spec in specs.items():
        spec.write(folder / f"{name}.onnx")
    result = {name: folder / f"{name}.onnx" for name in specs}
    return result | {fixture.name: fixture.write(folder) for fixture in live_fixtures()}
