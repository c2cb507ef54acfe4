"""What `gsgen doctor` asks of the SDK's surroundings."""

__all__ = ["checks"]

from collections.abc import Iterator

from gsgen.contract.tools.doctor import Check, package
from gsgen.contract.validation.level_backend import LevelUnavailable

_LIVE = "level live"


def checks() -> Iterator[Check]:
    """Yield the state of what exporting, and running models in WebGPU, need."""
    remedy = "pip install 'gsgen[sdk]'"
    for name in ("torch", "onnxscript", "onnx-ir"):
        yield package(name, remedy, purpose="export from torch")
    yield package("scipy", remedy, purpose="sizes of bare point clouds")
    yield package("onnxruntime-ep-webgpu", "pip install 'gsgen[live]'", purpose=_LIVE)
    yield _adapter()


def _adapter() -> Check:
    """Run the smallest model in ONNX Runtime's WebGPU provider, in a child process."""
    from gsgen.sdk.live.level import survey

    try:
        found = survey()
    except LevelUnavailable as error:
        return Check("webgpu", "missing", error.message, error.hint, _LIVE)
    except RuntimeError as error:
        return Check("webgpu", "broken", str(error), "pip install -U onnxruntime", _LIVE)
    return Check("webgpu", "ok", found["adapter"], purpose=_LIVE)
