"""What every `gsgen export` can be told, whatever makes the generator."""

__all__ = ["OPSETS", "Build", "ExportRequest", "with_common_options"]

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from gsgen.contract.process.atomic_files import refuse_model

if TYPE_CHECKING:
    from gsgen.sdk.authoring.generator import GaussianGenerator
    from gsgen.sdk.authoring.post_process import PostProcess

# Returns the module to export; called with the options that its signature declares.
Build = Callable[..., "GaussianGenerator | PostProcess"]

# Operator sets that torch exports to, and that runtimes know.
OPSETS = (16, 23)


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """Where a model goes and how it is written.

    Attributes:
        output: The file.
        name: What people call it; the file's stem where absent.
        dtype: Of the outputs, and in float16 of weights, too.
        capacity: Rows of the outputs; as many as there are Gaussians where absent.
        opset: ONNX operator set.
        target: The consumer to write and to validate for.
        level: How far to validate.
        rewrite: Rewrite the graph for runtimes.
        report: Where to say, as JSON, what was done and found; nowhere if absent.
    """

    output: Path
    name: str | None = None
    dtype: Literal["float32", "float16"] = "float32"
    capacity: int | None = None
    opset: int = 18
    target: str = "core"
    level: str = "behaviour"
    rewrite: bool = True
    report: Path | None = None

    def __post_init__(self) -> None:
        """Refuse a model's place for the report.

        Raises:
            ConfigInvalid: The report would replace a model.
        """
        if self.report is not None:
            refuse_model(self.report, [self.output])


def _request(
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="The ONNX file to write.", show_default=False),
    ],
    name: Annotated[
        str | None, typer.Option(help="Name in the manifest.", show_default="the file's")
    ] = None,
    dtype: Annotated[
        Literal["float32", "float16"],
        typer.Option(
            help="Of the outputs; float16 halves weights, too, where that is unseen."
        ),
    ] = "float32",
    capacity: Annotated[
        int | None,
        typer.Option(help="Rows of the outputs.", show_default="as many as needed", min=1),
    ] = None,
    opset: Annotated[
        int,
        typer.Option(
            help="ONNX operator set; every runtime has kernels for 18.",
            min=OPSETS[0],
            max=OPSETS[1],
        ),
    ] = 18,
    target: Annotated[
        str,
        typer.Option(
            help="Consumer to rewrite and validate for: core, webgpu, visionary, gsgen."
        ),
    ] = "core",
    level: Annotated[
        str,
        typer.Option(
            help="How far to validate: static, values, behaviour, live or render."
        ),
    ] = "behaviour",
    no_rewrite: Annotated[
        bool, typer.Option("--no-rewrite", help="Leave the graph as torch exports it.")
    ] = False,
    report: Annotated[
        Path | None,
        typer.Option(help="Write what was done and found to this file, as JSON."),
    ] = None,
) -> ExportRequest:
    return ExportRequest(
        output, name, dtype, capacity, opset, target, level, not no_rewrite, report
    )


_COMMON = inspect.signature(_request).parameters


def with_common_options(
    build: Callable[..., Any], run: Callable[[Callable[[], Any], ExportRequest], None]
) -> Callable[..., None]:
    """Return a typer function that takes what ``build`` takes, and every common option.

    Args:
        build: Makes the generator; its parameters become arguments and options.
        run: Called with ``build``, its arguments bound, and the request.

    Raises:
        TypeError: ``build`` declares a parameter that is a common option's.
    """
    own = inspect.signature(build).parameters
    taken = sorted(set(own) & set(_COMMON))
    if taken:
        raise TypeError(f"every export has the option {taken[0]!r}; give it another name")

    def command(**given: Any) -> None:
        request = _request(**{key: given.pop(key) for key in _COMMON})
        run(lambda: build(**given), request)

    merged = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in (*own.values(), *_COMMON.values())
    ]
    # typer reads both.
    command.__signature__ = inspect.Signature(merged)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in merged}
    command.__doc__ = build.__doc__
    return command
