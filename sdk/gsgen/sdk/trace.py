"""Turn a packed generator into an ONNX graph, with torch's own exporter."""

__all__ = ["trace"]

import logging
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import onnx_ir as ir
import torch

from gsgen.contract.manifest import GeneratorManifest
from gsgen.contract.probes import Probe
from gsgen.sdk.errors import ExportFailed, GeneratorInvalid
from gsgen.sdk.packing import COUNT, GAUSSIANS, PackedGenerator

# They report on operators of packages that are not installed and on weights that stay as they are.
_CHATTY = ("torch.onnx", "torch.export", "onnxscript", "onnx_ir")


def trace(
    packed: PackedGenerator, example: Probe, manifest: GeneratorManifest, opset: int
) -> ir.Model:
    """Export ``packed`` with ``torch.onnx.export(dynamo=True)`` and return the graph.

    Raises:
        ExportFailed: The exporter refused the module; the message names the line of its code.
    """
    arguments = tuple(
        torch.from_numpy(np.array(value)) for value in example.inputs.values()
    )
    appearance = manifest.outputs.appearance
    assert appearance is not None
    try:
        with _quiet():
            program = torch.onnx.export(
                packed,
                arguments,
                dynamo=True,
                input_names=[entry.name for entry in manifest.inputs],
                output_names=[GAUSSIANS, appearance.name, COUNT],
                opset_version=opset,
                verbose=False,
            )
    except GeneratorInvalid:
        raise
    except Exception as error:  # the exporter's errors share no base class
        raise _explained(packed, error) from error
    assert program is not None
    return program.model


@contextmanager
def _quiet() -> Iterator[None]:
    loggers = [logging.getLogger(name) for name in _CHATTY]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _explained(packed: PackedGenerator, error: BaseException) -> ExportFailed:
    root: BaseException = error
    while root.__cause__ is not None:
        root = root.__cause__
    reason = next(
        (line for line in str(root).splitlines() if line.strip()), type(root).__name__
    )
    return ExportFailed(
        f"{type(root).__name__}: {reason.strip()[:300]}",
        where=_user_line(root) or type(packed.generator).__name__,
        mend="Shapes must not depend on data: use masks and torch.where instead of boolean "
        "indexing, and keep `.item()`, numpy and Python branches on tensors out of forward.",
    )


def _user_line(error: BaseException) -> str:
    """Return ``file:line`` of the innermost frame that is neither torch's nor ours."""
    ours, theirs = Path(__file__).parent, Path(torch.__file__).parent
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        is_library = path.is_relative_to(ours) or path.is_relative_to(theirs)
        if path.is_file() and not is_library and "site-packages" not in path.parts:
            return f"{path.name}:{frame.lineno} ({frame.line})"
    return ""
