"""What people mean by options that a command does not have, by meaning, not by letters."""

__all__ = ["edit_meant", "explain_option"]

import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Final

from gsgen.contract.errors import names_meant

_LISTING: Final = "`{command} --help` lists what it takes."
_OUTPUT_ARGUMENTS: Final = ("folder", "output", "name")  # of commands that write to an argument
_OPTION_WORDS: Final = {
    "--antialias": "aa anti-aliasing antialiasing anti-alias mip",
    "--background": "bg bgcolor bg-color background-color clear-color backdrop",
    "--background transparent": "transparent",
    "--background white": "white-background white-bg white",
    "--box": "B crop bbox aabb bounds filter-box clip region",
    "--budget": "tolerance max-error",
    "--camera": "cam cameras camera-path camera-path-filename trajectory view viewpoint eye position",
    "--camera FILE#NUMBER": "camera-idx camera-index camera-id cam-idx view-index index idx",
    "--camera look-at:EX,EY,EZ,TX,TY,TZ": "lookat look-at target",
    "--camera orbit --frames 90": "turntable",
    "--camera orbit:AZIMUTH,ELEVATION,RADIUS": "azimuth elevation distance radius zoom dist orbit pitch yaw roll theta phi",
    "--checkpoint": "ckpt ckpt-path model-path load-config weights m checkpoint-path",
    "--codec": "format compress compression draco",
    "--count": "n views num",
    "--decimate": "F max-splats max-points max-gaussians target-count reduce simplify n filter-decimate percent "
    "sample subsample downsample voxel-size ratio lod keep",
    "--drop-floaters": "G remove-floaters filter-floaters clean outliers denoise sor prune",
    "--drop-invalid": "N filter-nan nan remove-nan n",
    "--dry-run": "no-write simulate n",
    "--dtype": "precision data-type",
    "--dtype float16": "fp16 half float16 quantize quantise",
    "--emit-manifest": "manifest",
    "--encoding": "binary",
    "--encoding ascii": "ascii text",
    "--eye-distance": "ipd eye-separation interpupillary-distance",
    "--fail-on warning": "warnings-as-errors werror error-on-warning max-warnings",
    "--format": "type fmt output-format ext f",
    "--format html": "html",
    "--format junit": "junit xml",
    "--format markdown": "markdown md",
    "--format sarif": "sarif",
    "--fov": "focal focal-length fovy fov-y field-of-view fovx hfov vfov",
    "--fps": "framerate frame-rate rate r",
    "--frames": "n num-frames n-frames frame-count iterations iters runs repeat repeats",
    "--height": "h",
    "--host": "bind address listen ip",
    "--histograms": "histogram distribution distributions",
    "--ignore": "skip exclude disable except suppress no-rule",
    "--input NAME=VALUE": "set param params parameter var feed",
    "--input time=FROM..TO": "time-range time-start start end ss",
    "--into": "dir directory folder out-dir output-dir output",
    "--iteration": "iter step load-iteration",
    "--jobs": "threads workers n-workers num-workers parallel processes",
    "--json": "as-json print-json format yaml csv",
    "--lat": "latitude lonlat latlon crs epsg",
    "--leaf": "max-splats max-points lod lods levels max-level max-depth depth tile-size max-splats-per-tile",
    "--level": "l",
    "--level render": "full all thorough complete",
    "--level static": "fast quick no-run no-validate no-validation skip-validation",
    "--lon": "longitude lonlat latlon crs epsg",
    "--mode": "render-mode output-names rendered-output-names show-output",
    "--mode alpha": "mask alpha",
    "--mode color": "rgb rgba",
    "--mode depth": "depth",
    "--mode normal": "normal normals",
    "--morton": "M sort order",
    "--only": "rule rules select check include ruleset",
    "--orthographic": "ortho parallel",
    "--output": "out outfile out-file output-file output-path outdir out-dir output-dir "
    "output-folder save save-path save-to dest destination to result report write",
    "--panorama": "360 equirectangular equirect pano spherical cubemap",
    "--pass": "passes fold simplify",
    "--port": "p",
    "--post": "tonemap tone-mapping exposure gamma brightness contrast saturation lut",
    "--provider": "device backend ep execution-provider providers accelerator",
    "--provider cpu": "cpu use-cpu no-gpu",
    "--provider cuda": "cuda gpu",
    "--provider webgpu": "gpu use-gpu wgpu",
    "--rasteriser": "E engine renderer rasterizer",
    "--rotate": "r rotation flip flip-x flip-y flip-z align orient transform matrix z-up y-up up swap-yz up-axis",
    "--scale": "s resize factor transform matrix",
    "--sh-degree": "H sh sh-degrees degree harmonics filter-harmonics filter-bands max-sh-degree bands sh-bands",
    "--sh-degree 0": "remove-sh no-sh drop-sh strip-sh dc-only",
    "--size": "resolution res s vf image-size img-size geometry dimensions overwrite-input-shape "
    "input-shape shape",
    "--sphere": "S filter-sphere crop-sphere",
    "--statistics": "stats summary info m",
    "--stereo": "vr sbs side-by-side",
    "--target": "t runtime consumer",
    "--target webgpu": "browser web webgpu",
    "--time": "t ss timestep frame frames fps",
    "--timeout": "time-limit",
    "--tolerance": "atol rtol tol eps threshold",
    "--translate": "t move offset shift center recenter centre transform matrix",
    "--trust": "unsafe no-sandbox",
    "--turn": "spin",
    "--up": "up-axis axis vertical-axis z-up y-up",
    "--verbose": "debug v vv",
    "--web": "browser http page open",
    "--where": "V filter filter-value filter-by filter-opacity opacity min-opacity opacity-threshold keep",
    "--width": "w",
    "--workers": "jobs threads j n-workers num-workers parallel processes",
}
"""Option, perhaps with a value → other words for it, separated by spaces, without hyphens.

A capital letter is an option of its own.
"""

_EDITS: Final = {
    "--box": "X,Y,Z,X,Y,Z",
    "--decimate": "N%",
    "--drop-floaters": "SIZE,COUNT",
    "--histograms": "FILE.png",
    "--morton": "",
    "--rotate": "X,Y,Z",
    "--scale": "FACTOR",
    "--sphere": "X,Y,Z,RADIUS",
    "--translate": "X,Y,Z",
    "--where": "CONDITION",
}
"""Option of `gsgen convert` that edits or describes splats → what it takes."""

_VALUE: Final = re.compile(r"[-+\d.,%]+")

_ADVICE: Final = {
    "A video of 5 s has --frames 125 --fps 25.": "duration seconds length t",
    "Everything is printed already; some commands print more as --json.": (
        "verbose debug v vv log-level verbosity inputs outputs nodes weights ops operators"
    ),
    "Existing files are replaced without asking: leave it out.": "overwrite y yes f force w replace",
    "It prints to standard output: > FILE writes that to a file.": "o output out report write",
    "Name the file without an option, after the command.": (
        "i input input-file in file filename model m checkpoint ckpt source source-path s scene ply "
        "load load-config model-path data path url"
    ),
    "Name the folder of the iteration, such as point_cloud/iteration_7000.": "iteration iter step",
    "Set the environment variable NO_COLOR=1.": "no-color no-colour color colour",
    "Notes and progress go to stderr, which 2>/dev/null hides.": "quiet q silent no-progress progress",
    "Drawing needs no screen: leave it out.": "headless egl offscreen osmesa xvfb no-window no-gui",
    "Frames run one after another: leave it out.": "batch batch-size bs",
    "Equal calls give equal results: leave it out.": "seed random-seed",
    "The first frame is measured apart: leave it out.": "warmup warm-up",
    _LISTING: "list list-formats formats list-options commands",
    "`gsgen rules` lists the rules.": "list-rules",
    "`gsgen rules WORD` lists the rules that have a word.": "grep category search find query",
    "A video is AV1 in .mp4, which ffmpeg converts to other codecs.": (
        "c codec vcodec crf bitrate pix-fmt preset"
    ),
    "A .gif repeats by itself, and a player repeats an .mp4.": "loop repeat",
    "A copy is written, never the input: give -o FILE.": "i in-place inplace backup",
    "`gsgen fix MODEL -o FILE` writes a repaired copy.": "fix autofix repair",
    "16 bits are the fewest: `gsgen float16` writes them.": (
        "int8 uint8 int4 bf16 quantize fp16 half float16"
    ),
    "The result is compared with the input by itself: leave it out.": "verify no-verify check",
    "The suffix of the output chooses format and quality: .png and .ply lose nothing.": (
        "quality jpeg-quality compression compression-level precision"
    ),
    "The same command resumes what was stopped.": "resume continue restart",
    "`gsgen --version` prints it.": "version",
    "There are no clip planes to set: leave it out.": (
        "near far near-plane far-plane znear zfar near-clip far-clip"
    ),
    "Draw a larger --size, and scale the picture down.": (
        "supersample supersampling ssaa msaa samples spp resolution-scale downscale-factor"
    ),
    "Splats hold their light, and are drawn in their size: leave it out.": (
        "light lights shadow shadows environment envmap ibl point-size splat-scale splat-size"
    ),
    "Floats above 1 are kept in an .exr: name the output so.": "hdr exr float",
    "A file of cameras holds lenses, such as COLMAP's: --camera FILE.": "fisheye distortion lens",
    "`gsgen view` shows it in a window, `gsgen view --web` in the browser.": (
        "show preview display interactive gui window open fullscreen"
    ),
    "`gsgen export html` writes a page to share.": "share public publish upload",
    "`gsgen view --web` serves this machine alone; `gsgen export html` writes a page for others.": (
        "host bind address listen ip"
    ),
    "The page is one file that needs no network: leave it out.": (
        "single-file inline offline self-contained standalone embed"
    ),
    "Drawing validates nothing: leave it out.": "no-validate skip-validation no-check",
    "`gsgen references` declares pictures, and `gsgen validate --level render` compares.": (
        "compare psnr ssim lpips images metrics eval"
    ),
}
"""Sentence → the words of options that it answers where the command has no option for them."""


def explain_option(error: Any, commands_with: Callable[[str], Sequence[str]]) -> None:
    """Say in click's error about an option which one was meant, or what its value is.

    Args:
        error: The error, whose message is changed.
        commands_with: Returns the names of a few commands that have an option.
    """
    typed, command = str(error.option_name), error.ctx.command
    if not hasattr(error, "possibilities"):
        error.message += _value_advice(typed, command)
        return
    meant, own_options = _meant_options(typed), list(_option_names(command))
    here = [option for option in meant if option.split()[0] in own_options]
    near_options = here or _near_options(typed, own_options)
    near = [f"Did you mean {' or '.join(near_options)}?"] if near_options else []
    advice = _output_advice(typed, command) or names_meant(typed, _ADVICE)[:1]
    is_letter = len(typed.lstrip("-")) == 1
    hints = near if here else advice + near if is_letter else advice or near
    option = (meant[0] if meant else typed).split()[0]
    if not hints and not is_letter and (names := commands_with(option)):
        calls = ", ".join(f"`gsgen {name}`" for name in names)
        hints = [f"{meant[0] if meant else typed} is an option of {calls}."]
    hint = " ".join(hints or [_LISTING]).replace("{command}", error.ctx.command_path)
    error.message = f"{error.message}. {hint}"
    error.possibilities = []


def edit_meant(word: str, arguments: Sequence[str]) -> str:
    """Return the call of `gsgen convert` that edits splats as a verb says; empty for other words.

    Args:
        word: The verb, such as ``crop``.
        arguments: What was typed after it: files, and perhaps the numbers of the edit.
    """
    words = {option: _OPTION_WORDS.get(option, "") for option in _EDITS}
    options = names_meant(word, words)
    if len(options) != 1:
        return ""
    values = [entry for entry in arguments if _VALUE.fullmatch(entry)]
    files = [entry for entry in arguments if entry not in values and not entry.startswith("-")]
    target = files[1:] or [f"edited{''.join(Path(files[0]).suffixes)}" if files else "TARGET"]
    value = ",".join(values) or _EDITS[options[0]]
    call = ["gsgen", "convert", *(files[:1] or ["SOURCE"]), *target, options[0]]
    return shlex.join([*call, value] if value else call)


def _meant_options(typed: str) -> list[str]:
    """Return the options, some with a value, that people mean by another, whose case counts for a letter."""
    letter = typed.lstrip("-")
    capital = [name for name, words in _OPTION_WORDS.items() if letter in words.split()]
    is_capital = len(letter) == 1 and letter.isupper()
    return capital if is_capital and capital else names_meant(typed, _OPTION_WORDS)


def _near_options(typed: str, own_options: Sequence[str]) -> list[str]:
    """Return options of the command that begin with the typed letter, share a word, or are misspelt."""
    from difflib import SequenceMatcher  # imported on failure only: start-up time counts

    word = typed.lstrip("-").replace("_", "-").casefold()
    ratio_by_option = {
        option: SequenceMatcher(None, word, option[2:]).ratio()
        for option in own_options
        if option.startswith("--")
    }
    near = [
        option
        for option, ratio in ratio_by_option.items()
        if (
            option[2] == typed.lstrip("-")
            if len(word) == 1
            else _shares_word(word, option[2:]) or ratio > 0.75
        )
    ]
    return sorted(near, key=ratio_by_option.__getitem__, reverse=True)[:3]


def _shares_word(first: str, second: str) -> bool:
    """Return whether two names between hyphens have a word in common, or the beginning of one."""
    pairs = product(first.split("-"), second.split("-"))
    by_length = (sorted(pair, key=len) for pair in pairs)
    return any(len(short) >= 3 and long.startswith(short) for short, long in by_length)


def _output_advice(typed: str, command: Any) -> list[str]:
    """Return where an output belongs if the command has an argument for it."""
    names = [item.human_readable_name for item in command.params if item.name in _OUTPUT_ARGUMENTS]
    is_output = typed.lstrip("-") in ("o", "out", "output", "output-dir")
    return [f"Type {names[0]} without an option, after the command."] if is_output and names else []


def _value_advice(option: str, command: Any) -> str:
    """Return what a value of an option may be; empty for an unknown option."""
    for parameter in command.params:
        if option in parameter.opts:
            choices = getattr(getattr(parameter, "type", None), "choices", None)
            name = parameter.metavar or (parameter.name or "").upper()
            return f" Give {' or '.join(map(str, choices)) if choices else name}."
    return ""


def _option_names(command: Any) -> Iterator[str]:
    for parameter in command.params:
        yield from parameter.opts
