"""Shows objects in Jupyter notebooks as HTML: a table and an embedded picture."""

__all__ = ["draw_previews_with", "preview_png", "summary_html"]

import base64
from collections.abc import Callable, Sequence

from gsgen.contract._safe_text import for_html

_renderers: "list[Callable[[object], bytes | None]]" = []


def draw_previews_with(draw: Callable[[object], bytes | None]) -> None:
    """Draw previews with a function, which returns a PNG, or None for what it cannot draw."""
    _renderers.append(draw)


def preview_png(value: object) -> bytes | None:
    """Return a PNG picture of splats or a scene; None if no renderer draws it."""
    for draw in _renderers:
        if (picture := draw(value)) is not None:
            return picture
    return None


def summary_html(
    title: str, rows: Sequence[tuple[str, str]], picture: bytes | None = None, alt_text: str = ""
) -> str:
    """Return HTML with a title, a table of names and values, and a PNG picture."""
    lines = "".join(
        f'<tr><th style="text-align:left">{for_html(name)}</th>'
        f'<td style="text-align:left">{for_html(value)}</td></tr>'
        for name, value in rows
    )
    image = ""
    if picture is not None:
        data = base64.b64encode(picture).decode("ascii")
        image = f'<img alt="{for_html(alt_text or title)}" src="data:image/png;base64,{data}">'
    return f"<div><strong>{for_html(title)}</strong><table>{lines}</table>{image}</div>"
