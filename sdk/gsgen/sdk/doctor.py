"""Checks of `gsgen doctor`: the Python packages and the WebGPU adapter that the SDK needs."""

__all__ = ["checks"]

from collections.abc import Iterator

from gsgen.contract.tools.doctor import Check, check_package
from gsgen.contract.validation.level_backend import LevelUnavailable

_LIVE_CHECK_NAME = "level live"


def checks() -> Iterator[Check]:
    """Yield the state of the Python packages needed for exporting and for WebGPU."""
    remedy = "pip install 'gsgen[sdk]'"
    for name in ("torch", "onnxscript", "onnx-ir"):
        yield check_package(name, remedy, purpose="export from torch")
    yield check_package("scipy", remedy, purpose="sizes of bare point clouds")
    yield check_package(
        "onnxruntime-ep-webgpu", "pip install 'gsgen[live]'", purpose=_LIVE_CHECK_NAME
    )
    yield _check_adapter()


def _check_adapter() -> Check:
    """Run a minimal model in ONNX Runtime's WebGPU provider, in a child process."""
    from gsgen.sdk.live.level import survey

    try:
        survey_result = survey()
    except LevelUnavailable as error:
        return Check(
            name="webgpu",
            state="missing",
            detail=error.message,
            remedy=error.hint,
            purpose=_LIVE_CHECK_NAME,
        )
    except RuntimeError as error:
        return Check(
            name="webgpu",
            state="broken",
            detail=str(error),
            remedy="pip install -U onnxruntime",
            purpose=_LIVE_CHECK_NAME,
        )
    return Check(
        name="webgpu", state="ok", detail=survey_result["adapter"], purpose=_LIVE_CHECK_NAME
    )
