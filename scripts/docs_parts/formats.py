"""The splat formats, from the table of codecs."""

from docs_parts.tables import code, table
from gsgen.formats import CODECS, Codec

_HEAD = (
    "format",
    "name",
    "files",
    "",
    "loss on writing: steps, of which at most half is lost",
    "described by",
)


def splat_formats() -> str:
    """Return the table of all splat formats that gsgen reads and writes."""
    return table(_HEAD, [_row(codec) for codec in CODECS])


def _row(codec: Codec) -> tuple[str, ...]:
    source = f"[{codec.source}](https://github.com/{codec.source})"
    return (
        f"{codec.title}: {codec.contents}",
        code([codec.name]),
        code(codec.suffixes),
        "read, write" if codec.write else "read",
        codec.loss,
        source if codec.source else "[the packed layout](../spec/layout.md)",
    )
