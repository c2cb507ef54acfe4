"""What Acme brings to gsgen: a generator, a target, a rule for it, and a command."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.targets import Target, load_target
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.rule import rule
from gsgen.sdk import Plugin


def hello() -> None:
    """Say hello."""
    typer.echo("hello from acme")


def target() -> Target:
    """Acme's viewer, which draws three Gaussians."""
    limits = {"acme_rows": 3}
    return replace(load_target("core"), name="acme", version="2", limits=limits)


@rule("acme/AC001", Severity.ERROR, limit="acme_rows")
def small_enough(subject: InspectedModel) -> Iterator[Violation]:
    """A model has at most three rows.

    Why:
        Acme's viewer draws three.

    Hint:
        Prune.
    """
    gaussians = subject.declared_gaussians
    if gaussians and gaussians.capacity > subject.target.limits["acme_rows"]:
        yield Violation.at("capacity", str(gaussians.capacity), "3 at most")


def row(
    output: Annotated[Path, typer.Option("-o", "--output", help="The ONNX file.")],
    count: Annotated[int, typer.Option(help="How many Gaussians.", min=1)] = 3,
) -> None:
    """Export Gaussians in a row."""
    write_row(output, count)
    typer.echo(f"{output}: {count} in a row")


def write_row(path: Path, count: int) -> None:
    """Write a generator of ``count`` grey Gaussians along x; torch is not needed for that."""
    import numpy as np

    from gsgen.contract.spec.layout import DecodedGaussians, encode
    from gsgen.contract.spec.manifest import (
        AppearanceOutput,
        Bounds,
        CountOutput,
        GaussiansOutput,
        GeneratorManifest,
        GeneratorOutputs,
        Space,
    )
    from gsgen.sdk.exporting.constant_generator import write_constant

    along = np.zeros((count, 3))
    along[:, 0] = np.linspace(-1, 1, count)
    round_ones = np.tile([0.01, 0, 0, 0.01, 0, 0.01], (count, 1))
    gray = np.full((count, 3), 0.5)
    packed = encode(
        DecodedGaussians(
            position=along, opacity=np.full(count, 0.5), covariance=round_ones, rgb=gray
        )
    )
    manifest = GeneratorManifest(
        name="row",
        outputs=GeneratorOutputs(
            GaussiansOutput("gaussians", count),
            AppearanceOutput("color", "rgb"),
            CountOutput("num_points"),
        ),
        space=Space(),
        bounds=Bounds((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
    )
    write_constant(*packed, manifest, path)


PLUGIN = Plugin(name="row", summary="Gaussians in a row.", reads="nothing", inputs=(), command=row)
