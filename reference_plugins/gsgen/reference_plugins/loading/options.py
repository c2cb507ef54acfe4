"""Options that the plugins of checkpoints share, and how they say what they found."""

__all__ = [
    "AppearanceId",
    "Checkpoint",
    "CullOption",
    "Fps",
    "Frames",
    "Iteration",
    "Loop",
    "MaxAnchors",
    "note",
    "tell",
    "warn_of",
]

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

if TYPE_CHECKING:
    from gsgen.reference_plugins.loading.cfg_args import CfgArgs

Checkpoint = Annotated[
    Path,
    typer.Option("--checkpoint", help="Folder that training wrote.", show_default=False),
]
Iteration = Annotated[
    int | None,
    typer.Option(help="Which iteration to take.", show_default="the last, as -1", min=-1),
]
AppearanceId = Annotated[
    int | None,
    typer.Option(
        help="Keep the appearance of this training camera alone.",
        show_default="an input chooses",
        min=0,
    ),
]
CullOption = Annotated[
    Literal["none", "frustum", "published"],
    typer.Option(
        "--cull",
        help="Hide anchors out of view: frustum surely so (adds the input projection), published "
        "as the method's renderer does (adds projection and viewport).",
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
Frames = Annotated[
    int | None,
    typer.Option(help="Distinct moments that training saw, for the manifest.", min=1),
]
Fps = Annotated[
    float | None,
    typer.Option(help="Frames a second at natural speed, for the manifest.", min=0.01),
]
Loop = Annotated[bool, typer.Option("--loop", help="The end continues at the start.")]


def note(text: str) -> None:
    """Say something about the checkpoint, on a line of its own even while progress is shown."""
    clear = "\r\x1b[2K" if sys.stderr.isatty() else ""
    typer.echo(f"{clear}{text}", err=True)


def tell(what: str, cfg: "CfgArgs") -> None:
    """Say what a checkpoint holds, and which options of its run are no literals.

    Nothing was wanted of those: whoever reads one that is none has refused it before.
    """
    note(what)
    for name, printed in cfg.printed().items():
        note(f"warning: {name}={printed!r:.80} in {cfg.path} is no literal; it is not read")


def warn_of(cfg: "CfgArgs", expected: Mapping[str, tuple[Any, str]]) -> None:
    """Warn of options that changed the result where the checkpoint came from, but not here.

    Args:
        cfg: The options of the training run.
        expected: Option → the one value that we honour, and what another would mean.
    """
    for name, (value, meaning) in expected.items():
        seen = cfg.values.get(name, value)
        if seen != value:
            note(f"warning: {name}={seen!r} is not honoured: {meaning}")
