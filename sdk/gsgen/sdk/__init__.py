"""Wrap a torch module as a generator of Gaussians, export it to ONNX, verify the model.

The names below are loaded when first used, so that ``import gsgen.sdk`` does not import torch.
"""

from typing import TYPE_CHECKING

from gsgen.contract._lazy import lazy_dir, lazy_getattr

if TYPE_CHECKING:
    from gsgen.sdk import math
    from gsgen.sdk.authoring import inputs
    from gsgen.sdk.authoring.adapter import wrap
    from gsgen.sdk.authoring.cells import Cells
    from gsgen.sdk.authoring.generator import GaussianGenerator, Gaussians
    from gsgen.sdk.authoring.post_process import PostProcess
    from gsgen.sdk.errors import ExportFailed, ExportRejected, GeneratorInvalid, ParityFailed
    from gsgen.sdk.exporting.exporter import export
    from gsgen.sdk.exporting.pipeline import Exported
    from gsgen.sdk.exporting.post_process_exporter import export_post_process
    from gsgen.sdk.plugins.plugin import Demo, Plugin, Publication, installed_plugins

__all__ = [
    "Cells", "Demo", "ExportFailed", "ExportRejected", "Exported", "GaussianGenerator", "Gaussians",
    "GeneratorInvalid", "ParityFailed", "Plugin", "PostProcess", "Publication", "export",
    "export_post_process", "inputs", "installed_plugins", "math", "wrap",
]  # fmt: skip

__getattr__ = lazy_getattr(__name__)
__dir__ = lazy_dir(__name__)
