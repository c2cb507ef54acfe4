"""Options that several commands have, each with its words."""

from pathlib import Path
from typing import Annotated, Literal

import typer

__all__ = [
    "Antialias",
    "Axis",
    "Compact",
    "FieldOfView",
    "Height",
    "Post",
    "Provider",
    "RasteriserName",
    "Scenes",
    "ShDegree",
    "Sizes",
    "Width",
]

Antialias = Annotated[
    Literal["classic", "mip"] | None,
    typer.Option(help="How the scene was trained. [default: the manifest's, or classic]"),
]
Axis = Annotated[
    Literal["+x", "-x", "+y", "-y", "+z", "-z"] | None,
    typer.Option(help="Which axis points up. [default: the manifest's, or -y]"),
]
Compact = Annotated[
    bool,
    typer.Option(
        "--compact",
        help="Keep Gaussians in about half the memory; colours are off by less than a hundredth.",
    ),
]
FieldOfView = Annotated[
    float | None, typer.Option(help="Vertical field of view, in degrees. [default: 50]")
]
Height = Annotated[
    int | None, typer.Option(help="Pixels. [default: the camera's, or 720]", min=1)
]
Post = Annotated[
    list[Path] | None,
    typer.Option(
        help="A post-process model that the picture goes through; repeatable, in this order."
    ),
]
Provider = Annotated[
    Literal["auto", "cpu", "webgpu", "cuda"],
    typer.Option(help="What ONNX Runtime runs models on."),
]
RasteriserName = Annotated[
    Literal["auto", "tiles", "quads"],
    typer.Option(help="What blends: compute shaders, the hardware, or the faster one."),
]
Scenes = Annotated[
    list[Path],
    typer.Argument(
        help="Splat files, meshes, ONNX generators and scene.json; several are one scene.",
        show_default=False,
    ),
]
ShDegree = Annotated[
    int | None, typer.Option(help="Use no harmonics above this degree.", min=0, max=3)
]
Sizes = Annotated[
    list[str] | None,
    typer.Option(
        metavar="SYMBOL=SIZE", help="Give an open dimension of a model a size; repeatable."
    ),
]
Width = Annotated[
    int | None, typer.Option(help="Pixels. [default: the camera's, or 1280]", min=1)
]
