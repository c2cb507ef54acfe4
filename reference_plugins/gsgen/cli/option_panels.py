"""Groups the options in a command's help under headings (panels)."""

__all__ = ["arrange_options", "escape_markup"]

from typing import Any, Final

OPTION_PANELS: Final[dict[str, tuple[str, ...]]] = {
    "Camera": (
        "camera", "width", "height", "size", "fov", "up", "orthographic", "panorama", "stereo",
        "eye_distance",
    ),
    "Picture": (
        "mode", "background", "sh_degree", "antialias", "rasteriser", "compact", "wsr", "post",
        "bits",
    ),
    "Time and inputs of generators": (
        "time", "pose", "inputs", "frames", "turn", "fps", "play", "provider",
    ),
    "Models of others": ("trust", "timeout", "memory"),
    "Tilesets": (
        "wait", "sse", "budget", "cache", "upload_budget", "connections", "predictor", "log",
        "generators", "allow_origin",
    ),
}  # fmt: skip
"""Panel → parameters of commands with more than :data:`_MAX_UNGROUPED_OPTIONS` options."""

_MAX_UNGROUPED_OPTIONS: Final = 20


def escape_markup(text: str) -> str:
    """Escape square brackets in help texts, which rich would read as markup."""
    return text.replace("[", r"\[")


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
        if len(options) > _MAX_UNGROUPED_OPTIONS and parameter.rich_help_panel is None:
            parameter.rich_help_panel = panels.get(parameter.name)
    for subcommand in getattr(command, "commands", {}).values():
        arrange_options(subcommand)
