"""Measures the output error of rounding nodes and weights to float16, relative to tolerances."""

__all__ = ["ErrorProbe"]

from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cached_property
from itertools import chain

import numpy as np
import onnx_ir as ir

from gsgen.contract.probing.probes import Probe, default_probes
from gsgen.contract.process.drafts import temporary_folder
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import GeneratorManifest, Tolerances
from gsgen.contract.validation.agreement import FieldError
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.float16.instrumented_model import InstrumentedModel
from gsgen.sdk.model_runs import MAX_KEPT_OUTPUT_BYTES, run_in_groups
from gsgen.sdk.parity import ModelOutput, Parity, Reference, compare
from gsgen.sdk.rewriting.model_io import has_external_weights, save_model

_MIN_TOLERANCE = 1e-3
# Number of further probes: coprime to the number of the search's probes, so that times differ.
_HELD_OUT_PROBE_COUNT = 12


class ErrorProbe:
    """Measures output errors of nodes or weights rounded to float16, relative to tolerances.

    With ``half_outputs``, outputs are stored in float16, too; their rounding is added to the
    tolerances ``roundings`` times. With ``weights_only``, no node can be rounded.

    Attributes:
        weights: Name of each table that can be stored in 16 bits a number.
        sizes: Count of numbers in each table.
        stored: Indices of the tables that are stored in 16 bits in the next measurements.
        rounded: The error of storing the outputs alone.
    """

    def __init__(
        self,
        model: ir.Model,
        manifest: GeneratorManifest,
        probes: Sequence[Probe],
        tolerances: Tolerances,
        *,
        half_outputs: bool,
        roundings: int,
        weights_only: bool = False,
    ) -> None:
        self.roundings = roundings
        declared = manifest.outputs
        assert declared.gaussians is not None
        if declared.appearance is None or declared.count is None:
            raise RewriteFailed(
                "the manifest names no appearance or count, expected both", where="manifest.outputs"
            )
        self.names = (
            declared.gaussians.name,
            declared.appearance.name,
            declared.count.name,
            *([declared.cells.name] if declared.cells is not None else []),
        )
        self.space, self.tolerances = declared.appearance.space, tolerances
        self.probes, self.storage = probes, np.float16 if half_outputs else np.float32
        self.model = InstrumentedModel(model, weights_only=weights_only)
        self.weights, self.sizes = self.model.weights, self.model.sizes
        self.stored: Collection[int] = ()
        # The search compares every step-th row of large outputs; the result is compared in full.
        self._step = max(1, -(-len(probes) * self.frame_bytes // MAX_KEPT_OUTPUT_BYTES))
        self._references = [self._reference(probe, self._step) for probe in probes]
        self._unseen_probes = _unseen_probes(manifest, probes)
        # A search with a smaller share of the tolerance asks for most choices again.
        self._measured_errors: dict[tuple[frozenset[int], ...], tuple[float, str]] = {}
        self.rounded = self.parity(frozenset())
        self._storage_excess = {field.field: field.excess for field in self.rounded.fields}

    @cached_property
    def frame_bytes(self) -> int:
        """The size in bytes of the float32 outputs of a frame."""
        outputs = self.model.run(self.probes[0].inputs, np.zeros(len(self.model.units), np.bool_))
        return sum(outputs[name].nbytes for name in self.names if outputs[name].dtype.kind == "f")

    def _reference(self, probe: Probe, step: int = 1) -> Reference:
        empty_node_list = np.zeros(len(self.model.units), np.bool_)
        output = self._read(self.model.run(probe.inputs, empty_node_list)).every_nth(step)
        if output.rows.dtype != np.float32:
            message = f"is {output.rows.dtype} already"
            raise RewriteFailed(message, where=f"output {self.names[0]}")
        cells = None if output.cells is None else layout.decode_cells(output.cells)
        rows = layout.decode(output.rows, output.color, self.space)
        return Reference(probe, rows, output.count, cells)

    def _read(self, outputs: Mapping[str, np.ndarray]) -> ModelOutput:
        rows, color, count, *cells = (outputs[name] for name in self.names)
        return ModelOutput(rows, color, int(np.ravel(count)[0]), *cells)

    def _round_outputs(self, output: ModelOutput) -> ModelOutput:
        """Round an output to the dtype in which the float16 model stores it."""
        with np.errstate(over="ignore"):
            cells = None if output.cells is None else output.cells.astype(self.storage)
            rows, color = (output.rows.astype(self.storage), output.color.astype(self.storage))
            return ModelOutput(rows, color, output.count, cells)

    def parity(self, selected: Collection[int]) -> Parity:
        """Compare a model whose selected nodes and tables are float16 with the float32 model."""
        flags = np.zeros(len(self.model.units), np.bool_)
        flags[list(selected)] = True
        stored = np.zeros(len(self.weights), np.bool_)
        stored[list(self.stored)] = True
        runs = (self.model.run(probe.inputs, flags, stored) for probe in self.probes)
        outputs = (self._round_outputs(self._read(run).every_nth(self._step)) for run in runs)
        return self._compare(self._references, outputs)

    def _compare(self, references: Iterable[Reference], outputs: Iterable[ModelOutput]) -> Parity:
        return compare(references, outputs, self.tolerances, roundings=self.roundings)

    def __call__(self, selected: Collection[int]) -> tuple[float, str]:
        """Return error / tolerance and name of the output field that float16 nodes affect most."""
        key = (frozenset(selected), frozenset(self.stored), self.model.unstepped)
        if key not in self._measured_errors:
            error_shares = {
                field.field: self._error_share(field) for field in self.parity(selected).fields
            }
            worst_field = max(error_shares, key=lambda field: error_shares[field], default="")
            self._measured_errors[key] = (error_shares.get(worst_field, 0.0), worst_field)
        return self._measured_errors[key]

    def weights_error(self, stored: Collection[int]) -> tuple[float, str]:
        """Return error / tolerance and name of the output field that 16-bit weights affect most."""
        self.stored = stored
        return self(())

    def _error_share(self, field: FieldError) -> float:
        """Return a field's error as a share of the tolerance that rounding the outputs leaves."""
        base = self._storage_excess.get(field.field, 0.0)
        return float((field.excess - base) / max(1 - base, _MIN_TOLERANCE))

    def model_parity(self, model: ir.Model, limits: Limits) -> Parity:
        """Compare a float16 model with float32, also for test inputs unseen by the search."""
        probes = [*self.probes, *self._unseen_probes]
        known_references = self._references if self._step == 1 else ()
        references = chain(
            known_references, (self._reference(probe) for probe in probes[len(known_references) :])
        )
        with temporary_folder() as folder:
            file = folder / "float16.onnx"
            save_model(model, file, external_weights=has_external_weights(model))
            size = sum(path.stat().st_size for path in folder.iterdir())
            runs = run_in_groups(
                file,
                self.names,
                probes,
                limits.for_model(size + self.frame_bytes),
                frame_bytes=self.frame_bytes,
                failure=_cannot_run_error,
            )
            return self._compare(references, (self._read(outputs) for outputs in runs))


def _cannot_run_error(message: str, hint: str) -> RewriteFailed:
    message = f"ONNX Runtime cannot run the result: {message}"
    return RewriteFailed(message, where="float16", hint=hint)


def _unseen_probes(manifest: GeneratorManifest, probes: Sequence[Probe]) -> tuple[Probe, ...]:
    """Return test inputs with cameras, times and poses other than those of ``probes``."""
    inputs = probes[0].inputs
    shapes = {name: array.shape for name, array in inputs.items()}
    dtypes = {name: array.dtype.name for name, array in inputs.items()}
    return (
        default_probes(manifest, shapes, dtypes, seed=1, count=_HELD_OUT_PROBE_COUNT)
        if inputs
        else ()
    )
