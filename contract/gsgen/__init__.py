"""Gaussian Generators: the contract of ONNX models that emit 3D Gaussians, and its tools.

    >>> import gsgen
    >>> splats = gsgen.load("garden.ply")
    >>> gsgen.render(splats).save("garden.png")

The names below are loaded on first use. Four folders of the repository hold parts of this
package: contract, sdk, runtime and reference_plugins. A wheel joins them.
"""

import os
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gsgen._front_door import bake, convert, export, load, render, validate, view

    __version__: str

_FRONT_DOOR = ("bake", "convert", "export", "load", "render", "validate", "view")
__all__ = ["__version__", "bake", "convert", "export", "load", "render", "validate", "view"]
# Spelled as tools that read code without running it recognise it, such as those of the docs.
__path__ = __import__("pkgutil").extend_path(__path__, __name__)
if __spec__ is not None:  # tools that import code look here
    __spec__.submodule_search_locations = __path__

# ONNX Runtime and huggingface_hub report their use to their makers unless these are set before
# they are loaded. Child processes inherit them. A value that the user set stays.
for _telemetry_variable in ("ORT_DISABLE_TELEMETRY", "HF_HUB_DISABLE_TELEMETRY"):
    os.environ.setdefault(_telemetry_variable, "1")


def __getattr__(name: str) -> object:
    """Load a public name, or read the installed version, on its first use (PEP 562)."""
    if name == "__version__":
        from importlib.metadata import version

        globals()[name] = version("gsgen")
    elif name in _FRONT_DOOR:
        globals()[name] = getattr(import_module("gsgen._front_door"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _lazy_names(
    package: str, module_by_name: Mapping[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return the ``__getattr__`` and ``__dir__`` of a package that imports names at first use.

    Args:
        package: The package's ``__name__``.
        module_by_name: Public name → the module that defines it, or that it is.
    """
    module = sys.modules[package]

    def import_name(name: str) -> object:
        if name not in module_by_name:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home_module = import_module(module_by_name[name])
        value: object = getattr(home_module, name, home_module)
        setattr(module, name, value)
        return value

    return import_name, lambda: sorted(module.__all__)
