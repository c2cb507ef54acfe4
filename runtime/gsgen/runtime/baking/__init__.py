"""Baking: how do frames of an ONNX generator become plain splat files?"""

from typing import TYPE_CHECKING, Final

from gsgen import _lazy_names

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

__getattr__, __dir__ = _lazy_names(__name__, _MODULE_BY_NAME)
