"""Draw docs/assets/data-flow.svg: the data flow between the stages of a frame.

The names are those of `Plan.stages`, and the files those of the shaders; a test compares both.
Run it after a change to the stages: .venv/bin/python scripts/draw_data_flow.py
"""

from dataclasses import dataclass
from html import escape
from pathlib import Path

PICTURE = Path(__file__).parents[1] / "docs" / "assets" / "data-flow.svg"

BOX_WIDTH, BOX_HEIGHT = 104, 46  # of a box
COLUMNS = (14, 146, 278, 410, 542, 674, 806)  # left edges
QUADS, SORTED, SUMMED, MESHES = 18, 96, 196, 296  # upper edges of the rows
SIZE = (924, 376)

DATA, STAGE, HARDWARE = "#e8eef7", "#fdf1d8", "#e3f1e2"
INK, LINE = "#242a33", "#6b7480"


@dataclass(frozen=True, slots=True)
class Box:
    """A box of the diagram: data or a stage of a frame.

    Attributes:
        column: Which of the columns it stands in.
        top: Its upper edge.
        name: Of the stage or the data; ``/`` parts two stages.
        below: What it does, or the shader that does it.
        fill: Its colour: data, compute shaders, or the hardware's rasteriser.
    """

    column: int
    top: int
    name: str
    below: str
    fill: str = STAGE

    @property
    def left(self) -> int:
        """The left edge."""
        return COLUMNS[self.column]

    @property
    def middle(self) -> int:
        """Halfway down."""
        return self.top + BOX_HEIGHT // 2

    def svg(self) -> str:
        """The box with its two lines of text."""
        x = self.left + BOX_WIDTH / 2
        return (
            f'<rect x="{self.left}" y="{self.top}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="6" '
            f'fill="{self.fill}" stroke="{LINE}"/>\n'
            f'<text x="{x:g}" y="{self.top + 20}" font-size="13" font-weight="600">'
            f"{escape(self.name)}</text>\n"
            f'<text x="{x:g}" y="{self.top + 36}" font-size="10.5">{escape(self.below)}</text>'
        )


GAUSSIANS = Box(0, SORTED, "Gaussians", "rows, harmonics", DATA)
CELLS = Box(0, SUMMED, "with cells", "rows, ellipsoids", DATA)
TRIANGLES = Box(0, MESHES, "meshes", "triangles, colours", DATA)
PROJECT = Box(1, SORTED, "project", "to splats")
SORT = Box(2, SORTED, "sort", "by depth")
BIN = Box(3, SORTED, "bin", "pairs with tiles")
GROUP = Box(4, SORTED, "group", "by tile")
BLEND = Box(5, SORTED, "blend", "depth, normal too")
IMAGES = Box(6, SORTED, "images", "read with counts", DATA)
BOXES = (
    Box(0, QUADS, "keys", "too many splats:"),
    Box(1, QUADS, "tally", "slabs of depth"),
    Box(3, QUADS, "quads", "instead of tiles", HARDWARE),
    *(GAUSSIANS, PROJECT, SORT, BIN, GROUP, BLEND, IMAGES),
    *(CELLS, TRIANGLES),
    Box(1, SUMMED, "project cells", "and their rows"),
    Box(2, SUMMED, "sort cells", "by depth"),
    Box(3, SUMMED, "bin cells", "pairs with tiles"),
    Box(4, SUMMED, "group cells", "by tile"),
    Box(5, SUMMED, "sum", "cell by cell"),
    Box(1, MESHES, "draw", "nearest triangle", HARDWARE),
    Box(2, MESHES, "meshes", "colour and depth"),
)
LAYERS = Box(6, SUMMED, "layers", "colour, depth", DATA)


def arrow(*points: tuple[float, float]) -> str:
    """A line through the points, with a head at the last."""
    path = " ".join(f"{x:g},{y:g}" for x, y in points)
    return f'<polyline points="{path}" fill="none" stroke="{LINE}" stroke-width="1.4" marker-end="url(#head)"/>'


def between(row: int, first: int, last: int) -> list[str]:
    """Arrows from column to column."""
    y = row + BOX_HEIGHT / 2
    return [
        arrow((COLUMNS[column] + BOX_WIDTH, y), (COLUMNS[column + 1] - 3, y))
        for column in range(first, last)
    ]


def arrows() -> list[str]:
    """Everything that one box gives to another."""
    half = BOX_WIDTH / 2
    quads_y, mesh_y = QUADS + BOX_HEIGHT / 2, MESHES + BOX_HEIGHT / 2
    sum_x, layers_x, blend_x = (COLUMNS[5] + half, COLUMNS[6] + half, COLUMNS[5] + half)
    turn = (SORTED + BOX_HEIGHT + SUMMED) / 2
    return [
        *between(SORTED, 0, 6),
        *between(SUMMED, 0, 6),
        *between(MESHES, 0, 2),
        # Gaussians → keys → tally → project, where slabs are drawn
        arrow((COLUMNS[0] + half, SORTED), (COLUMNS[0] + half, QUADS + BOX_HEIGHT + 3)),
        *between(QUADS, 0, 1),
        arrow((COLUMNS[1] + half, QUADS + BOX_HEIGHT), (COLUMNS[1] + half, SORTED - 3)),
        # sort → quads → images
        arrow(
            (COLUMNS[2] + half, SORTED), (COLUMNS[2] + half, quads_y), (COLUMNS[3] - 3, quads_y)
        ),
        arrow((COLUMNS[3] + BOX_WIDTH, quads_y), (layers_x, quads_y), (layers_x, SORTED - 3)),
        # layers → blend
        arrow((layers_x, SUMMED), (layers_x, turn), (blend_x, turn), (blend_x, SORTED + BOX_HEIGHT + 3)),
        # meshes → layers, and where sums stop
        arrow((COLUMNS[2] + BOX_WIDTH, mesh_y), (layers_x, mesh_y), (layers_x, SUMMED + BOX_HEIGHT + 3)),
        arrow((sum_x, mesh_y), (sum_x, SUMMED + BOX_HEIGHT + 3)),
    ]  # fmt: skip


def note(x: float, y: float, text: str) -> str:
    """A word on an arrow."""
    return f'<text x="{x:g}" y="{y:g}" font-size="10.5" fill="{LINE}">{escape(text)}</text>'


def drawn() -> str:
    """Return the picture."""
    notes = [
        note(COLUMNS[6] - 62, MESHES + BOX_HEIGHT / 2 + 16, "opaque layer"),
        note(COLUMNS[5] + BOX_WIDTH / 2 - 44, SUMMED + BOX_HEIGHT + 30, "stops at depth"),
        note(COLUMNS[4] + BOX_WIDTH + 14, QUADS + BOX_HEIGHT / 2 - 6, "colours, by hardware blending"),
    ]  # fmt: skip
    legend = [
        f'<rect x="{x}" y="{MESHES + 52}" width="11" height="11" rx="2" fill="{fill}" '
        f'stroke="{LINE}"/>\n<text x="{x + 17}" y="{MESHES + 62}" font-size="10.5" '
        f'text-anchor="start">{text}</text>'
        for x, fill, text in (
            (COLUMNS[3], DATA, "data"),
            (COLUMNS[3] + 62, STAGE, "compute shaders"),
            (COLUMNS[3] + 190, HARDWARE, "the hardware's rasteriser"),
        )
    ]
    body = [*arrows(), *(box.svg() for box in (*BOXES, LAYERS)), *notes, *legend]
    width, height = SIZE
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
            f'width="{width}" height="{height}" font-family="system-ui, sans-serif" '
            f'text-anchor="middle" fill="{INK}">',
            '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
            f'markerHeight="7" orient="auto"><path d="M0,0 L8,4 L0,8 z" fill="{LINE}"/>'
            "</marker></defs>",
            f'<rect width="{width}" height="{height}" rx="8" fill="#fafaf8"/>',
            *body,
            "</svg>\n",
        ]
    )


if __name__ == "__main__":
    PICTURE.write_text(drawn(), "utf-8")
