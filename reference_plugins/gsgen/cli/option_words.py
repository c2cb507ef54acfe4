"""What people mean by options that a command does not have, by meaning, not by letters."""

__all__ = ["explain_option"]

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

from gsgen.contract.errors import names_meant

_OPTION_WORDS: Final = {
    "--antialias": "aa anti-aliasing antialiasing anti-alias mip",
    "--background": "bg bgcolor bg-color background-color clear-color backdrop",
    "--background transparent": "transparent",
    "--background white": "white-background white-bg white",
    "--box": "crop bbox aabb bounds filter-box clip region",
    "--camera": "cam cameras camera-path camera-path-filename trajectory view viewpoint eye position",
    "--camera orbit:AZIMUTH,ELEVATION,RADIUS": "azimuth elevation distance radius zoom dist orbit",
    "--checkpoint": "ckpt ckpt-path model-path load-config weights m checkpoint-path",
    "--decimate": "max-splats max-gaussians target-count reduce simplify n filter-decimate",
    "--drop-floaters": "remove-floaters filter-floaters clean outliers denoise sor prune",
    "--drop-invalid": "filter-nan nan remove-nan n",
    "--dry-run": "no-write simulate n",
    "--dtype": "precision data-type",
    "--dtype float16": "fp16 half float16",
    "--emit-manifest": "manifest",
    "--encoding": "binary",
    "--encoding ascii": "ascii text",
    "--fail-on warning": "warnings-as-errors werror error-on-warning max-warnings",
    "--format": "type fmt output-format ext",
    "--format html": "html",
    "--format junit": "junit xml",
    "--format markdown": "markdown md",
    "--format sarif": "sarif",
    "--fov": "focal focal-length fovy fov-y field-of-view",
    "--fps": "framerate frame-rate rate r",
    "--frames": "n num-frames n-frames frame-count iterations iters runs repeat repeats",
    "--height": "h",
    "--ignore": "skip exclude disable except suppress no-rule",
    "--iteration": "iter step load-iteration",
    "--jobs": "threads workers n-workers num-workers parallel processes",
    "--json": "as-json print-json",
    "--mode alpha": "mask alpha",
    "--mode depth": "depth",
    "--mode normal": "normal normals",
    "--only": "rule rules select check include",
    "--output": "out outfile out-file output-file output-path outdir out-dir output-dir output-folder "
    "save save-path save-to dest destination to result report write",
    "--port": "p",
    "--provider": "device backend ep execution-provider providers accelerator",
    "--provider cpu": "cpu use-cpu no-gpu",
    "--provider cuda": "cuda gpu",
    "--provider webgpu": "gpu use-gpu wgpu",
    "--rotate": "r rotation flip",
    "--scale": "s resize factor",
    "--sh-degree": "sh sh-degrees degree harmonics filter-harmonics max-sh-degree",
    "--size": "resolution res s image-size img-size geometry dimensions",
    "--sphere": "filter-sphere crop-sphere",
    "--statistics": "stats summary info m",
    "--timeout": "time-limit",
    "--tolerance": "atol rtol tol eps threshold",
    "--translate": "t move offset shift center recenter centre",
    "--trust": "unsafe no-sandbox",
    "--turn": "spin turntable",
    "--up": "up-axis axis vertical-axis z-up y-up",
    "--verbose": "debug v vv",
    "--web": "browser http page open",
    "--where": "filter filter-value filter-by filter-opacity min-opacity opacity-threshold keep",
    "--width": "w",
}
"""Option, perhaps with a value → other words for it, separated by spaces, without hyphens."""

_ADVICE: Final = {
    "A video of 5 s has --frames 125 --fps 25.": "duration seconds length t",
    "Everything is printed already; some commands print more as --json.": "verbose debug v vv",
    "Existing files are replaced without asking: leave it out.": "overwrite y yes f force w replace",
    "It prints to standard output: > FILE writes that to a file.": "o output out report write",
    "Name the file without an option, after the command.": (
        "i input input-file in file filename model m checkpoint ckpt source source-path s scene ply "
        "load load-config model-path data path url"
    ),
    "Name the folder of the iteration, such as point_cloud/iteration_7000.": "iteration iter step",
    "Set the environment variable NO_COLOR=1.": "no-color no-colour color colour",
    "Notes and progress go to stderr, which 2>/dev/null hides.": "quiet q silent",
    "The first frame is measured apart: leave it out.": "warmup warm-up",
    "`gsgen COMMAND --help` lists what the command takes.": "list list-formats formats list-options",
    "`gsgen rules` lists the rules.": "list-rules",
    "A video is AV1 in .mp4, which ffmpeg converts to other codecs.": (
        "codec vcodec crf bitrate quality pix-fmt preset"
    ),
    "A .gif repeats by itself, and a player repeats an .mp4.": "loop repeat",
}
"""Sentence → the words of options that it answers where the command has no option for them."""


def explain_option(error: Any, commands_with: Callable[[str], Sequence[str]]) -> None:
    """Say in click's error about an option which one was meant, or what its value is.

    Args:
        error: The error, whose message is changed.
        commands_with: Returns the names of a few commands that have an option.
    """
    typed = str(error.option_name)
    if not hasattr(error, "possibilities"):
        error.message += _value_advice(typed, error.ctx.command)
        return
    own_options = set(_option_names(error.ctx.command))
    meant = names_meant(typed, _OPTION_WORDS)
    here = [option for option in meant if option.split()[0] in own_options]
    if here:
        hint = f"Did you mean {' or '.join(here)}?"
    elif advice := names_meant(typed, _ADVICE):
        hint = advice[0]
    elif elsewhere := commands_with(meant[0].split()[0] if meant else typed):
        option = meant[0] if meant else typed
        hint = f"{option} is an option of {', '.join(f'`gsgen {name}`' for name in elsewhere)}."
    else:
        return
    error.message = f"{error.message}. {hint}"
    error.possibilities = []


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
