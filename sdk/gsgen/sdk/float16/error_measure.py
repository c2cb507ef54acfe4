"""How much it shows, in the contract's units, that numbers of a model are float16."""

__all__ = ["ErrorProbe"]

import tempfile
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx_ir as ir

from gsgen.contract.probing.probes import Probe, default_probes
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import GeneratorManifest, Tolerances
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.float16.instrumented_model import HalfModel
from gsgen.sdk.parity import FieldParity, ModelOutput, Parity, Reference, compare
from gsgen.sdk.rewriting.model_io import has_external_weights, save_model

_LEAST_ROOM = 1e-3
# A number that has no divisor with that of the probes searched at, so that times differ.
_UNSEEN = 12


class ErrorProbe:
    """Measures the error of rounding some nodes of a model, in the contract's units.

    Args:
        model: Float32 throughout.
        manifest: Says which outputs are compared, and how.
        probes: Inputs that choices are measured at.
        tolerances: What may differ.
        outputs: Whether the outputs are stored in float16, too.
        roundings: How often what storing them rounds may be added to the tolerances.

    Attributes:
        weights: Name of each table that can be stored in 16 bits a number.
        sizes: Numbers in each of them.
        stored: Which of them are, in all that is measured from now on.
        rounded: What storing the outputs changes by itself.

    Raises:
        RewriteFailed: The outputs are float16 already, or some are not declared.
    """

    def __init__(
        self,
        model: ir.Model,
        manifest: GeneratorManifest,
        probes: Sequence[Probe],
        tolerances: Tolerances,
        outputs: bool,
        roundings: int,
    ) -> None:
        self.roundings = roundings
        declared = manifest.outputs
        assert declared.gaussians is not None
        if declared.appearance is None or declared.count is None:
            raise RewriteFailed("names no appearance or count", where="manifest.outputs")
        self.names = (
            declared.gaussians.name,
            declared.appearance.name,
            declared.count.name,
            *([declared.cells.name] if declared.cells is not None else []),
        )
        self.space, self.tolerances = declared.appearance.space, tolerances
        self.probes, self.storage = probes, np.float16 if outputs else np.float32
        self.model = HalfModel(model)
        self.weights, self.sizes = self.model.weights, self.model.sizes
        self.stored: Collection[int] = ()
        self._references = [self._reference(probe) for probe in probes]
        self._unseen = [self._reference(probe) for probe in _unseen(manifest, probes)]
        self.rounded = self.parity(frozenset())
        self._stored = {one.field: _excess(one) for one in self.rounded.fields}

    @property
    def frame_bytes(self) -> int:
        """Bytes of float32 rows that a frame gives."""
        made = self.model.run(
            self.probes[0].inputs, np.zeros(len(self.model.units), np.bool_)
        )
        return sum(made[name].nbytes for name in self.names if made[name].dtype.kind == "f")

    def _reference(self, probe: Probe) -> Reference:
        nothing = np.zeros(len(self.model.units), np.bool_)
        made = self._read(self.model.run(probe.inputs, nothing))
        if made.rows.dtype != np.float32:
            what = f"is {made.rows.dtype} already"
            raise RewriteFailed(what, where=f"output {self.names[0]}")
        cells = None if made.cells is None else layout.decode_cells(made.cells)
        rows = layout.decode(made.rows, made.color, self.space)
        return Reference(probe, rows, made.count, cells)

    def _read(self, made: Mapping[str, np.ndarray]) -> ModelOutput:
        rows, color, count, *cells = (made[name] for name in self.names)
        return ModelOutput(rows, color, int(np.ravel(count)[0]), *cells)

    def _stored_as(self, one: ModelOutput) -> ModelOutput:
        """Return the same as the outputs will hold it."""
        with np.errstate(over="ignore"):
            cells = None if one.cells is None else one.cells.astype(self.storage)
            rows, color = one.rows.astype(self.storage), one.color.astype(self.storage)
            return ModelOutput(rows, color, one.count, cells)

    def parity(self, chosen: Collection[int]) -> Parity:
        """Compare the outputs with the ``chosen`` units rounded, and stored as they will be."""
        flags = np.zeros(len(self.model.units), np.bool_)
        flags[list(chosen)] = True
        stored = np.zeros(len(self.weights), np.bool_)
        stored[list(self.stored)] = True
        runs = (self.model.run(probe.inputs, flags, stored) for probe in self.probes)
        made = [self._stored_as(self._read(one)) for one in runs]
        return self._compared(self._references, made)

    def _compared(
        self, references: Sequence[Reference], made: Sequence[ModelOutput]
    ) -> Parity:
        return compare(references, made, self.tolerances, roundings=self.roundings)

    def __call__(self, chosen: Collection[int]) -> tuple[float, str]:
        """Return how much of the room that storage leaves is used up, and in which field."""
        used = {one.field: self._used(one) for one in self.parity(chosen).fields}
        worst = max(used, key=lambda field: used[field], default="")
        return used.get(worst, 0.0), worst

    def of_weights(self, stored: Collection[int]) -> tuple[float, str]:
        """Return the same of storing these tables in float16, with nothing computed in it."""
        self.stored = stored
        return self(())

    def _used(self, field: FieldParity) -> float:
        """Return the share of a field's tolerance that is used, storage in float16 left out."""
        base = self._stored.get(field.field, 0.0)
        return float((_excess(field) - base) / max(1 - base, _LEAST_ROOM))

    def of_model(self, model: ir.Model, limits: Limits) -> Parity:
        """Run a converted model in ONNX Runtime, at probes that the search did not see, too."""
        references = [*self._references, *self._unseen]
        probes = [one.probe for one in references]
        with tempfile.TemporaryDirectory(prefix="gsgen-") as folder:
            file = Path(folder) / "float16.onnx"
            save_model(model, file, beside=has_external_weights(model))
            size = sum(one.stat().st_size for one in Path(folder).iterdir())
            with execute(file, self.names, probes, limits.for_model(size)) as execution:
                if execution.fault is not None:
                    raise RewriteFailed(
                        f"ONNX Runtime cannot run the result: {execution.fault.message}",
                        where="float16",
                    )
                made = [
                    self._read(execution.samples[run.sample].outputs)
                    for run in execution.runs
                ]
                return self._compared(references, made)


def _unseen(manifest: GeneratorManifest, probes: Sequence[Probe]) -> tuple[Probe, ...]:
    """Return probes of other cameras, times and poses than those that nodes were chosen at."""
    inputs = probes[0].inputs
    shapes = {name: array.shape for name, array in inputs.items()}
    dtypes = {name: array.dtype.name for name, array in inputs.items()}
    return default_probes(manifest, shapes, dtypes, seed=1, count=_UNSEEN) if inputs else ()


def _excess(field: FieldParity) -> float:
    return field.excess if field.excess <= np.inf else np.inf
