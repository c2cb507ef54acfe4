"""The command `gsgen tiles plan`: chooses tiles optimally within a byte budget or deadlines."""

__all__ = ["plan"]

import json
from pathlib import Path
from typing import Annotated

import typer


def plan(
    problem: Annotated[
        Path,
        typer.Argument(
            help="JSON of kind cut (nodes, budget_bytes, loaded) or deadlines (tiles).",
            show_default=False,
        ),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
) -> None:
    """Choose the optimal tiles and file qualities within the limits that the file PROBLEM states.

    A cut takes one option on every path from the root to a leaf, within a budget of bytes; tiles
    with deadlines are sent in their order over one link. Exits 0, or 4 if PROBLEM cannot be read
    or nothing fits its budget.
    """
    from gsgen.tiles.selection.problem import solve_problem

    solution = solve_problem(problem)
    if as_json:
        document = {
            "utility": solution.utility,
            "chosen": [list(pair) for pair in solution.chosen],
            "bound": solution.bound,
        }
        typer.echo(json.dumps(document))
        return
    gap = (solution.bound - solution.utility) / solution.bound if solution.bound > 0 else 0.0
    typer.echo(
        f"utility {solution.utility:.9g}, the best there is; relaxation "
        f"{solution.bound:.9g} ({gap:.2%} above)"
    )
    for index, option in solution.chosen:
        typer.echo(f"  {index}: option {option}")
