"""Baking: how do frames of an ONNX generator become plain splat files?"""

from typing import TYPE_CHECKING

from gsgen.contract._lazy import lazy_dir, lazy_getattr

if TYPE_CHECKING:
    from gsgen.runtime.baking.bake_frames import bake
    from gsgen.runtime.baking.report import BakedFrame, BakeReport

__all__ = ["BakeReport", "BakedFrame", "bake"]

__getattr__ = lazy_getattr(__name__)
__dir__ = lazy_dir(__name__)
