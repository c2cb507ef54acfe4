"""Run a torch generator in eager mode, as the reference that an exported model has to match."""

__all__ = [
    "EagerRuns",
    "Reference",
    "call_module",
    "measure_bounds",
    "run_eager",
    "run_in_float64",
    "run_watched",
]

from collections.abc import Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from gsgen.contract._entry_points import plugin_exits_as_errors
from gsgen.contract.errors import GsgenError
from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec import layout
from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.manifest import Bounds, GeneratorManifest
from gsgen.sdk.authoring.cells import Cells
from gsgen.sdk.authoring.generator import GaussianGenerator, Gaussians
from gsgen.sdk.authoring.misspelled_names import misspelling_hint
from gsgen.sdk.authoring.module_checks import input_order_hint
from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.exporting.source_checks import check_gaussians
from gsgen.sdk.exporting.tracing.hazards import HazardWatch, describe_hazard
from gsgen.sdk.exporting.tracing.source_lines import user_line_of
from gsgen.sdk.model_runs import MAX_KEPT_OUTPUT_BYTES
from gsgen.sdk.parity import Reference

# Bounds are widened by this share of their size, so that Gaussians stay inside them at times and
# poses between the probes, too.
_MEMORY_MARGIN = 0.02
_CHUNK_ELEMENTS = 1 << 16


class EagerRuns:
    """The outputs of a torch generator for several sets of test inputs, computed on demand.

    Results are kept while they are small; beyond :data:`MAX_KEPT_OUTPUT_BYTES` a probe is run again each time.

    Args:
        generator: The module.
        probes: The inputs of each run.
        known_references: Results for some of the probes.
    """

    def __init__(
        self,
        generator: GaussianGenerator,
        probes: Sequence[Probe],
        known_references: Sequence[Reference] = (),
    ) -> None:
        self.generator, self.probes = generator, tuple(probes)
        self._known_references = list(known_references)

    def __len__(self) -> int:
        return len(self.probes)

    def __getitem__(self, index: int) -> Reference:
        probe = self.probes[index]
        for reference in self._known_references:
            if reference.probe is probe:
                return reference
        reference = run_eager(self.generator, probe)
        if (
            sum(known_references.nbytes for known_references in self._known_references)
            + reference.nbytes
            <= MAX_KEPT_OUTPUT_BYTES
        ):
            self._known_references.append(reference)
        return reference

    def __iter__(self) -> Iterator[Reference]:
        return (self[index] for index in range(len(self)))

    def with_probes(self, probes: Sequence[Probe]) -> "EagerRuns":
        """Return the runs at other test inputs, with the results of those already computed."""
        known_references = [
            reference
            for reference in self._known_references
            if any(reference.probe is probe for probe in probes)
        ]
        return EagerRuns(self.generator, probes, known_references)

    def has_inputs_of(self, other: "EagerRuns") -> bool:
        """Return whether two sets of eager torch runs have bit-identical test inputs."""
        return len(self) == len(other) and all(
            np.array_equal(array, b.inputs[name], equal_nan=True)
            for a, b in zip(self.probes, other.probes, strict=True)
            for name, array in a.inputs.items()
        )


def run_eager(generator: GaussianGenerator, probe: Probe, *, checked: bool = True) -> Reference:
    """Run a torch generator once in eager mode, without gradients.

    Args:
        generator: The module.
        probe: The inputs.
        checked: Whether to raise for values that are wrong in torch, such as NaN; not for inputs
            that only explain a difference, and may lie outside of their range.
    """
    output = call_module(generator, _tensors(probe))
    return _reference(generator, probe, output, checked=checked)


def run_in_float64(generator: GaussianGenerator, probe: Probe) -> Reference | None:
    """Run a copy of a torch generator in float64; None if forward has a dtype of its own."""
    inputs = {
        name: array.astype(np.float64) if array.dtype.kind == "f" else array
        for name, array in probe.inputs.items()
    }
    try:
        return run_eager(deepcopy(generator).double(), replace(probe, inputs=inputs), checked=False)
    except GsgenError:
        return None


def packed_outputs(reference: Reference, manifest: GeneratorManifest) -> dict[str, np.ndarray]:
    """Pack the results of eager torch as float32 tensors, by the names of a model's outputs."""
    outputs, cells = manifest.outputs, reference.cells
    assert outputs.gaussians is not None
    assert outputs.appearance is not None
    rows, color = layout.encode(reference.gaussians)
    packed = {outputs.gaussians.name: rows, outputs.appearance.name: color}
    if outputs.count is not None:
        packed[outputs.count.name] = np.array([reference.count], np.int32)
    if outputs.cells is not None and cells is not None:
        columns = (cells.position, cells.visibility[:, None], cells.covariance)
        packed[outputs.cells.name] = np.concatenate(columns, axis=1).astype(np.float32)
    return packed


def run_watched(generator: GaussianGenerator, probe: Probe) -> tuple[Reference, HazardWatch]:
    """Run a torch generator in eager mode, and record operations that tracing cannot follow."""
    tensors = _tensors(probe)
    with HazardWatch(generator, tensors) as watch:
        output = call_module(generator, tensors)
    return _reference(generator, probe, output), watch


def _tensors(probe: Probe) -> list[Tensor]:
    return [torch.from_numpy(np.array(value)) for value in probe.inputs.values()]


def call_module(module: nn.Module, tensors: list[Tensor]) -> Any:
    """Call a torch module without gradients, and return its result.

    Raises:
        GeneratorInvalid: ``forward`` raised; the error names the line of the user's code.
    """
    try:
        with plugin_exits_as_errors(), torch.no_grad():
            return module(*tensors)
    except GsgenError:
        raise
    except Exception as error:  # the user's code may raise anything
        message = f"forward raised {type(error).__name__}: {error}"
        where = user_line_of(error) or type(module).__name__
        is_linalg = isinstance(error, torch.linalg.LinAlgError)  # type: ignore[attr-defined]
        hint = describe_hazard("linalg")[1] if is_linalg else ""
        hint = hint or misspelling_hint(error) or input_order_hint(module)
        raise GeneratorInvalid(message, where=where, hint=hint) from error


def _reference(
    generator: GaussianGenerator, probe: Probe, output: Any, *, checked: bool = True
) -> Reference:
    if not isinstance(output, Gaussians):
        message = f"forward returned {type(output).__name__}, expected gsgen.sdk.Gaussians"
        raise GeneratorInvalid(message, where=type(generator).__name__)
    n = output.position.shape[0]
    count = n if output.count is None else int(np.clip(int(output.count.reshape(-1)[0]), 0, n))
    if checked and not probe.zeros:
        check_gaussians(output, count, probe.label)
    cells = None if output.cells is None else _unpacked_cells(output.cells)
    return Reference(probe, _decode_gaussians(output), count, cells)


def _decode_gaussians(gaussians: Gaussians) -> layout.DecodedGaussians:
    return layout.DecodedGaussians(
        position=_array(gaussians.position),
        opacity=_array(gaussians.opacity).reshape(-1),
        covariance=_packed_covariance_array(gaussians),
        sh=None if gaussians.sh is None else _array(gaussians.sh),
        rgb=None if gaussians.rgb is None else _array(gaussians.rgb),
    )


def _unpacked_cells(cells: Cells) -> layout.Cells:
    visibility = _array(cells.visibility).reshape(-1)
    return layout.Cells(_array(cells.position), visibility, _packed_covariance_array(cells))


def _packed_covariance_array(ellipsoids: Gaussians | Cells) -> np.ndarray:
    if ellipsoids.covariance is not None:
        return _array(ellipsoids.covariance)
    assert ellipsoids.scale is not None
    assert ellipsoids.rotation is not None
    scale, rotation = _array(ellipsoids.scale), _array(ellipsoids.rotation)
    upper_triangle = np.empty((len(scale), 6))
    for start in range(0, len(scale), _CHUNK_ELEMENTS):
        rows = slice(start, start + _CHUNK_ELEMENTS)
        upper_triangle[rows] = covariance_upper(scale[rows], rotation[rows])
    return upper_triangle


def _array(tensor: Tensor) -> np.ndarray:
    """Convert a torch tensor to a float32 array, or float64 if it has more precision."""
    dtype = torch.float64 if tensor.dtype == torch.float64 else torch.float32
    return np.asarray(tensor.detach().to(dtype).cpu().numpy())


def measure_bounds(references: Iterable[Reference]) -> Bounds:
    """Return the bounding box of the visible Gaussians of all frames, slightly widened.

    Raises:
        GeneratorInvalid: No centre is finite and visible.
    """
    corners = [
        box_corner
        for r in references
        if not r.probe.zeros
        for box_corner in _bounding_box_corners(r)
    ]
    points = np.array(corners) if corners else np.zeros((0, 3))
    bounds = Bounds.from_points(points, _MEMORY_MARGIN)
    if bounds is None:
        message = "no probe gives a single finite, visible Gaussian"
        hint = "Check that opacity is activated and that positions are finite."
        raise GeneratorInvalid(message, where="forward", hint=hint)
    return bounds


def _bounding_box_corners(reference: Reference) -> tuple[np.ndarray, ...]:
    """Return the bounding box of the visible Gaussians' centres, or None without any."""
    points = reference.gaussians.position[: reference.count][_visible_rows(reference)]
    return (points.min(axis=0), points.max(axis=0)) if len(points) else ()


def _visible_rows(reference: Reference) -> np.ndarray:
    g, n = reference.gaussians, reference.count
    is_finite = np.isfinite(g.position[:n]).all(axis=1)
    return np.asarray(is_finite & (g.opacity[:n] >= layout.CULL_OPACITY))
