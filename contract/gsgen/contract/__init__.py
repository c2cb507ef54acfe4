"""The contract of Gaussian Generators (ONNX models): manifest, layout, rules, validator.

The names below are loaded on first use, so that ``import gsgen.contract`` is fast.
"""

from typing import TYPE_CHECKING

from gsgen.contract._lazy import lazy_dir, lazy_getattr

if TYPE_CHECKING:
    from gsgen.contract.errors import GsgenError
    from gsgen.contract.model.model_file import open_model, write_manifest
    from gsgen.contract.spec.layout import DecodedGaussians, decode, encode
    from gsgen.contract.spec.manifest import GeneratorManifest, Manifest
    from gsgen.contract.spec.severity import Level, Severity
    from gsgen.contract.spec.targets import Target, load_target
    from gsgen.contract.validation.baseline import Baseline, read_baseline
    from gsgen.contract.validation.finding import Finding, Violation
    from gsgen.contract.validation.report import Report
    from gsgen.contract.validation.settings import Settings
    from gsgen.contract.validation.waivers import Waiver
    from gsgen.contract.validator import validate

__all__ = [
    "Baseline",
    "DecodedGaussians",
    "Finding",
    "GeneratorManifest",
    "GsgenError",
    "Level",
    "Manifest",
    "Report",
    "Settings",
    "Severity",
    "Target",
    "Violation",
    "Waiver",
    "decode",
    "encode",
    "load_target",
    "open_model",
    "read_baseline",
    "validate",
    "write_manifest",
]

__getattr__ = lazy_getattr(__name__)
__dir__ = lazy_dir(__name__)
