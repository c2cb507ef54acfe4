"""Groups commands in `gsgen --help`, and options in a command's help, under headings (panels)."""

__all__ = ["PANELS", "arrange_options", "panel_of", "panel_order"]

from typing import Any, Final

from gsgen.contract._extensions import escape_markup

PANELS: Final[dict[str, tuple[str, ...]]] = {
    "Start": ("samples", "doctor", "new"),
    "Export generators": ("export", "plugins", "fix", "rewrite", "float16"),
    "Check models": (
        "validate", "inspect", "conformance", "repro", "rules", "explain",
        "diff", "references", "vectors", "viewer-kit", "card",
    ),
    "Draw and measure": ("render", "view", "bench", "bench-render"),
    "Splat files and tilesets": ("convert", "bake", "tiles"),
}  # fmt: skip
"""Panel → commands of gsgen, in the order of the help; other packages' commands come last."""

OPTION_PANELS: Final[dict[str, tuple[str, ...]]] = {
    "Camera": ("camera", "width", "height", "size", "fov", "up", "orthographic", "panorama"),
    "Picture": (
        "mode", "background", "sh_degree", "antialias", "rasteriser", "compact", "wsr", "post",
        "bits",
    ),
    "Time and inputs of generators": (
        "time", "pose", "inputs", "frames", "turn", "fps", "play", "provider",
    ),
    "Tilesets": (
        "wait", "sse", "budget", "cache", "upload_budget", "connections", "predictor", "log",
        "generators", "allow_origin",
    ),
}  # fmt: skip
"""Panel → parameters of commands with more than :data:`_MOST_UNGROUPED` options."""

_MOST_UNGROUPED: Final = 20
_OTHERS: Final = "Other commands"


def panel_of(command: str) -> str:
    """Return the heading (panel) under which `gsgen --help` lists a command."""
    return next((panel for panel, names in PANELS.items() if command in names), _OTHERS)


def panel_order(command: str) -> tuple[int, int, str]:
    """Return the sort key of a command in the help: panel, position in the panel, and name."""
    panel = panel_of(command)
    names = PANELS.get(panel, ())
    index = names.index(command) if command in names else len(names)
    return [*PANELS, _OTHERS].index(panel), index, command


def arrange_options(command: Any) -> None:
    """Prepare the help of a click command and its subcommands for the terminal.

    Square brackets in help texts are escaped, since rich would hide `[default: …]` as markup; the
    options of commands that have many are grouped.
    """
    options = [option for option in command.params if option.param_type_name == "option"]
    panels = {name: panel for panel, names in OPTION_PANELS.items() for name in names}
    for parameter in command.params:
        if parameter.help:
            parameter.help = escape_markup(parameter.help)
        if len(options) > _MOST_UNGROUPED and parameter.rich_help_panel is None:
            parameter.rich_help_panel = panels.get(parameter.name)
    for subcommand in getattr(command, "commands", {}).values():
        arrange_options(subcommand)
