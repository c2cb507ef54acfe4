"""Options that every `gsgen export` command has, for torch modules and static scenes."""

__all__ = ["OPSETS", "ExportRequest", "with_common_options"]

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from gsgen.cli.options import complete_levels, complete_targets
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.atomic_files import MODEL_SUFFIX, refuse_itself, refuse_model
from gsgen.sdk.exporting.pipeline import OPSET, VECTOR_COUNT

# The lowest and the highest operator set that torch exports and runtimes know.
OPSETS = (16, 23)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportRequest:
    """The options of one run of `gsgen export`."""

    output: Path
    name: str | None = None  # name in the manifest; the file's stem if absent
    # the dtype of the outputs, and with float16 of weights, too; the source's own if absent
    dtype: Literal["float32", "float16"] | None = None
    capacity: int | None = None  # rows of the outputs; as many as there are Gaussians if absent
    opset: int = OPSET  # ONNX operator set
    target: str = "core"  # the consumer to rewrite and validate for
    level: str = "behaviour"  # the last level of the validation
    verify: Literal["quick", "full"] = "full"  # how many probes are compared with eager torch
    pictures: int = 0  # reference pictures of the eager module
    vectors: int = VECTOR_COUNT  # test vectors with rows of the eager module
    rewrite: bool = True  # whether to rewrite the graph for runtimes
    skip: tuple[str, ...] = ()  # passes that are left out of the rewriting
    timeout: float | None = None  # seconds for the export, and for runs of the model; 120 for these
    report: Path | None = None  # the file for a JSON report on the export; not written if absent
    as_json: bool = False  # whether to print that report instead of text

    def __post_init__(self) -> None:
        """Raise if the JSON report of an export would overwrite a model file."""
        if self.report is not None:
            refuse_model(self.report, [self.output])

    def refuse_splat_file(self) -> None:
        """Raise if the output has a splat file's suffix, such as .ply, instead of .onnx."""
        from gsgen.formats.codecs import CODECS

        suffix = self.output.suffix.lower()
        if any(suffix in codec.suffixes for codec in CODECS):
            hint = f"Name {self.output.with_suffix('.onnx')}; `gsgen convert` writes splat files."
            message = f"has the suffix {suffix} of splat files, expected {MODEL_SUFFIX}"
            raise ConfigInvalid(message, where=f"-o {self.output}", hint=hint)


def _request(
    output: Annotated[
        Path, typer.Option("-o", "--output", help="The ONNX file to write.", show_default=False)
    ],
    name: Annotated[
        str | None, typer.Option(help="Name in the manifest.", show_default="the file's")
    ] = None,
    dtype: Annotated[
        Literal["float32", "float16"] | None,
        typer.Option(
            help="Dtype of the outputs; float16 stores weights in 16 bits, too, where the error is "
            "small.",
            show_default="float32, or that of packed rows or of the target",
        ),
    ] = None,
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
    ] = OPSET,
    target: Annotated[
        str,
        typer.Option(
            help="Consumer to rewrite and validate for: core, webgpu, visionary, gsgen.",
            autocompletion=complete_targets,
        ),
    ] = "core",
    level: Annotated[
        str,
        typer.Option(
            help="Last level to validate: static, values, behaviour, live or render.",
            autocompletion=complete_levels,
        ),
    ] = "behaviour",
    verify: Annotated[
        Literal["quick", "full"],
        typer.Option(help="Compare with eager torch at a third of the probes, or at all of them."),
    ] = "full",
    pictures: Annotated[
        int,
        typer.Option(
            help="Declare so many pictures of the eager module, which level render compares with.",
            min=0,
            max=16,
        ),
    ] = 0,
    vectors: Annotated[
        int,
        typer.Option(
            help="Record a few rows of the eager module at so many probes, which `gsgen validate` "
            "compares with.",
            min=0,
            max=4,
        ),
    ] = VECTOR_COUNT,
    no_rewrite: Annotated[
        bool, typer.Option("--no-rewrite", help="Leave the graph as torch exports it.")
    ] = False,
    skip: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Leave this pass out of the rewriting; repeatable. `gsgen rewrite --list` has them.",
        ),
    ] = None,
    timeout: Annotated[
        float | None,
        typer.Option(
            help="Time limit for the whole export, in seconds; a model that agrees with torch by then "
            "is written.",
            show_default="none; 120 for all runs of the model",
            min=0.1,
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Write a report on the export to this file, as JSON.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print that report instead of text.")
    ] = False,
) -> ExportRequest:
    return ExportRequest(
        output=output,
        name=name,
        dtype=dtype,
        capacity=capacity,
        opset=opset,
        target=target,
        level=level,
        verify=verify,
        pictures=pictures,
        vectors=vectors,
        rewrite=not no_rewrite,
        skip=tuple(name for names in skip or () for name in names.split(",")),
        timeout=timeout,
        report=report,
        as_json=as_json,
    )


_COMMON_PARAMETERS = inspect.signature(_request).parameters


def with_common_options(
    build: Callable[..., Any], run: Callable[[Callable[[], Any], ExportRequest], None]
) -> Callable[..., None]:
    """Return a typer function with a plugin's own parameters and those of every export command.

    ``run`` is called with ``build``, its arguments bound, and the request. A parameter of ``build``
    with the name of a common option is a TypeError.
    """
    parameters = inspect.signature(build).parameters
    conflicting_names = sorted(set(parameters) & set(_COMMON_PARAMETERS))
    if conflicting_names:
        raise TypeError(
            f"the plugin's parameter {conflicting_names[0]!r} has the name of an option of every export; rename it"
        )

    def command(**values: Any) -> None:
        request = _request(**{key: values.pop(key) for key in _COMMON_PARAMETERS})
        listed = [value if isinstance(value, list) else [value] for value in values.values()]
        sources = [value for part in listed for value in part if isinstance(value, Path)]
        refuse_itself(request.output, sources)
        if request.report is not None:
            refuse_itself(request.report, sources)
        run(lambda: build(**values), request)

    merged_parameters = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in (*parameters.values(), *_COMMON_PARAMETERS.values())
    ]
    # typer reads the signature and the annotations.
    command.__signature__ = inspect.Signature(merged_parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {entry.name: entry.annotation for entry in merged_parameters}
    command.__doc__ = build.__doc__
    return command
