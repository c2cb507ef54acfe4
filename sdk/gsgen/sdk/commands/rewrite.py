"""`gsgen rewrite`: rewrite a graph for a consumer."""

__all__ = ["rewrite"]

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract.commands.progress import clear, progress
from gsgen.contract.errors import ConfigInvalid, ExitCode, GsgenError, ModelUnreadable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from gsgen.sdk.rewriting.rewrite import Change, Rewritten

_SHOWN = 4


def rewrite(
    model: Annotated[
        Path | None, typer.Argument(help="The ONNX file.", show_default=False)
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The rewritten copy.")
    ] = None,
    target: Annotated[
        str, typer.Option(help="Consumer to rewrite for; core means all that are known.")
    ] = "core",
    only: Annotated[
        list[str] | None,
        typer.Option("--pass", metavar="NAME", help="Run this pass alone; repeatable."),
    ] = None,
    skip: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Do not run this pass; repeatable."),
    ] = None,
    opset: Annotated[
        int | None,
        typer.Option(
            help="Operator set of the copy; by default the kernels decide.", min=7
        ),
    ] = None,
    size: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SYMBOL=SIZE", help="Give an open dimension a size; repeatable."
        ),
    ] = None,
    freeze: Annotated[
        list[str] | None, typer.Option(hidden=True, help="What --size was called.")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Write nothing; say what would change.")
    ] = False,
    listed: Annotated[
        bool, typer.Option("--list", help="List the passes, in the order they run.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Rewrite MODEL's graph so that a consumer's GPU runs it, and prove that it computes the same.

    Exits 0 if it does, 1 if it would not (then nothing is written), 4 if MODEL is no model.
    """
    from gsgen.contract.spec.targets import load_target
    from gsgen.sdk.commands.copies import copy_of
    from gsgen.sdk.commands.sizes import sizes_of
    from gsgen.sdk.rewriting.rewrite import rewrite_file

    chosen = load_target(target)
    if listed:
        _list(target, as_json)
        return
    if model is None:
        raise ConfigInvalid("no MODEL was given", where="gsgen rewrite")
    output = copy_of(output, dry_run)
    sizes = sizes_of(size, "--size") | sizes_of(freeze, "--freeze")
    try:
        done = rewrite_file(
            model,
            output,
            chosen,
            only=_split(only),
            skip=_split(skip),
            opset=opset,
            sizes=sizes,
            progress=progress,
        )
    except ConfigInvalid:
        raise
    except GsgenError as error:
        clear()
        typer.echo(f"gsgen: {error}", err=True)
        raise typer.Exit(
            ExitCode.UNREADABLE if isinstance(error, ModelUnreadable) else ExitCode.FAILURE
        ) from error
    clear()
    if as_json:
        typer.echo(json.dumps(_document(done), indent=2, ensure_ascii=False))
        return
    for line in _report(done):
        typer.echo(line)
    if done.uncompared:
        typer.echo(
            f"gsgen: {', '.join(done.uncompared)}: no finite number at any of {done.probes} probes, "
            "so the rewrite is not proven",
            err=True,
        )


def _split(names: list[str] | None) -> list[str]:
    return [name for entry in names or () for name in entry.split(",") if name]


def _list(target: str, as_json: bool) -> None:
    from gsgen.contract.spec.targets import load_target
    from gsgen.sdk.passes.framework.base import RewriteTarget
    from gsgen.sdk.passes.registry import REWRITES

    goal = RewriteTarget.of(load_target(target))
    rows = [
        {
            "name": one.name,
            "summary": one.summary(),
            "exactness": one.exactness.describe(),
            "wanted_by": one.wanted_by,
            "runs": one.for_target(goal) is not None,
        }
        for one in REWRITES
    ]
    if as_json:
        typer.echo(json.dumps(rows, indent=2, ensure_ascii=False))
        return
    width = max(len(str(row["name"])) for row in rows)
    for row in rows:
        mark = " " if row["runs"] else "-"
        typer.echo(f"{mark} {row['name']:<{width}}  {row['summary']} ({row['exactness']}).")
    if not all(row["runs"] for row in rows):
        typer.echo(f"\n- marks what target {target} does not want.")


def _report(done: "Rewritten") -> "Iterator[str]":
    for change in done.changes:
        yield f"{change.rewrite}: {_counted(change)}"
    before, after = done.before, done.after
    if not done.changes:
        yield "nothing to rewrite"
    else:
        yield f"nodes {before.nodes} → {after.nodes}, operator set {before.opset} → {after.opset}"
    yield f"not captured: {len(before.uncaptured)} nodes → {len(after.uncaptured)}"
    for line in after.uncaptured:
        yield f"  {line}"
    for one in done.refusals[:_SHOWN]:
        yield f"left by {one.rewrite}: {one.where}: {one.reason}"
    if len(done.refusals) > _SHOWN:
        yield f"… and {len(done.refusals) - _SHOWN} more were left, which --json lists"
    if done.changes:
        yield f"outputs were compared at {done.probes} probes: {_compared(done)}"
    if done.path is not None:
        yield f"wrote {done.path}"


def _counted(change: "Change") -> str:
    shown = ", ".join(change.nodes[:_SHOWN])
    more = len(change.nodes) - _SHOWN
    return f"{len(change.nodes)}× {shown}" + (f" and {more} more" if more > 0 else "")


def _compared(done: "Rewritten") -> str:
    parts = [f"{one.output} differs by {one.largest:.2g}" for one in done.differences]
    if not done.uncompared:
        return ", ".join(parts) or "equal bits"
    blank = (
        f"{', '.join(done.uncompared)} could not be judged, for want of any finite number"
    )
    return "; ".join([", ".join(parts) or "nothing differs", blank])


def _document(done: "Rewritten") -> dict[str, object]:
    return {
        "path": str(done.path) if done.path else None,
        "passes": [
            {"name": c.rewrite, "exactness": c.exactness.describe(), "nodes": c.nodes}
            for c in done.changes
        ],
        "before": asdict(done.before),
        "after": asdict(done.after),
        "probes": done.probes,
        "differences": [asdict(one) for one in done.differences],
        "unjudged": done.uncompared,
        "left": [
            {"rewrite": r.rewrite, "where": r.where, "why": r.reason} for r in done.refusals
        ],
    }
