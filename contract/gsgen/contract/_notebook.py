"""Shows objects in Jupyter notebooks as HTML: a table and an embedded picture."""

__all__ = ["preview_png", "summary_html"]

import base64
from collections.abc import Callable, Sequence
from html import escape

from gsgen.contract._entry_points import registered_entry_points

_GROUP = "gsgen.previews"


def preview_png(value: object) -> bytes | None:
    """Return a PNG picture of splats or a scene; None if no renderer is installed.

    A renderer is registered under the entry point group ``gsgen.previews``.
    """
    for point in registered_entry_points(_GROUP):
        draw: Callable[[object], bytes | None] = point.load()
        if (picture := draw(value)) is not None:
            return picture
    return None


def summary_html(
    title: str, rows: Sequence[tuple[str, str]], picture: bytes | None = None, alt: str = ""
) -> str:
    """Return HTML with a title, a table of names and values, and a PNG picture."""
    lines = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(value)}</td></tr>'
        for name, value in rows
    )
    image = ""
    if picture is not None:
        data = base64.b64encode(picture).decode("ascii")
        image = f'<img alt="{escape(alt or title)}" src="data:image/png;base64,{data}">'
    return f"<div><strong>{escape(title)}</strong><table>{lines}</table>{image}</div>"
