"""The commands of the `gsgen` program as data: name, summary, module, and the extra they need."""

__all__ = ["PANELS", "Command", "find_command", "panels"]

from dataclasses import dataclass
from importlib.metadata import EntryPoint
from typing import Final

from gsgen.contract._entry_points import Extension, find_extensions

_ENTRY_POINT_GROUP: Final = "gsgen.commands"


@dataclass(frozen=True, slots=True)
class Command:
    """A command of the `gsgen` program, whose code is imported when it runs.

    Attributes:
        name: The word that users type after ``gsgen``.
        summary: The first paragraph of the command's help.
        code: The typer function, or the :class:`typer.Typer`.
    """

    name: str
    summary: str
    code: Extension


def _make_command(name: str, summary: str, module_path: str) -> Command:
    """Return a command of ours; ``module_path`` is its module and function below gsgen.cli.commands."""
    point = EntryPoint(name, f"gsgen.cli.commands.{module_path}", _ENTRY_POINT_GROUP)
    return Command(name, summary, Extension(name, point))


PANELS: Final[dict[str, tuple[Command, ...]]] = {
    "Start": (
        _make_command(
            "samples",
            "Write sample files into DIR: a garden of splats, cameras, a generator and a motion for it.",
            "exporting.samples:samples",
        ),
        _make_command(
            "doctor",
            "Show versions, drivers and adapters, and how to install missing parts.",
            "checking.doctor:doctor",
        ),
        _make_command(
            "new",
            "Create a plugin package NAME: a method, its export command, and passing tests.",
            "exporting.new:new",
        ),
    ),
    "Export generators": (
        _make_command(
            "export",
            "Export a Gaussian Generator from your torch module, or from the files of a method.",
            "exporting.export:app",
        ),
        _make_command(
            "plugins",
            "List the installed plugins: method, model inputs, and the files that each reads.",
            "exporting.plugins:plugins",
        ),
        _make_command(
            "fix",
            "Write a repaired copy of MODEL, and list the changes.",
            "exporting.fix:fix [sdk]",
        ),
        _make_command(
            "rewrite",
            "Rewrite MODEL's graph for a target GPU, and verify that it computes the same outputs.",
            "exporting.rewrite:rewrite [sdk]",
        ),
        _make_command(
            "float16",
            "Write a float16 copy of MODEL; nodes whose rounding error is too large stay float32.",
            "exporting.float16:float16 [sdk]",
        ),
    ),
    "Check models": (
        _make_command(
            "validate",
            "Check whether the given ONNX models conform to the Gaussian Generator contract.",
            "checking.validate:validate",
        ),
        _make_command(
            "inspect",
            "Show a model's inputs, outputs and manifest; its weights are not read.",
            "checking.inspect:inspect",
        ),
        _make_command(
            "conformance",
            "Run conformance suites on each MODEL, and print a command that reproduces each failure.",
            "checking.conformance:conformance",
        ),
        _make_command(
            "repro",
            "Check one rule of MODEL again, with one probe (set of test inputs) if that is enough.",
            "checking.repro:repro",
        ),
        _make_command(
            "rules",
            "List every validation rule: id, severity, level, name and statement.",
            "checking.rules:rules",
        ),
        _make_command(
            "explain",
            "Explain what the rule RULE requires, why, and how to repair a model that breaks it.",
            "checking.explain:explain",
        ),
        _make_command(
            "diff",
            "Compare the declarations, the graphs and the outputs of two ONNX models.",
            "checking.diff:diff",
        ),
        _make_command(
            "references",
            "Write a copy of MODEL with reference images, drawn by MODEL or by its training code.",
            "drawing.references:references [runtime]",
        ),
        _make_command(
            "vectors",
            "Write test vectors of MODEL, and a copy of MODEL whose manifest lists them.",
            "checking.vectors:vectors",
        ),
        _make_command(
            "viewer-kit",
            "Test a viewer: small models, expected pictures, and a verdict for each test.",
            "checking.viewer_kit:app",
        ),
        _make_command(
            "card",
            "Write a model card of MODEL: description, inputs, a picture, and the validation verdict.",
            "checking.card:card",
        ),
    ),
    "Draw and measure": (
        _make_command(
            "render",
            "Draw SCENES: splat files and meshes, and generators, which run for every frame.",
            "drawing.render:render [runtime]",
        ),
        _make_command(
            "view",
            "Show SCENES in a window: orbit around them, play their time, and save pictures.",
            "drawing.view:view [runtime]",
        ),
        _make_command(
            "bench",
            "Measure the time and memory of a frame of each MODEL on each execution provider.",
            "exporting.bench:bench",
        ),
        _make_command(
            "bench-render",
            "Measure the time and the memory of a frame of SCENES, stage by stage.",
            "drawing.bench_render:bench_render [runtime]",
        ),
    ),
    "Splat files and tilesets": (
        _make_command(
            "convert",
            "Write the splats of SOURCE to TARGET in another format, and print the losses.",
            "drawing.convert:convert",
        ),
        _make_command(
            "bake",
            "Write frames of a generator as plain splat files, which every viewer reads.",
            "drawing.bake:bake",
        ),
        _make_command(
            "tiles",
            "Build, look into and serve tilesets of splats: 3D Tiles 1.1, coarse above, fine below.",
            "tiles.group:app",
        ),
    ),
}
"""Panel → commands of gsgen, in the order of the help; other packages' commands come last."""


def find_command(name: str) -> Command | None:
    """Return the command ``name`` of gsgen or of another package; None if there is none.

    Other packages register theirs under the entry point group ``gsgen.commands``.
    """
    own_commands = {command.name: command for commands in PANELS.values() for command in commands}
    return own_commands.get(name) or _extension_commands().get(name)


def panels() -> dict[str, tuple[Command, ...]]:
    """Return panel → commands of gsgen and of other packages, in the order of the help."""
    own_commands = {command.name for commands in PANELS.values() for command in commands}
    extension_commands = tuple(
        command for name, command in _extension_commands().items() if name not in own_commands
    )
    return PANELS | ({"Other commands": extension_commands} if extension_commands else {})


def _extension_commands() -> dict[str, Command]:
    return {
        name: Command(name, f"A command of the package {code.owner}.", code)
        for name, code in find_extensions(_ENTRY_POINT_GROUP).items()
    }
