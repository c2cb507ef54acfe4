"""three.js, which draws the meshes of scenes in web pages, and models without WebGPU."""

__all__ = ["THREE", "import_map", "inlined_modules"]

import base64
import posixpath
import re
from pathlib import Path
from typing import Final

from gsgen.runtime.web.npm_files import NpmFiles

_ADDONS: Final = "examples/jsm/"
_RELATIVE: Final = re.compile(r"""(\bfrom\s*)(['"])(\.{1,2}/[^'"]+)\2""")

THREE: Final = NpmFiles(
    title="three.js",
    package="three",
    version="0.187.0",
    sha256="ff540832ded0cfe919764d24a3d88f3e2a05f23303f876423e4f893841e90728",
    folder=".",
    names=(
        *(f"build/three.{name}.js" for name in ("core", "tsl", "webgpu")),
        *(
            f"{_ADDONS}{name}.js"
            for name in (
                "curves/NURBSCurve",
                "curves/NURBSUtils",
                "gpgpu/CountingSort",
                "libs/fflate.module",
                "loaders/FBXLoader",
                "loaders/GLTFLoader",
                "loaders/MTLLoader",
                "loaders/OBJLoader",
                "loaders/PLYLoader",
                "loaders/STLLoader",
                "objects/GaussianSplat",
                "utils/BufferGeometryUtils",
                "utils/GaussianSplatUtils",
                "utils/SkeletonUtils",
            )
        ),
    ),
    option="--three",
)
"""The files that pages load, with all modules that they import."""


def import_map(prefix: str) -> dict[str, str]:
    """Return the addresses of three.js's modules by the names under which they are imported.

    Args:
        prefix: Address of the package's folder, with a slash at its end.
    """
    return {
        "three": f"{prefix}build/three.webgpu.js",
        "three/webgpu": f"{prefix}build/three.webgpu.js",
        "three/tsl": f"{prefix}build/three.tsl.js",
        "three/addons/": f"{prefix}{_ADDONS}",
    }


def inlined_modules(folder: Path) -> dict[str, str]:
    """Return each module of three.js as a data URL, by the name under which it is imported."""
    # Two names of one module would be two copies of its text.
    modules = {"three": _data_url('export * from "three/webgpu";')}
    for name in THREE.names:
        text = (folder / name).read_text("utf-8")

        def bare(match: re.Match[str], name: str = name) -> str:
            # A module without an address cannot import its neighbours by relative names.
            target = posixpath.normpath(posixpath.join(posixpath.dirname(name), match[3]))
            return f"{match[1]}{match[2]}{_module_name(target)}{match[2]}"

        modules[_module_name(name)] = _data_url(_RELATIVE.sub(bare, text))
    return modules


def _module_name(path: str) -> str:
    """Return the bare name of a file of the package."""
    if path.startswith(_ADDONS):
        return f"three/addons/{path.removeprefix(_ADDONS)}"
    return f"three/{path.removeprefix('build/three.').removesuffix('.js')}"


def _data_url(text: str) -> str:
    return f"data:text/javascript;base64,{base64.b64encode(text.encode()).decode()}"
