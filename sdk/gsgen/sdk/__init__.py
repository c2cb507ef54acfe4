"""Wrap a torch module as a generator of Gaussians, export it to ONNX, verify the model.

The names below are loaded when first used, so that ``import gsgen.sdk`` does not import torch.
"""

from typing import TYPE_CHECKING, Final

from gsgen import _lazy_names

if TYPE_CHECKING:
    from gsgen.sdk import math
    from gsgen.sdk.authoring import inputs
    from gsgen.sdk.authoring.adapter import wrap
    from gsgen.sdk.authoring.cells import Cells
    from gsgen.sdk.authoring.generator import GaussianGenerator, Gaussians
    from gsgen.sdk.authoring.on_cpu import on_cpu
    from gsgen.sdk.authoring.post_process import PostProcess
    from gsgen.sdk.errors import ExportFailed, ExportRejected, GeneratorInvalid, ParityFailed
    from gsgen.sdk.exporting.exporter import export
    from gsgen.sdk.exporting.pipeline import Exported
    from gsgen.sdk.exporting.post_process_exporter import export_post_process
    from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication, installed_plugins

__all__ = [
    "Cells", "Demo", "ExportFailed", "ExportRejected", "Exported", "GaussianGenerator", "Gaussians",
    "GeneratorInvalid", "ParityFailed", "Plugin", "PostProcess", "Publication", "export",
    "export_post_process", "inputs", "installed_plugins", "math", "on_cpu",
    "wrap",
]  # fmt: skip

# Public name → the module that defines it, or that it is.
_MODULE_BY_NAME: Final = {
    "math": "gsgen.sdk.math",
    "inputs": "gsgen.sdk.authoring.inputs",
    "on_cpu": "gsgen.sdk.authoring.on_cpu",
    "wrap": "gsgen.sdk.authoring.adapter",
    "Cells": "gsgen.sdk.authoring.cells",
    "GaussianGenerator": "gsgen.sdk.authoring.generator",
    "Gaussians": "gsgen.sdk.authoring.generator",
    "PostProcess": "gsgen.sdk.authoring.post_process",
    "ExportFailed": "gsgen.sdk.errors",
    "ExportRejected": "gsgen.sdk.errors",
    "GeneratorInvalid": "gsgen.sdk.errors",
    "ParityFailed": "gsgen.sdk.errors",
    "export": "gsgen.sdk.exporting.exporter",
    "Exported": "gsgen.sdk.exporting.pipeline",
    "export_post_process": "gsgen.sdk.exporting.post_process_exporter",
    "Demo": "gsgen.sdk.plugins.plugin",
    "Plugin": "gsgen.sdk.plugins.plugin",
    "Publication": "gsgen.sdk.plugins.plugin",
    "installed_plugins": "gsgen.sdk.plugins.plugin",
}

__getattr__, __dir__ = _lazy_names(__name__, _MODULE_BY_NAME)
