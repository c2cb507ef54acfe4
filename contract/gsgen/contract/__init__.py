"""The contract of Gaussian Generators: manifest, packed layout, rules, and the judge.

The names below are loaded when first used, so that ``import gsgen.contract`` costs nothing.
"""

from typing import TYPE_CHECKING

from gsgen.contract.lazy import attributes

if TYPE_CHECKING:
    from gsgen.contract.baseline import Baseline, read_baseline
    from gsgen.contract.config import Settings
    from gsgen.contract.engine import validate
    from gsgen.contract.errors import GsgenError
    from gsgen.contract.finding import Breach, Finding, Level, Severity
    from gsgen.contract.layout import Gaussians, decode, encode
    from gsgen.contract.manifest import GeneratorManifest, Manifest
    from gsgen.contract.model import open_model, write_manifest
    from gsgen.contract.report import Report
    from gsgen.contract.targets import Target, load_target
    from gsgen.contract.waivers import Waiver

__all__ = [
    "Baseline",
    "Breach",
    "Finding",
    "Gaussians",
    "GeneratorManifest",
    "GsgenError",
    "Level",
    "Manifest",
    "Report",
    "Settings",
    "Severity",
    "Target",
    "Waiver",
    "decode",
    "encode",
    "load_target",
    "open_model",
    "read_baseline",
    "validate",
    "write_manifest",
]

_HOME = {
    "Baseline": "baseline",
    "Breach": "finding",
    "Finding": "finding",
    "Gaussians": "layout",
    "GeneratorManifest": "manifest",
    "GsgenError": "errors",
    "Level": "finding",
    "Manifest": "manifest",
    "Report": "report",
    "Settings": "config",
    "Severity": "finding",
    "Target": "targets",
    "Waiver": "waivers",
    "decode": "layout",
    "encode": "layout",
    "load_target": "targets",
    "open_model": "model",
    "read_baseline": "baseline",
    "validate": "engine",
    "write_manifest": "model",
}


__getattr__ = attributes(__name__, _HOME)
