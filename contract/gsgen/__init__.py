"""Gaussian Generators: the contract of ONNX models that emit 3D Gaussians, and its tools.

Four folders of the repository hold parts of this package: contract, sdk, runtime and
reference_plugins. A wheel joins them.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str

__all__ = ["__version__"]
# Spelled as tools that read code without running it recognise it, such as those of the docs.
__path__ = __import__("pkgutil").extend_path(__path__, __name__)
if __spec__ is not None:  # tools that import code look here
    __spec__.submodule_search_locations = __path__


def __getattr__(name: str) -> object:
    """Read the installed version when it is first asked for (PEP 562)."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import version

    globals()[name] = version("gsgen")
    return globals()[name]
