"""What holds for every test."""

import gc
import os
from collections.abc import Iterator

import pytest

os.environ["GSGEN_NO_CACHE"] = "1"  # no test keeps what it measured of a driver
# Tests compile many shaders that run for milliseconds: Mesa's driver spends less without passes that
# optimise them.
os.environ.setdefault("GALLIVM_PERF", "nopt")


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Iterator[None]:
    """Collect without looking for garbage: a million objects are made, and nearly all of them stay."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()  # nor do later searches visit them
        gc.enable()
