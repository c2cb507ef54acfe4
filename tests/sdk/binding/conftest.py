"""Models that sessions run, written once; `make drivers` first, for WebGPU without a GPU."""

from pathlib import Path

import pytest

from gsgen.conformance.fixtures.builders.moving import camera_dependent_model, drifting_model
from gsgen.sdk.live.fixtures import live_fixtures


@pytest.fixture(scope="session")
def models(tmp_path_factory) -> dict[str, Path]:
    """Model by name: drift and look in both dtypes, and the examples that break a live rule."""
    folder = tmp_path_factory.mktemp("models")
    sketches = {f"drift-{dtype}": drifting_model(dtype=dtype) for dtype in ("float32", "float16")}
    sketches |= {
        f"look-{dtype}": camera_dependent_model(dtype=dtype) for dtype in ("float32", "float16")
    }
    sketches["look-row"] = camera_dependent_model(order="row")
    for name, spec in sketches.items():
        spec.write(folder / f"{name}.onnx")
    result = {name: folder / f"{name}.onnx" for name in sketches}
    return result | {
        live_fixture.name: live_fixture.write(folder) for live_fixture in live_fixtures()
    }
