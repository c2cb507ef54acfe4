"""The command `gsgen tiles simulate`: streams a tileset over a simulated network."""

__all__ = ["simulate"]

from contextlib import nullcontext
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gsgen.cli.output import echo, echo_json
from gsgen.contract.errors import ConfigInvalid


class PolicyName(StrEnum):
    """The prefetch policies that `gsgen tiles simulate` compares."""

    REACTIVE = "reactive"
    PREDICTIVE = "predictive"
    ORACLE = "oracle"
    ALL_POLICIES = "all"


TilesetArgument = Annotated[
    str,
    typer.Argument(
        help="tileset.json, its folder, a .3tz archive, or an address (http, https).",
        show_default=False,
    ),
]
PathOption = Annotated[
    Path,
    typer.Option(
        help="CSV t,x,y,z,qw,qx,qy,qz: camera to tileset, OpenCV axes, a frame a row.",
        show_default=False,
    ),
]
NetworkOption = Annotated[
    Path,
    typer.Option(
        help="CSV t,mbps: megabits a second from each time on; the last for ever.",
        show_default=False,
    ),
]
PolicyOption = Annotated[
    PolicyName,
    typer.Option(
        help="Ask for seen tiles (reactive), also for predicted ones, or for those that the "
        "path will see (oracle); all compares them."
    ),
]


def simulate(
    tileset: TilesetArgument,
    path: PathOption,
    network: NetworkOption,
    policy: PolicyOption = PolicyName.REACTIVE,
    predictor: Annotated[
        str, typer.Option(help="constant-velocity, none, or an ONNX file.", metavar="NAME|FILE")
    ] = "constant-velocity",
    width: Annotated[int, typer.Option(help="Of the image, in pixels.", min=1)] = 1280,
    height: Annotated[int, typer.Option(help="Of the image, in pixels.", min=1)] = 720,
    fov: Annotated[float, typer.Option(help="Vertical field of view, in degrees.")] = 50.0,
    sse: Annotated[
        float, typer.Option(help="Screen-space error, in pixels, above which tiles are refined.")
    ] = 16.0,
    rtt: Annotated[
        float, typer.Option(help="Milliseconds from a request to its first byte.", min=0)
    ] = 50.0,
    connections: Annotated[
        int, typer.Option(help="How many requests may run at once.", min=1, max=64)
    ] = 1,
    score: Annotated[
        str,
        typer.Option(
            help="Seconds of the path at which the picture is compared, by SSIM, with that of all "
            "tiles, such as 1,2,5.",
            show_default=False,
        ),
    ] = "",
    plot: Annotated[
        Path | None, typer.Option(help="Draw loaded tiles and received bytes over time.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Stream TILESET along a camera path over a simulated network, on a virtual clock.

    Planner and predictor are those of the viewer. Equal arguments give equal results. Exits 0,
    2 for wrong options, or 4 if a file cannot be read.
    """
    from gsgen.cli.commands.drawing.opening import confined_models
    from gsgen.contract.process.atomic_files import refuse_itself
    from gsgen.contract.process.limits import FRAME_SECONDS, Limits
    from gsgen.tiles.loading.quality_ladder import quality_ladder
    from gsgen.tiles.loading.tileset_loader import load_tileset
    from gsgen.tiles.prediction.predictors import PREDICTORS_BY_NAME, predictor_maker
    from gsgen.tiles.prediction.prefetch import ViewSettings
    from gsgen.tiles.selection.tile_tree import TileTree
    from gsgen.tiles.simulate import client
    from gsgen.tiles.simulate.report import format_table, metrics_document, write_plot
    from gsgen.tiles.simulate.tables import read_path, read_trace
    from gsgen.tiles.stores.opening import open_store

    for name, value, most in (("--fov", fov, 180.0), ("--sse", sse, float("inf"))):
        if not 0 < value < most:
            raise ConfigInvalid(f"is {value}, expected above 0 and below {most:g}", where=name)
    if plot is not None:
        refuse_itself(plot, [Path(tileset), Path(predictor), path, network])
    try:
        moments = sorted({float(word) for word in score.split(",") if score})
    except ValueError as error:
        expected = "expected seconds such as 1,2,5"
        raise ConfigInvalid(f"is {score!r:.60}, {expected}", where="--score") from error
    is_model = predictor not in PREDICTORS_BY_NAME
    models = [Path(predictor)] if is_model else []
    confined = confined_models((), models, Limits(seconds=FRAME_SECONDS))
    make_predictor = predictor_maker(predictor, confined)
    poses, trace = read_path(path), read_trace(network)
    span = poses[-1].time - poses[0].time
    if not all(0 <= seconds <= span for seconds in moments):
        raise ConfigInvalid(
            f"is {score!r:.60}, expected seconds from 0 to {span:g}, as long as the path is",
            where="--score",
        )
    view = ViewSettings(width=width, height=height, fov_y=fov, max_error=sse)
    is_all = policy is PolicyName.ALL_POLICIES
    policies = [entry for entry in client.PREFETCH_POLICIES if is_all or entry == policy]
    store, index = open_store(tileset)
    with store, confined or nullcontext():
        loaded = load_tileset(store, index, name=tileset)
        tree, ladder = TileTree.of_tileset(loaded, store), quality_ladder(loaded)
        simulations = [
            client.simulate(
                tree,
                poses,
                trace,
                ladder=ladder,
                policy=entry,
                predictor=make_predictor,
                view=view,
                rtt=rtt / 1000,
                connections=connections,
                moments=moments,
            )
            for entry in policies
        ]
        if moments:
            from gsgen.tiles.simulate.pictures import TilePictures

            pictures = TilePictures(store, loaded, ladder, view)
            simulations = [pictures.score(entry) for entry in simulations]
    if plot is not None:
        write_plot(simulations, plot)
    if not as_json:
        echo(*format_table(simulations).split("\n"))
    elif len(simulations) == 1:
        echo_json(metrics_document(simulations[0]), indent=None)
    else:
        echo_json([metrics_document(entry) for entry in simulations], indent=None)
