"""`gsgen rewrite`: rewrite a model's graph for a runtime, such as WebGPU."""

__all__ = ["rewrite"]

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.cli.model_options import (
    DryRun,
    PrintJsonOption,
    Sizes,
    copy_of,
    exit_at_error,
    first_names,
    sizes_of,
)
from gsgen.cli.options import complete_targets
from gsgen.cli.output import echo, echo_json
from gsgen.cli.progress import progress
from gsgen.contract.errors import ConfigInvalid

if TYPE_CHECKING:
    from collections.abc import Iterator

    from gsgen.sdk.rewriting.rewrite import RewriteResult

_MAX_NAMES = 4


def rewrite(
    model: Annotated[Path | None, typer.Argument(help="The ONNX file.", show_default=False)] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The rewritten copy.")
    ] = None,
    target: Annotated[
        str,
        typer.Option(
            help="Consumer to rewrite for; core means all known ones.",
            autocompletion=complete_targets,
        ),
    ] = "core",
    only: Annotated[
        list[str] | None,
        typer.Option("--pass", metavar="NAME", help="Run only this pass; repeatable."),
    ] = None,
    skip: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Do not run this pass; repeatable.")
    ] = None,
    opset: Annotated[
        int | None,
        typer.Option(help="Operator set of the copy; the kernels decide by default.", min=7),
    ] = None,
    size: Sizes = None,
    dry_run: DryRun = False,
    listed: Annotated[
        bool, typer.Option("--list", help="List the passes in the order in which they run.")
    ] = False,
    as_json: PrintJsonOption = False,
) -> None:
    """Rewrite MODEL's graph for a target GPU, and verify that it computes the same outputs.

    Exits 0 if it does, 1 if it does not (then nothing is written), 4 if MODEL is not a model.
    """
    from gsgen.contract.spec.targets import load_target
    from gsgen.sdk.rewriting.rewrite import rewrite_file

    consumer = load_target(target)
    if listed:
        _list_rewrites(target, as_json=as_json)
        return
    if model is None:
        raise ConfigInvalid("MODEL is missing, expected an ONNX file", where="gsgen rewrite")
    output = copy_of(output, dry_run=dry_run)
    sizes = sizes_of(size)
    with exit_at_error():
        result = rewrite_file(
            model,
            output,
            consumer,
            only=_split_names(only),
            skip=_split_names(skip),
            opset=opset,
            sizes=sizes,
            progress=progress,
        )
    if as_json:
        echo_json(_document(result))
        return
    _show_result(result)


def _show_result(result: "RewriteResult") -> None:
    """Print the report of a graph rewrite, and a warning for outputs that were not compared."""
    for line in _report(result):
        echo(line)
    if result.uncompared:
        names = ", ".join(result.uncompared)
        message = (
            f"no finite number at any of {result.probes} probes, so the rewrite is not verified"
        )
        echo(f"gsgen: {names}: {message}", err=True)


def _split_names(names: list[str] | None) -> list[str]:
    return [name for entry in names or () for name in entry.split(",") if name]


def _list_rewrites(target: str, *, as_json: bool) -> None:
    from gsgen.contract.spec.targets import load_target
    from gsgen.sdk.passes.framework.base import RewriteTarget
    from gsgen.sdk.passes.registry import REWRITES

    rewrite_target = RewriteTarget.of(load_target(target))
    rows = [
        {
            "name": rewrite_class.name,
            "summary": rewrite_class.summary(),
            "exactness": rewrite_class.exactness.describe(),
            "wanted_by": rewrite_class.wanted_by,
            "runs": rewrite_class.for_target(rewrite_target) is not None,
        }
        for rewrite_class in REWRITES
    ]
    if as_json:
        echo_json(rows)
        return
    width = max(len(str(row["name"])) for row in rows)
    for row in rows:
        run_mark = " " if row["runs"] else "-"
        echo(f"{run_mark} {row['name']:<{width}}  {row['summary']} ({row['exactness']}).")
    if not all(row["runs"] for row in rows):
        echo("", f"- marks passes that target {target} does not need.")


def _report(result: "RewriteResult") -> "Iterator[str]":
    for change in result.changes:
        names = first_names(change.nodes, _MAX_NAMES)
        yield f"{change.rewrite}: {len(change.nodes)}× {names}"
    stats_before, stats_after = result.before, result.after
    if not result.changes:
        yield "nothing to rewrite"
    else:
        yield f"nodes {stats_before.nodes} → {stats_after.nodes}, operator set {stats_before.opset} → {stats_after.opset}"
    yield f"not captured: {len(stats_before.uncaptured)} nodes → {len(stats_after.uncaptured)}"
    for line in stats_after.uncaptured:
        yield f"  {line}"
    for refusal in result.refusals[:_MAX_NAMES]:
        yield f"left by {refusal.rewrite}: {refusal.where}: {refusal.reason}"
    if len(result.refusals) > _MAX_NAMES:
        yield f"… and {len(result.refusals) - _MAX_NAMES} more were left, which --json lists"
    if result.changes:
        yield f"outputs were compared at {result.probes} probes: {_comparison_text(result)}"
    if result.path is not None:
        yield f"wrote {result.path}"


def _comparison_text(result: "RewriteResult") -> str:
    parts = [
        f"{difference.output} differs by {difference.largest:.2g}"
        for difference in result.differences
    ]
    if not result.uncompared:
        return ", ".join(parts) or "equal bits"
    uncompared_text = f"{', '.join(result.uncompared)} could not be compared: no finite number"
    return "; ".join([", ".join(parts) or "nothing differs", uncompared_text])


def _document(result: "RewriteResult") -> dict[str, object]:
    return {
        "path": str(result.path) if result.path else None,
        "passes": [
            {"name": c.rewrite, "exactness": c.exactness.describe(), "nodes": c.nodes}
            for c in result.changes
        ],
        "before": asdict(result.before),
        "after": asdict(result.after),
        "probes": result.probes,
        "differences": [asdict(difference) for difference in result.differences],
        "unjudged": result.uncompared,
        "left": [
            {"rewrite": r.rewrite, "where": r.where, "why": r.reason} for r in result.refusals
        ],
    }
