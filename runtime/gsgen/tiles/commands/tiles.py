"""The command group `gsgen tiles`: build, inspect, pack, score and serve tilesets."""

__all__ = ["app"]

import typer

from gsgen.tiles.commands.build import build
from gsgen.tiles.commands.info import info
from gsgen.tiles.commands.pack import pack
from gsgen.tiles.commands.score import score
from gsgen.tiles.commands.serve import serve
from gsgen.tiles.commands.simulate import simulate

app = typer.Typer(
    help="Build, look into and serve tilesets of splats: 3D Tiles 1.1, coarse above, fine below.",
    no_args_is_help=True,
)


@app.callback()
def _group() -> None:
    pass


app.command("build")(build)
app.command("info")(info)
app.command("pack")(pack)
app.command("score")(score)
app.command("serve")(serve)
app.command("simulate")(simulate)
