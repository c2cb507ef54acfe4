"""Say whether two files compute the same: run both at the same probes, and compare outputs."""

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

# How many probes a model without a manifest is run at, and what a size that nobody knows counts as.
_COUNT = 5
_UNKNOWN_SIZE = 3
_HIGHEST_INDEX = 2
_EPSILON = {"float16": 2.0**-10, "float32": 2.0**-22, "float64": 2.0**-50}


@dataclass(frozen=True, slots=True)
class Difference:
    """The largest difference of one output after a rewrite.

    Attributes:
        output: Its name.
        largest: The largest absolute difference.
        allowed: What was allowed there.
        probe: Where it was seen.
    """

    output: str
    largest: float
    allowed: float
    probe: str


@dataclass(frozen=True, slots=True)
class Comparison:
    """What became of all outputs.

    Attributes:
        differences: The largest difference of each output that differs.
        unjudged: Outputs without a finite number at any probe: whatever a rewrite did to them,
            nothing would have differed.
    """

    differences: tuple[Difference, ...]
    unjudged: tuple[str, ...]


def probes_of(subject: InspectedModel, sizes: Mapping[str, int]) -> tuple[Probe, ...]:
    """Return the inputs to run a model with; those of its manifest where it has one.

    Raises:
        RewriteFailed: An input is no tensor of numbers.
    """
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
        if any(
            array.shape != shapes[name] for p in probes for name, array in p.inputs.items()
        ):
            probes = ()  # the manifest is about other inputs than the graph's
    else:
        probes = ()
    if not probes:
        probes = tuple(
            _blind(shapes, dtypes, index) for index in range(_COUNT if shapes else 1)
        )
    # Optimisations would round differently before and after: kernels alone are compared.
    return tuple(Probe(p.label, p.inputs, p.zeros, optimise=False) for p in probes)


def _shape(
    tensor: Tensor, sizes: Mapping[str, int], declared: Input | None = None
) -> tuple[int, ...]:
    dims = tensor.dims
    stated = declared.shape if declared and declared.shape else None
    if dims is None:
        return stated or ()
    known = stated if stated and len(stated) == len(dims) else (_UNKNOWN_SIZE,) * len(dims)
    return tuple(
        dim if isinstance(dim, int) else sizes.get(dim or "", known[axis])
        for axis, dim in enumerate(dims)
    )


def _dtype(tensor: Tensor) -> str:
    try:
        return np.dtype(tensor.dtype or "float32").name
    except TypeError as error:
        raise RewriteFailed(
            f"is {tensor.dtype}, which numpy cannot feed",
            where=f"input {tensor.name}",
            hint="Only inputs of numbers and booleans can be compared.",
        ) from error


def _blind(
    shapes: Mapping[str, tuple[int, ...]], dtypes: Mapping[str, str], index: int
) -> Probe:
    """Return zeros, then ordinary numbers; whole ones may be indices, so they are small."""
    rng = np.random.default_rng([7, index])
    made: dict[str, np.ndarray] = {}
    for name, shape in shapes.items():
        kind = np.dtype(dtypes[name])
        if index == 0:
            made[name] = np.zeros(shape, kind)
        elif kind.kind == "f":
            made[name] = np.asarray(rng.normal(size=shape)).astype(kind)
        else:
            made[name] = np.asarray(rng.integers(0, _HIGHEST_INDEX, shape)).astype(kind)
    return Probe(
        "all inputs zero" if index == 0 else f"sample {index}", made, zeros=index == 0
    )


def compare_files(
    before: Path,
    after: Path,
    outputs: Sequence[str],
    probes: Sequence[Probe],
    limits: Limits,
    allowed: ErrorBudget,
    blamed: str,
) -> Comparison:
    """Run both files, and return how far their outputs differ.

    Args:
        before: A model.
        after: What it was rewritten to.
        outputs: Names of the outputs to compare.
        probes: Inputs.
        limits: What running one may use.
        allowed: How far outputs may differ.
        blamed: What was done, for the error.

    Raises:
        RewriteFailed: One does not run, or they differ by more than is allowed.
    """
    with (
        execute(before, outputs, probes, _room(before, limits)) as old,
        execute(after, outputs, probes, _room(after, limits)) as new,
    ):
        _must_run(old, probes, before.name, "as it came")
        _must_run(new, probes, blamed, "rewritten")
        worst: dict[str, Difference] = {}
        judged: set[str] = set()
        for index, probe in enumerate(probes):
            a, b = (one.samples[one.runs[index].sample].outputs for one in (old, new))
            judged |= {name for name, value in a.items() if _says_something(value)}
            for one in _differences(a, b, probe, allowed):
                known = worst.get(one.output)
                if known is None or _excess(one) > _excess(known):
                    worst[one.output] = one
    bad = [one for one in worst.values() if not one.largest <= one.allowed]
    if bad:
        _must_repeat(before, outputs, probes, limits)
        one = max(bad, key=_excess)
        raise RewriteFailed(
            f"output {one.output!r} differs by {one.largest:.3g} at probe {one.probe!r}, "
            f"wanted at most {one.allowed:.3g} ({allowed.describe()})",
            where=blamed,
            hint="Nothing was written. Leave the pass out with --skip, and please report it.",
        )
    unjudged = tuple(name for name in outputs if name not in judged)
    return Comparison(tuple(worst.values()), unjudged)


def _says_something(value: np.ndarray) -> bool:
    """Say whether there is a number in ``value`` that could have come out otherwise."""
    if value.dtype.kind == "f":
        return bool(np.isfinite(value).any())
    return value.size > 0


def _room(model: Path, limits: Limits) -> Limits:
    return limits.for_model(open_model(model).weight_bytes)


def _must_run(run: Execution, probes: Sequence[Probe], where: str, which: str) -> None:
    fault = run.fault
    if fault is None:
        return
    probe = "" if fault.probe is None else f" at probe {probes[fault.probe].label!r}"
    raise RewriteFailed(
        f"the model {which} does not run in ONNX Runtime{probe}: {fault.message}",
        where=where,
        hint="Outputs cannot be compared, so nothing was written.",
    )


def _must_repeat(
    model: Path, outputs: Sequence[str], probes: Sequence[Probe], limits: Limits
) -> None:
    """Blame a model that gives other outputs each time, not its rewrites."""
    twice = [probe for probe in probes for _ in range(2)]
    with execute(model, outputs, twice, _room(model, limits)) as run:
        samples = [one.sample for one in run.runs]
    if samples[::2] != samples[1::2]:
        raise RewriteFailed(
            "the model gives other outputs for the same inputs, so nothing can be compared",
            where=model.name,
            hint="Draw random numbers before the export (rule GG010).",
        )


def _excess(one: Difference) -> float:
    """Return how far a difference goes beyond what is allowed; NaN counts as very far."""
    within = one.largest <= one.allowed
    return one.largest / one.allowed if within and one.allowed > 0 else np.inf


def _differences(
    before: Mapping[str, np.ndarray],
    after: Mapping[str, np.ndarray],
    probe: Probe,
    allowed: ErrorBudget,
) -> Iterator[Difference]:
    for name, old in before.items():
        new = _unpadded(old, after[name]) if allowed.pads else after[name]
        if old.shape != new.shape or old.dtype != new.dtype:
            yield Difference(name, np.inf, 0.0, probe.label)
        elif old.tobytes() != new.tobytes():
            error, room = _error(np.asarray(old), np.asarray(new), allowed)
            over = np.where(error <= room, 0.0, error)  # so that NaN is over
            worst = int(np.argmax(np.where(np.isnan(over), np.inf, over)))
            worst = worst if over[worst] != 0 else int(np.argmax(error))
            if (
                error[worst] != 0
            ):  # zeros of either sign, and NaNs of other bits, are the same
                yield Difference(name, float(error[worst]), float(room[worst]), probe.label)


def _unpadded(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return ``new`` without the rows of zeros that it has behind those of ``old``."""
    if old.ndim != new.ndim or not old.ndim or len(new) <= len(old):
        return new
    return new[: len(old)] if not new[len(old) :].any() else new


def _error(
    old: np.ndarray, new: np.ndarray, allowed: ErrorBudget
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the absolute error of every number, and what is allowed for it.

    The last axis tells fields of a Gaussian apart, so each of its places is held to the largest
    number that stands there.
    """
    a, b = old.astype(np.float64), new.astype(np.float64)
    finite = np.isfinite(a)
    same = (
        (old == new)
        | (np.isnan(a) & np.isnan(b))
        | (~finite if allowed.repairs_nonfinite else False)
    )
    with np.errstate(invalid="ignore"):
        apart = np.abs(a - b)
    if old.dtype.kind in "iu":
        apart = np.maximum(apart, 1.0)  # a double may not tell two large ones apart
    error = np.where(same, 0.0, apart)
    size = np.abs(np.where(finite, a, 0.0))
    room = np.zeros_like(size)
    if old.dtype.kind == "f" and (allowed.relative or allowed.absolute):
        axes = tuple(range(size.ndim - 1)) if size.ndim > 1 else None
        largest = size.max(axis=axes, keepdims=True, initial=0.0)
        rounding = _EPSILON[old.dtype.name] * size
        room = room + allowed.absolute + allowed.relative * largest + rounding
    return error.reshape(-1), room.reshape(-1)
