"""Wrap a torch module, export it, and know that what was exported is right.

The names below are loaded when first used, so that ``import gsgen.sdk`` does not import torch.
"""

from typing import TYPE_CHECKING

from gsgen.contract.lazy import attributes

if TYPE_CHECKING:
    from gsgen.sdk import inputs, math
    from gsgen.sdk.adapter import wrap
    from gsgen.sdk.cells import Cells
    from gsgen.sdk.errors import (
        ExportFailed,
        ExportRejected,
        GeneratorInvalid,
        ParityFailed,
    )
    from gsgen.sdk.exporter import Exported, export
    from gsgen.sdk.generator import GaussianGenerator, Gaussians
    from gsgen.sdk.post_export import export_post_process
    from gsgen.sdk.post_process import PostProcess

__all__ = [
    "Cells",
    "ExportFailed",
    "ExportRejected",
    "Exported",
    "GaussianGenerator",
    "Gaussians",
    "GeneratorInvalid",
    "ParityFailed",
    "PostProcess",
    "export",
    "export_post_process",
    "inputs",
    "math",
    "wrap",
]

_HOME = {
    "Cells": "cells",
    "ExportFailed": "errors",
    "ExportRejected": "errors",
    "Exported": "exporter",
    "GaussianGenerator": "generator",
    "Gaussians": "generator",
    "GeneratorInvalid": "errors",
    "ParityFailed": "errors",
    "PostProcess": "post_process",
    "export": "exporter",
    "export_post_process": "post_export",
    "inputs": "inputs",
    "math": "math",
    "wrap": "adapter",
}


__getattr__ = attributes(__name__, _HOME)
