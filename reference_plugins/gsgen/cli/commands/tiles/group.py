"""The command group `gsgen tiles`: build, inspect, pack, score and serve tilesets."""

__all__ = ["app"]

import typer

from gsgen.cli.command_group import SubcommandGroup
from gsgen.cli.commands.tiles.build import build
from gsgen.cli.commands.tiles.info import info
from gsgen.cli.commands.tiles.pack import pack
from gsgen.cli.commands.tiles.score import score
from gsgen.cli.commands.tiles.serve import serve
from gsgen.cli.commands.tiles.simulate import simulate

app = typer.Typer(
    cls=SubcommandGroup,
    help="Build, look into and serve tilesets of splats: 3D Tiles 1.1, coarse above, fine below.",
    no_args_is_help=True,
)


@app.callback()
def _command_group_root() -> None:
    pass


app.command("build")(build)
app.command("info")(info)
app.command("pack")(pack)
app.command("score")(score)
app.command("serve")(serve)
app.command("simulate")(simulate)
