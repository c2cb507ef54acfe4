"""Models that sessions run, written once; `make drivers` first, for WebGPU without a GPU."""

from pathlib import Path

import pytest

from gsgen.conformance.fixtures.builders.moving import drifting, looking
from gsgen.sdk.live.fixtures import live_fixtures


@pytest.fixture(scope="session")
def models(tmp_path_factory) -> dict[str, Path]:
    """Model by name: drift and look in both dtypes, and the examples that break a live rule."""
    folder = tmp_path_factory.mktemp("models")
    sketches = {f"drift-{dtype}": drifting(dtype=dtype) for dtype in ("float32", "float16")}
    sketches |= {f"look-{dtype}": looking(dtype=dtype) for dtype in ("float32", "float16")}
    sketches["look-row"] = looking(order="row")
    for name, spec in sketches.items():
        spec.write(folder / f"{name}.onnx")
    result = {name: folder / f"{name}.onnx" for name in sketches}
    return result | {
        live_fixture.name: live_fixture.write(folder) for live_fixture in live_fixtures()
    }
