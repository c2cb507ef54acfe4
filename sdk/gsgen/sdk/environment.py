"""What `gsgen doctor` asks of the SDK's surroundings."""

__all__ = ["checks"]

from collections.abc import Iterator

from gsgen.contract.environment import Check, package


def checks() -> Iterator[Check]:
    """Yield the state of what exporting needs."""
    remedy = "pip install 'gsgen[sdk]'"
    for name in ("torch", "onnxscript", "onnx-ir"):
        yield package(name, remedy, purpose="export from torch")
    yield package("scipy", remedy, purpose="sizes of bare point clouds")
