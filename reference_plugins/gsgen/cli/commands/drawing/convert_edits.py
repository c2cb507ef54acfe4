"""The options of `gsgen convert` that edit splats, in the order typed."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from gsgen.cli.options import OPTION_ORDER
from gsgen.contract.errors import ConfigInvalid
from gsgen.formats.editing.edits import EDIT_OPTIONS, parse_edit
from gsgen.formats.editing.filters import FILTER_QUANTITIES
from gsgen.formats.editing.statistics import Statistics, summarise, write_histograms
from gsgen.formats.shared.errors import ValueInvalid
from gsgen.formats.shared.splats import Splats

_EDITS_PANEL = "Edits, in the order typed"


def _edit_option(help: str, name: str) -> Any:
    metavar = EDIT_OPTIONS[name].metavar
    return typer.Option(
        metavar=metavar, help=help, show_default=False, rich_help_panel=_EDITS_PANEL
    )


TranslateOption = Annotated[list[str] | None, _edit_option("Move, in scene units.", "translate")]
RotateOption = Annotated[
    list[str] | None,
    _edit_option("Turn about the axes x, y, z in this order, in degrees.", "rotate"),
]
Scale = Annotated[list[str] | None, _edit_option("Scale about 0,0,0.", "scale")]
WithinBoxOption = Annotated[
    list[str] | None, _edit_option("Keep the splats between two corners.", "box")
]
Sphere = Annotated[list[str] | None, _edit_option("Keep the splats in a sphere.", "sphere")]
WhereOption = Annotated[
    list[str] | None,
    _edit_option(
        f"Keep what fulfils it, such as 'opacity>=0.1'; names: {', '.join(FILTER_QUANTITIES)}.",
        "where",
    ),
]
DropFloaters = Annotated[
    list[str] | None,
    _edit_option(
        "Drop splats with fewer than COUNT others in the 27 cells of SIZE around.", "drop_floaters"
    ),
]
Decimate = Annotated[
    list[str] | None, _edit_option("Merge until N splats, or N %, are left.", "decimate")
]
Morton = Annotated[bool, _edit_option("Order along Morton's curve.", "morton")]
ShowStatistics = Annotated[
    bool,
    typer.Option(
        "--statistics",
        help="Print the distribution of each quantity.",
        rich_help_panel=_EDITS_PANEL,
    ),
]
Histograms = Annotated[
    list[Path] | None,
    typer.Option(help="Write a PNG picture of the distributions.", rich_help_panel=_EDITS_PANEL),
]


def edits_in_order(
    context: typer.Context,
    values: Mapping[str, Sequence[Any] | None],
    summaries: list[tuple[Statistics, ...]],
    merged_counts: list[tuple[int, int]],
) -> list[Callable[[Splats], Splats]]:
    """Return the splat edits of a command line as functions, in the order typed.

    Args:
        context: Knows the order of the options.
        values: Name of an option → its values; options without a value are left out.
        summaries: Receives the statistics of the splats at each ``--statistics``.
        merged_counts: Receives the numbers of splats before and after each ``--decimate``.

    Raises:
        ConfigInvalid: A value has another form than its option.
    """
    remaining_entries = {name: list(entries or ()) for name, entries in values.items()}
    edits: list[Callable[[Splats], Splats]] = []
    for name in context.meta[OPTION_ORDER]:
        if name == "statistics":
            edits.append(_observe_splats(lambda splats: summaries.append(summarise(splats))))
        elif name == "histograms":
            edits.append(_observe_splats(_histogram_writer(remaining_entries[name].pop(0))))
        elif name in EDIT_OPTIONS:
            text = remaining_entries[name].pop(0) if name in remaining_entries else ""
            try:
                edit = parse_edit(name, text)
                edits.append(_counter(edit, merged_counts) if name == "decimate" else edit)
            except ValueInvalid as error:
                option = f"--{name.replace('_', '-')}"
                raise ConfigInvalid(
                    f"is {error.message}, expected {error.expected}", where=option
                ) from error
    return edits


def _observe_splats(observe: Callable[[Splats], None]) -> Callable[[Splats], Splats]:
    def edit(splats: Splats) -> Splats:
        observe(splats)
        return splats

    return edit


def _counter(
    edit: Callable[[Splats], Splats], counts: list[tuple[int, int]]
) -> Callable[[Splats], Splats]:
    """Return an edit that also records the numbers of splats before and after it."""

    def count_splats(splats: Splats) -> Splats:
        result = edit(splats)
        counts.append((len(splats), len(result)))
        return result

    return count_splats


def _histogram_writer(path: Path) -> Callable[[Splats], None]:
    return lambda splats: write_histograms(path, splats)
