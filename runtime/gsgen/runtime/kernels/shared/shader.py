"""Assemble WGSL: named snippets are included, and constants are written once, here, from Python."""

__all__ = ["source"]

import re
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable

from gsgen.contract.spec import layout

_INCLUDE = re.compile(r"^//!include (\w+)$", re.MULTILINE)
_REPEAT = re.compile(  # one that has no other inside
    r"^//!repeat (\w+) (\w+)\n((?:(?!^//!repeat ).)*?)^//!end\n", re.MULTILINE | re.DOTALL
)
_NO_LAYERS = {"LAYERS": 0, "LAYERED": 0}  # not declared where there are none

# What every kernel may use. One truth per fact: the numbers live in gsgen.contract or here.
DILATION = 0.3
"""Variance, in pixels², that is added to every splat (Kerbl et al. 2023)."""
MAX_ALPHA = 0.99
"""The most that one splat may cover a pixel (Kerbl et al. 2023)."""
MIN_TRANSMITTANCE = 1e-4
"""A pixel through which less light would pass is finished (Kerbl et al. 2023)."""
JACOBIAN_MARGIN = 0.3
"""How far outside the image, in half images, the Jacobian follows a centre (as gsplat does)."""
TILE = 16
"""Edge of a tile, in pixels."""
ABSENT = 0xFFFFFFFF
"""The sort key of a Gaussian that is not drawn, and the id of a pixel without one."""
SPLAT_REACH = 3.0
"""Standard deviations beyond which a splat of a weighted sum ends (Liu et al. 2025, their code)."""
LEAST_APART = 0.1
"""How far apart, in pixels², the eigenvalues of a 2D covariance are taken to be there."""
POLE = 1e-3
"""The least cosine of a latitude in a panorama's Jacobian."""
ROUND: dict[str, int | bool] = {"PANORAMA": True, "COPIES": 3}
"""What a kernel that knows where a splat is in the image is compiled with for a panorama."""


def source(name: str, **constants: int | float | bool) -> str:
    """Return the WGSL of kernel ``name``: constants first, then the file with its snippets.

    Two directives stand in lines of their own. ``//!include NAME`` puts another file there.
    ``//!repeat WORD COUNT`` to ``//!end`` writes what is between them as often as the constant
    COUNT says, with WORD replaced by 0, 1, 2, …: drivers unroll no loop over registers. One may
    stand in another.

    Args:
        name: Of the file in this package, without ``.wgsl``.
        constants: Declared in front as ``const NAME``; ints are u32, floats f32.
    """
    shared: dict[str, int | float | bool] = {
        "ABSENT": ABSENT,
        "CULL_OPACITY": layout.CULL_OPACITY,
        "DILATION": DILATION,
        "MAX_ALPHA": MAX_ALPHA,
        "MIN_TRANSMITTANCE": MIN_TRANSMITTANCE,
        "POLE": POLE,
        "TILE": TILE,
        "PANORAMA": False,
        "WEIGHTED": False,
        "PACKED": False,
        "SPLAT_REACH": SPLAT_REACH,
        "LEAST_APART": LEAST_APART,
        "COPIES": 1,
    }
    known = shared | constants
    lines = [_declaration(key, value) for key, value in known.items()]
    text, counts = _included(name), _NO_LAYERS | known
    while (match := _REPEAT.search(text)) is not None:
        text = text[: match.start()] + _repeated(match, counts) + text[match.end() :]
    return "\n".join(lines) + "\n" + text


@cache
def _included(name: str) -> str:
    """Return the text of a file of this package with what it includes in place."""
    text = _shader_files()[name].read_text("utf-8")
    return _INCLUDE.sub(lambda match: _included(match[1]), text)


@cache
def _shader_files() -> dict[str, Traversable]:
    """Return the shader files of all rooms of the kernels, by their names without suffix."""
    rooms = [room for room in files("gsgen.runtime.kernels").iterdir() if room.is_dir()]
    shaders = [
        file for room in rooms for file in room.iterdir() if file.name.endswith(".wgsl")
    ]
    return {file.name.removesuffix(".wgsl"): file for file in shaders}


def _repeated(match: re.Match[str], constants: dict[str, int | float | bool]) -> str:
    word, count, text = match[1], constants[match[2]], match[3]
    return "".join(text.replace(word, str(number)) for number in range(int(count)))


def _declaration(name: str, value: int | float | bool) -> str:
    if isinstance(value, bool):
        return f"const {name}: bool = {str(value).lower()};"
    if isinstance(value, int):
        return f"const {name}: u32 = {value}u;"
    return f"const {name}: f32 = {value!r}f;"
