"""Command-line options and console messages that several plugins share."""

__all__ = [
    "AppearanceId", "Checkpoint", "CloudFile", "CullOption", "Fps", "FrustumCull", "IterationOption", "Loop", "MaxAnchors",
    "note", "report_checkpoint", "warn_unsupported", "with_time_options",
]  # fmt: skip

import functools
import inspect
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer

from gsgen.contract._safe_text import printable

if TYPE_CHECKING:
    from gsgen.reference_plugins.loading.cfg_args import CfgArgs

Checkpoint = Annotated[
    Path, typer.Option("--checkpoint", help="Folder that training wrote.", show_default=False)
]
CloudFile = Annotated[
    Path,
    typer.Option("--checkpoint", help="Folder that training wrote, or a PLY.", show_default=False),
]
IterationOption = Annotated[
    int | None, typer.Option(help="Iteration to export.", show_default="the last, as -1", min=-1)
]
AppearanceId = Annotated[
    int | None,
    typer.Option(
        help="Keep only the appearance of this training camera.",
        show_default="an input chooses",
        min=0,
    ),
]
CullOption = Annotated[
    Literal["none", "frustum", "published"],
    typer.Option(
        "--cull",
        help="Hide anchors out of view: frustum, if no part is visible (adds the input projection); "
        "published, as the method's renderer does (adds projection and viewport).",
    ),
]
FrustumCull = Annotated[
    Literal["none", "frustum"],
    typer.Option(
        "--cull",
        help="frustum: hide anchors and cells of which no part is in view (adds the input projection).",
    ),
]
MaxAnchors = Annotated[
    int | None,
    typer.Option(
        help="Decode no more anchors a frame than this; the count says how many rows there are.",
        show_default="all",
        min=1,
    ),
]
Fps = Annotated[
    float | None, typer.Option(help="Frames a second at natural speed, for the manifest.", min=0.01)
]
Loop = Annotated[
    bool, typer.Option("--loop", help="The motion repeats: its end continues at its start.")
]

_FramesOption = Annotated[
    int | None, typer.Option(help="Distinct moments that training saw, for the manifest.", min=1)
]
_TIME_OPTIONS: dict[str, tuple[Any, Any]] = {
    "frames": (_FramesOption, None), "fps": (Fps, None), "loop": (Loop, False),
}  # fmt: skip
_OptionType = TypeVar("_OptionType")


def with_time_options(build: Callable[..., _OptionType]) -> Callable[..., _OptionType]:
    """Replace a plugin's parameter ``time`` by the options --frames, --fps and --loop.

    ``time`` is the declaration of the input for the time, with the values of these options.
    """
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(build).parameters.values():
        if parameter.name != "time":
            parameters.append(parameter)
            continue
        parameters += [
            inspect.Parameter(name, parameter.kind, default=default, annotation=annotation)
            for name, (annotation, default) in _TIME_OPTIONS.items()
        ]

    @functools.wraps(build)
    def with_options(
        *values: Any,
        frames: _FramesOption = None,
        fps: Fps = None,
        loop: Loop = False,
        **options: Any,
    ) -> _OptionType:
        from gsgen.sdk import inputs

        time = inputs.time(frames=frames, fps=fps, loop=loop or None)
        return build(*values, time=time, **options)

    # typer reads the options from the signature.
    with_options.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return with_options


def note(text: str) -> None:
    """Print a line to stderr, and overwrite the progress line that is shown there, if any."""
    clear = "\r\x1b[2K" if sys.stderr.isatty() else ""
    sys.stderr.write(f"{clear}{printable(text)}\n")


def report_checkpoint(description: str, cfg: "CfgArgs") -> None:
    """Print a checkpoint's description, and a warning for each option that is not a literal.

    None of those options was needed: reading one raises an error.
    """
    note(description)
    for name, printed_object in cfg.printed_objects().items():
        note(
            f"warning: {name}={printed_object!r:.80} in {cfg.path} is not a literal and was ignored"
        )


def warn_unsupported(cfg: "CfgArgs", expected: Mapping[str, tuple[Any, str]]) -> None:
    """Warn of training options that change the method's own result, but not the exported model.

    ``expected`` maps an option to its supported value, and to the meaning of any other value.
    """
    for name, (value, meaning) in expected.items():
        actual = cfg.values.get(name, value)
        if actual != value:
            note(f"warning: {name}={actual!r} is not supported: {meaning}")
