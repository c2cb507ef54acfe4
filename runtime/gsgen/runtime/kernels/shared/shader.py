"""Assembles WGSL shaders: includes files, and declares Python constants before them."""

__all__ = ["source"]

import re
from functools import cache, lru_cache
from importlib.resources import files
from importlib.resources.abc import Traversable

from gsgen.contract.spec import layout
from gsgen.runtime.scene.camera import DEFAULT_DILATION

_INCLUDE_PATTERN = re.compile(r"^//!include (\w+)\n", re.MULTILINE)
_SHADER_REPEAT_PATTERN = re.compile(  # without another inside
    r"^//!repeat (\w+) (\w+)\n((?:(?!^//!repeat ).)*?)^//!end\n", re.MULTILINE | re.DOTALL
)

# Numbers that kernels share; those of one kernel stand in its module.
MAX_ALPHA = 0.99
"""The largest opacity of one splat at a pixel (Kerbl et al. 2023)."""
JACOBIAN_MARGIN = 0.3
"""Margin around the image, in half images, to which Jacobians are clamped (as in gsplat)."""
TILE = 16
"""Edge of a tile, in pixels: a weighted sum counts whole tiles of it (Liu et al. 2025)."""
LARGE_TILE = 32
"""Edge of the tiles of depth-sorted splats on GPUs, in pixels: fewer pairs to sort and read."""
WINDOW_HEIGHT = 3
"""Rows of tiles of the window in which one word tells the tiles of a splat."""
NO_ID = 0xFFFFFFFF
"""The sort key of a Gaussian that is not drawn, and the id of a pixel without Gaussians."""
NOWHERE = 3.4e38
"""The depth of empty pixels of an image layer: farther than any splat."""
MIN_EIGENVALUE_GAP = 0.1
"""Lower bound, in pixels⁴, of the squared half difference of a 2D covariance's eigenvalues."""
EYE_ROWS = 64
"""Splats of which those of an eye are a multiple: each device can bind their buffers in parts."""
POLE = 1e-3
"""Lower bound of the cosine of the latitude in a panorama's Jacobian."""

_SHADER_CONSTANTS: dict[str, int | float | bool] = {
    "ABSENT": NO_ID,
    "CULL_OPACITY": layout.CULL_OPACITY,
    "DILATION": DEFAULT_DILATION,
    "DISTORTED": False,
    "EYES": 1,
    "EYE_ROWS": EYE_ROWS,
    "FISHEYE": False,
    "MAX_ALPHA": MAX_ALPHA,
    "MIN_EIGENVALUE_GAP": MIN_EIGENVALUE_GAP,
    "NOWHERE": NOWHERE,
    "PACKED": False,
    "PANORAMA": False,
    "POLE": POLE,
    "TILE": TILE,
    "WINDOW_HEIGHT": WINDOW_HEIGHT,
}


@lru_cache(maxsize=256, typed=True)  # a second renderer asks for the same fifty
def source(name: str, *, wide_words: bool = False, **constants: int | float | bool) -> str:
    """Return the WGSL source of shader ``name`` with all files that it includes.

    Directives stand in lines of their own. ``//!include NAME`` inserts another file, once per
    shader. ``//!repeat WORD COUNT`` to ``//!end`` repeats the lines between them COUNT times (a
    constant), with WORD replaced by 0, 1, 2, …, where a loop over an array was measured to be
    slower. Repetitions may be nested.

    Args:
        name: Name of the shader's file without ``.wgsl``.
        wide_words: Whether the shader reads and writes 64 bits at a time.
        constants: Declared before the text as ``const NAME``, besides those that kernels share;
            integers are u32, floats f32.
    """
    all_constants = _SHADER_CONSTANTS | constants
    lines = [_declaration(key, value) for key, value in all_constants.items()]
    text = _shader_include_source(name, {name}, wide_words=wide_words)
    while (match := _SHADER_REPEAT_PATTERN.search(text)) is not None:
        text = text[: match.start()] + _expand_repeat(match, all_constants) + text[match.end() :]
    return "\n".join(lines) + "\n" + text


def _shader_include_source(name: str, included_names: set[str], *, wide_words: bool) -> str:
    """Return the text of a shader with each included file inserted once."""

    def replacement(match: re.Match[str]) -> str:
        included_name = match[1]
        if included_name in included_names:
            return ""
        included_names.add(included_name)
        return _shader_include_source(included_name, included_names, wide_words=wide_words)

    file = "wide_words" if wide_words and name == "words" else name
    return _INCLUDE_PATTERN.sub(replacement, _shader_files()[file])


@cache
def _shader_files() -> dict[str, str]:
    """Return the WGSL texts of all kernels, by file name without suffix."""
    kernel_folders = [
        kernel_folder
        for kernel_folder in files("gsgen.runtime.kernels").iterdir()
        if kernel_folder.is_dir()
    ]
    shaders: list[Traversable] = [
        file
        for kernel_folder in kernel_folders
        for file in kernel_folder.iterdir()
        if file.name.endswith(".wgsl")
    ]
    return {file.name.removesuffix(".wgsl"): file.read_text("utf-8") for file in shaders}


def _expand_repeat(match: re.Match[str], constants: dict[str, int | float | bool]) -> str:
    placeholder, count, text = match[1], constants[match[2]], match[3]
    pattern = re.compile(rf"(?<![A-Z]){placeholder}(?![A-Z])")
    return "".join(pattern.sub(str(number), text) for number in range(int(count)))


def _declaration(name: str, value: int | float | bool) -> str:  # noqa: FBT001
    if isinstance(value, bool):
        return f"const {name}: bool = {str(value).lower()};"
    if isinstance(value, int):
        return f"const {name}: u32 = {value}u;"
    return f"const {name}: f32 = {value!r}f;"
