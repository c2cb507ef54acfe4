"""The panels into which `gsgen --help` groups commands."""

__all__ = ["PANELS", "panel_of", "panel_order"]

from typing import Final

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

_OTHERS: Final = "Other commands"


def panel_of(command: str) -> str:
    """Return the help panel of a command."""
    return next((panel for panel, names in PANELS.items() if command in names), _OTHERS)


def panel_order(command: str) -> tuple[int, int, str]:
    """Return the sort key of a command in the help: panel, position in the panel, and name."""
    panel = panel_of(command)
    names = PANELS.get(panel, ())
    index = names.index(command) if command in names else len(names)
    return [*PANELS, _OTHERS].index(panel), index, command
