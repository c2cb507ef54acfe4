"""Compares two model files: runs both with the same inputs, and measures how far outputs differ."""

__all__ = ["Comparison", "Difference", "compare_files", "probes_of"]

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gsgen.contract.model.graph import Tensor
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probes import Probe, default_probes
from gsgen.contract.probing.sandbox import Execution, execute
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.manifest import Input
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.passes.framework.base import ErrorBudget

# Number of probes of a model without a manifest, and the value of its unknown sizes.
_PROBE_COUNT = 5
_UNKNOWN_SIZE = 3
_HIGHEST_INDEX = 2
_EPSILON_BY_DTYPE = {"float16": 2.0**-10, "float32": 2.0**-22, "float64": 2.0**-50}


@dataclass(frozen=True, slots=True)
class Difference:
    """The largest difference in one model output that a rewrite causes."""

    output: str  # its name
    largest: float  # the largest absolute difference
    allowed: float  # the allowed difference
    probe: str  # label of the probe with the largest difference


@dataclass(frozen=True, slots=True)
class Comparison:
    """The differences of all outputs of two models for the same test inputs."""

    differences: tuple[Difference, ...]  # the largest difference of each output that differs
    # outputs without a finite number at any probe, so that no change can be seen
    uncompared: tuple[str, ...]


def probes_of(subject: InspectedModel, sizes: Mapping[str, int]) -> tuple[Probe, ...]:
    """Return the test inputs of a model: by its manifest if it has one, else random numbers."""
    shapes = {tensor.name: _shape(tensor, sizes) for tensor in subject.graph.inputs}
    dtypes = {tensor.name: _dtype(tensor) for tensor in subject.graph.inputs}
    manifest = subject.manifest
    if manifest is not None and {i.name for i in manifest.inputs} == set(shapes):
        declared = {i.name: i for i in manifest.inputs}
        shapes = {
            tensor.name: _shape(tensor, sizes, declared[tensor.name])
            for tensor in subject.graph.inputs
        }
        probes = default_probes(manifest, shapes, dtypes)
        if any(array.shape != shapes[name] for p in probes for name, array in p.inputs.items()):
            probes = ()  # the manifest declares other shapes than the graph
    else:
        probes = ()
    if not probes:
        probes = tuple(
            _sample_probe(shapes, dtypes, index) for index in range(_PROBE_COUNT if shapes else 1)
        )
    # Optimisations would round differently before and after: kernels alone are compared.
    return tuple(
        Probe(label=p.label, inputs=p.inputs, zeros=p.zeros, optimise=False) for p in probes
    )


def _shape(
    tensor: Tensor, sizes: Mapping[str, int], declared: Input | None = None
) -> tuple[int, ...]:
    dims = tensor.dims
    declared_shape = declared.shape if declared and declared.shape else None
    if dims is None:
        return declared_shape or ()
    known = (
        declared_shape
        if declared_shape and len(declared_shape) == len(dims)
        else (_UNKNOWN_SIZE,) * len(dims)
    )
    return tuple(
        dim if isinstance(dim, int) else sizes.get(dim or "", known[axis])
        for axis, dim in enumerate(dims)
    )


def _dtype(tensor: Tensor) -> str:
    try:
        return np.dtype(tensor.dtype or "float32").name
    except TypeError as error:
        message = f"is {tensor.dtype}, which numpy cannot feed"
        hint = "Only inputs of numbers and booleans can be compared."
        raise RewriteFailed(message, where=f"input {tensor.name}", hint=hint) from error


def _sample_probe(
    shapes: Mapping[str, tuple[int, ...]], dtypes: Mapping[str, str], index: int
) -> Probe:
    """Return test inputs of zeros for index 0, otherwise of random numbers."""
    rng = np.random.default_rng([7, index])
    arrays: dict[str, np.ndarray] = {}
    for name, shape in shapes.items():
        kind = np.dtype(dtypes[name])
        if index == 0:
            arrays[name] = np.zeros(shape, kind)
        elif kind.kind == "f":
            arrays[name] = np.asarray(rng.normal(size=shape)).astype(kind)
        else:
            arrays[name] = np.asarray(rng.integers(0, _HIGHEST_INDEX, shape)).astype(kind)
    return Probe(
        label="all inputs zero" if index == 0 else f"sample {index}",
        inputs=arrays,
        zeros=index == 0,
    )


def compare_files(
    source: Path,
    rewritten: Path,
    outputs: Sequence[str],
    probes: Sequence[Probe],
    limits: Limits,
    allowed: ErrorBudget,
    passes: str,
) -> Comparison:
    """Run two model files with the same inputs, and return how far their outputs differ.

    ``passes`` are the names of the passes that ran, for an error.
    """
    with (
        execute(source, outputs, probes, _limits_for_model(source, limits)) as old,
        execute(rewritten, outputs, probes, _limits_for_model(rewritten, limits)) as new,
    ):
        _require_successful_execution(old, probes, source.name, "before the rewrite")
        _require_successful_execution(new, probes, passes, "after the rewrite")
        worst_difference: dict[str, Difference] = {}
        compared_names: set[str] = set()
        for index, probe in enumerate(probes):
            expected, actual = (
                execution.samples[execution.runs[index].sample].outputs for execution in (old, new)
            )
            compared_names |= {
                name for name, value in expected.items() if _has_finite_values(value)
            }
            for difference in _output_differences(expected, actual, probe, allowed):
                known = worst_difference.get(difference.output)
                if known is None or _difference_excess(difference) > _difference_excess(known):
                    worst_difference[difference.output] = difference
    violations = [
        difference
        for difference in worst_difference.values()
        if not difference.largest <= difference.allowed
    ]
    if violations:
        _require_repeatable_outputs(source, outputs, probes, limits)
        difference = max(violations, key=_difference_excess)
        raise RewriteFailed(
            f"output {difference.output!r} differs by {difference.largest:.3g} for the test inputs {difference.probe!r}, "
            f"expected at most {difference.allowed:.3g} ({allowed.describe()})",
            where=passes,
            hint="Nothing was written. Leave the pass out with --skip, and please report it.",
        )
    uncompared = tuple(name for name in outputs if name not in compared_names)
    return Comparison(tuple(worst_difference.values()), uncompared)


def _has_finite_values(value: np.ndarray) -> bool:
    """Return whether an output array has a finite value, so that differences can be measured."""
    if value.dtype.kind == "f":
        return bool(np.isfinite(value).any())
    return value.size > 0


def _limits_for_model(model: Path, limits: Limits) -> Limits:
    return limits.for_model(open_model(model).weight_bytes)


def _require_successful_execution(
    run: Execution, probes: Sequence[Probe], where: str, version: str
) -> None:
    fault = run.fault
    if fault is None:
        return
    probe = "" if fault.probe is None else f" at probe {probes[fault.probe].label!r}"
    message = f"the model {version} does not run in ONNX Runtime{probe}: {fault.message}"
    hint = "Outputs cannot be compared, so nothing was written."
    raise RewriteFailed(message, where=where, hint=f"{fault.hint} {hint}".strip())


def _require_repeatable_outputs(
    model: Path, outputs: Sequence[str], probes: Sequence[Probe], limits: Limits
) -> None:
    """Raise if a model's outputs change between two runs with the same inputs."""
    doubled_probes = [probe for probe in probes for _ in range(2)]
    with execute(model, outputs, doubled_probes, _limits_for_model(model, limits)) as run:
        samples = [run.sample for run in run.runs]
    if samples[::2] != samples[1::2]:
        message = "the model gives other outputs for the same inputs, so nothing can be compared"
        hint = "Draw random numbers before the export (rule GG010)."
        raise RewriteFailed(message, where=model.name, hint=hint)


def _difference_excess(difference: Difference) -> float:
    """Return an output difference as a multiple of the allowed one; NaN becomes infinite."""
    is_within_tolerance = difference.largest <= difference.allowed
    return (
        difference.largest / difference.allowed
        if is_within_tolerance and difference.allowed > 0
        else np.inf
    )


def _output_differences(
    source: Mapping[str, np.ndarray],
    rewritten: Mapping[str, np.ndarray],
    probe: Probe,
    allowed: ErrorBudget,
) -> Iterator[Difference]:
    for name, old in source.items():
        new = _without_padding_rows(old, rewritten[name]) if allowed.pads else rewritten[name]
        if old.shape != new.shape or old.dtype != new.dtype:
            yield Difference(name, np.inf, 0.0, probe.label)
        elif old.tobytes() != new.tobytes():
            error, allowed_error = _error(np.asarray(old), np.asarray(new), allowed)
            excess_error = np.where(error <= allowed_error, 0.0, error)  # so that NaN is over
            worst_difference = int(
                np.argmax(np.where(np.isnan(excess_error), np.inf, excess_error))
            )
            worst_difference = (
                worst_difference if excess_error[worst_difference] != 0 else int(np.argmax(error))
            )
            if (
                error[worst_difference] != 0
            ):  # zeros of either sign, and NaNs of other bits, are the same
                yield Difference(
                    name,
                    float(error[worst_difference]),
                    float(allowed_error[worst_difference]),
                    probe.label,
                )


def _without_padding_rows(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Remove the zero rows by which a rewrite padded an output array."""
    if old.ndim != new.ndim or not old.ndim or len(new) <= len(old):
        return new
    return new[: len(old)] if not new[len(old) :].any() else new


def _error(
    old: np.ndarray, new: np.ndarray, allowed: ErrorBudget
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the absolute error and the allowed error of every number of an output array.

    The last axis holds the fields of a Gaussian, so the relative tolerance of each column refers to
    the largest number of that column.
    """
    expected, actual = old.astype(np.float64), new.astype(np.float64)
    is_finite = np.isfinite(expected)
    is_equal = (
        (old == new)
        | (np.isnan(expected) & np.isnan(actual))
        | (~is_finite if allowed.repairs_nonfinite else False)
    )
    with np.errstate(invalid="ignore"):
        difference = np.abs(expected - actual)
    if old.dtype.kind in "iu":
        # Two large integers may be equal as float64.
        difference = np.maximum(difference, 1.0)
    error = np.where(is_equal, 0.0, difference)
    size = np.abs(np.where(is_finite, expected, 0.0))
    allowed_error = np.zeros_like(size)
    if old.dtype.kind == "f" and (allowed.relative or allowed.absolute):
        axes = tuple(range(size.ndim - 1)) if size.ndim > 1 else None
        largest = size.max(axis=axes, keepdims=True, initial=0.0)
        rounding = _EPSILON_BY_DTYPE[old.dtype.name] * size
        allowed_error = allowed_error + allowed.absolute + allowed.relative * largest + rounding
    return error.reshape(-1), allowed_error.reshape(-1)
