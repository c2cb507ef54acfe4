"""Wrap a torch module, export it, and know that what was exported is right.

The names below are loaded when first used, so that ``import gsgen.sdk`` does not import torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gsgen.sdk import inputs, math
    from gsgen.sdk.errors import (
        ExportFailed,
        ExportRejected,
        GeneratorInvalid,
        ParityFailed,
    )
    from gsgen.sdk.export import Exported, export
    from gsgen.sdk.generator import GaussianGenerator, Gaussians

__all__ = [
    "ExportFailed",
    "ExportRejected",
    "Exported",
    "GaussianGenerator",
    "Gaussians",
    "GeneratorInvalid",
    "ParityFailed",
    "export",
    "inputs",
    "math",
]

_HOME = {
    "ExportFailed": "errors",
    "ExportRejected": "errors",
    "Exported": "export",
    "GaussianGenerator": "generator",
    "Gaussians": "generator",
    "GeneratorInvalid": "errors",
    "ParityFailed": "errors",
    "export": "export",
}


def __getattr__(name: str) -> object:
    if name in _HOME:
        value: object = getattr(import_module(f"gsgen.sdk.{_HOME[name]}"), name)
    elif name in ("inputs", "math"):
        value = import_module(f"gsgen.sdk.{name}")
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # `export` is a function here and the module it lives in: importing the module puts it in the
    # function's place, so the function is put back.
    globals()[name] = value
    return value
