"""The options of commands that draw tilesets: budgets, cache, prediction and waiting time."""

__all__ = ["with_streaming_options"]

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from gsgen.contract.spec.units import parse_bytes
from gsgen.runtime.sources.stream_settings import StreamSettings


def _settings(
    sse: Annotated[
        float, typer.Option(help="Error in pixels above which tiles are refined.", min=0.1)
    ] = 16.0,
    budget: Annotated[
        int, typer.Option(help="Most Gaussians of tilesets in GPU memory.", min=65_536)
    ] = 2_000_000,
    cache: Annotated[
        str, typer.Option(help="Most bytes on disk for files of servers, such as 2GB; 0 for none.")
    ] = "2GB",
    upload_budget: Annotated[
        str, typer.Option(help="Most bytes of arriving tiles in a frame, such as 4MB.")
    ] = "4MB",
    connections: Annotated[
        int, typer.Option(help="Most requests of a server at once.", min=1, max=64)
    ] = 6,
    predictor: Annotated[
        str,
        typer.Option(
            help="What tells where the camera goes: constant-velocity, none, or an ONNX model."
        ),
    ] = "constant-velocity",
    log: Annotated[
        Path | None, typer.Option(help="Write what streaming does to this file, as JSON lines.")
    ] = None,
    generators: Annotated[
        int,
        typer.Option(help="Most models of neural tiles that run at once; 0 draws splats.", min=0),
    ] = 4,
    allow_origin: Annotated[
        list[str] | None,
        typer.Option(help="Another origin that a server may redirect to; repeatable."),
    ] = None,
) -> StreamSettings:
    return StreamSettings(
        max_error=sse,
        max_splats=budget,
        cache_bytes=parse_bytes(cache, "--cache"),
        upload_bytes=parse_bytes(upload_budget, "--upload-budget"),
        connections=connections,
        predictor=predictor,
        log=log,
        neural_sessions=generators,
        allow_origins=tuple(allow_origin or ()),
    )


_STREAMING_OPTIONS = inspect.signature(_settings).parameters


def with_streaming_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the tileset streaming options to a command, which receives them as one object."""
    own_parameters = inspect.signature(command).parameters

    def streaming_command(*arguments: Any, **values: Any) -> None:
        streaming_values = {name: values.pop(name) for name in _STREAMING_OPTIONS if name in values}
        command(*arguments, **values, streaming=_settings(**streaming_values))

    further_parameters = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in _STREAMING_OPTIONS.values()
    ]
    merged_parameters = [
        *(own_parameters[name] for name in own_parameters if name != "streaming"),
        *further_parameters,
    ]
    # typer reads the signature and the annotations.
    streaming_command.__signature__ = inspect.Signature(merged_parameters)  # type: ignore[attr-defined]
    streaming_command.__annotations__ = {
        entry.name: entry.annotation for entry in merged_parameters
    }
    streaming_command.__name__, streaming_command.__doc__ = command.__name__, command.__doc__
    return streaming_command
