"""Draw docs/assets/rooms.svg: the rooms of the house, lowest first, and who imports whom.

Everything is read from the code: the order from the layers of import-linter, the arcs from the
imports, lazy ones included, and dashed arcs from entry points and names of modules in strings. An
arc that longer arcs imply is left out. Prints how many imports point up, how many circles there
are, and how many calls upward no import shows. Run it after a change to the rooms:
.venv/bin/python scripts/draw_rooms.py
"""

from html import escape
from pathlib import Path

from docs_parts.rooms import (
    PUBLIC_GROUPS,
    Room,
    called_units,
    circles,
    imported_units,
    rank,
    room_of,
    rooms,
)

PICTURE = Path(__file__).parents[1] / "docs" / "assets" / "rooms.svg"

LINE_HEIGHT = 19
TOP = 30
NAMES_X = 250  # of the column of names; arcs lie left of it
WIDTH = 1040
WIDEST_ARC = 225  # how far the longest arc reaches to the left
FILLS = {
    "contract": "#e8eef7",
    "conformance": "#eef4fb",
    "cli": "#eef4fb",
    "formats": "#f3f0e4",
    "sdk": "#fdf1d8",
    "runtime": "#e3f1e2",
    "tiles": "#d6eadb",
    "reference_plugins": "#f6e4ea",
}
INK, LINE, FAINT = "#242a33", "#6b7480", "#59616d"


def drawn_rooms() -> list[Room]:
    """Return the rooms of the picture, highest first, as the house stands."""
    return [room for room in reversed(rooms()) if room.name.count(".") > 1 and room.modules]


def arcs(names: list[str]) -> list[tuple[str, str]]:
    """Return the imports that no chain of other imports implies: (importer, imported)."""
    direct: dict[str, set[str]] = {name: set() for name in names}
    for unit, targets in imported_units().items():
        if room_of(unit) in direct:
            direct[room_of(unit)] |= {room_of(target) for target in targets} & set(names)
    direct = {name: targets - {name} for name, targets in direct.items()}

    def is_implied(name: str, target: str) -> bool:
        """Return whether a chain leads from a room to another one that it also imports directly."""
        # Chains do not come back to the room: rooms may import each other where modules do not.
        pending, seen = sorted(direct[name] - {target}), {name, target}
        while pending:
            between = pending.pop()
            if target in direct[between]:
                return True
            seen.add(between)
            pending += direct[between] - seen
        return False

    return [
        (name, target)
        for name in names
        for target in sorted(direct[name])
        if not is_implied(name, target)
    ]


def imports_up() -> list[tuple[str, str]]:
    """Return the imports of rooms by rooms that stand below them."""
    pairs = [(name, target) for name, targets in imported_units().items() for target in targets]
    return sorted((name, target) for name, target in pairs if rank(name) < rank(target))


def calls_up(*, public: bool) -> list[tuple[str, str, str]]:
    """Return the calls upward that no import shows: caller, called room, group or module.

    Args:
        public: Return those through entry-point groups that third parties use, instead of others.
    """
    return sorted(
        (caller, called, word)
        for caller, called, word in called_units()
        if rank(caller) < rank(called) and (word in PUBLIC_GROUPS) is public
    )


def drawn() -> str:
    """Return the picture as SVG."""
    listed = drawn_rooms()
    names = [room.name for room in listed]
    heights = {name: TOP + LINE_HEIGHT * row for row, name in enumerate(names)}
    height = TOP + LINE_HEIGHT * len(names) + 10
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
        f'font-family="system-ui, sans-serif" fill="{INK}">',
        f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>',
        f'<text x="{NAMES_X}" y="16" font-size="11" fill="{FAINT}">room (modules) and its question;'
        " an arc leads from a room down to a room that it imports, a dashed one to a room whose"
        " entry points it loads</text>",
    ]
    parts += [_arc(heights[a], heights[b], len(names)) for a, b in arcs(names)]
    called = {(room_of(a), room_of(b)) for a, b, _ in called_units()}
    called = {pair for pair in called if set(pair) <= set(heights)}
    parts += [_arc(heights[a], heights[b], len(names), dashed=True) for a, b in sorted(called)]
    parts += [_line(room, heights[room.name]) for room in listed]
    return "\n".join([*parts, "</svg>"]) + "\n"


def _arc(start: int, end: int, rows: int, *, dashed: bool = False) -> str:
    reach = WIDEST_ARC * (abs(end - start) / LINE_HEIGHT / rows) ** 0.6
    style = ' stroke-dasharray="3 3"' if dashed else ""
    x, y0, y1 = NAMES_X - 6, start + 9, end + 9
    return (
        f'<path d="M{x} {y0} C{x - reach:.0f} {y0} {x - reach:.0f} {y1} {x} {y1}" '
        f'fill="none" stroke="{LINE}" stroke-opacity="0.55"{style}/>'
    )


def _line(room: Room, top: int) -> str:
    package = room.name.split(".")[1]
    name = room.name.removeprefix("gsgen.")
    return (
        f'<rect x="{NAMES_X}" y="{top + 1}" width="{WIDTH - NAMES_X - 10}" height="{LINE_HEIGHT - 2}" '
        f'rx="3" fill="{FILLS[package]}"/>'
        f'<text x="{NAMES_X + 6}" y="{top + 14}" font-size="12" font-weight="600">'
        f"{escape(name)} ({room.modules})</text>"
        f'<text x="{NAMES_X + 240}" y="{top + 14}" font-size="11">{escape(room.question)}</text>'
    )


if __name__ == "__main__":
    PICTURE.write_text(drawn(), "utf-8")
    up, hidden, public = imports_up(), calls_up(public=False), calls_up(public=True)
    for line in (*up, *circles(), *hidden):
        print(line)
    print(f"imports back up {len(up)}, circles {len(circles())}, hidden calls upward {len(hidden)}")
    print(f"calls upward through the groups that third parties use: {len(public)}")
