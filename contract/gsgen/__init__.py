"""Gaussian Generators: the contract of ONNX models that emit 3D Gaussians, and its tools.

Four folders of the repository hold parts of this package: contract, sdk, runtime and
reference_plugins. A wheel joins them.
"""

from pkgutil import extend_path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str

__all__ = ["__version__"]
__path__[:] = extend_path(__path__, __name__)  # in place: the module's specification has it, too


def __getattr__(name: str) -> object:
    """Read the installed version when it is first asked for (PEP 562)."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import version

    globals()[name] = version("gsgen")
    return globals()[name]
