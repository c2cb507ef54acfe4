"""Baking: how do frames of an ONNX generator become plain splat files?"""

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from gsgen.runtime.baking.bake_frames import bake
    from gsgen.runtime.baking.report import BakedFrame, BakeReport

__all__ = ["BakeReport", "BakedFrame", "bake"]

# Public name → the module that defines it, or that it is.
_MODULE_BY_NAME: Final = {
    "bake": "gsgen.runtime.baking.bake_frames",
    "BakedFrame": "gsgen.runtime.baking.report",
    "BakeReport": "gsgen.runtime.baking.report",
}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _MODULE_BY_NAME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(_MODULE_BY_NAME[name])
    globals()[name] = getattr(module, name, module)
    return globals()[name]


def __dir__() -> list[str]:
    return sorted(__all__)
