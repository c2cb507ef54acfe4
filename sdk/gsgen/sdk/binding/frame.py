"""One computed frame: outputs by name, decoded when asked."""

__all__ = ["Frame"]

from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gsgen.contract.errors import LayoutMismatch, UnknownName
from gsgen.contract.spec.layout import DecodedGaussians, decode
from gsgen.contract.spec.manifest import GeneratorManifest, GeneratorOutputs

if TYPE_CHECKING:
    from gsgen.sdk.binding.session import FrameSession


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """What a session computed for one set of inputs.

    Arrays are views of the session's buffers, read-only, and hold until the session's next run;
    a frame that was made with ``copy=True`` has arrays of its own.

    Attributes:
        session: Where it comes from.
        number: It was the session's n-th, counted from 0.
        kept: Output name → array of its own; None where outputs lie in the session's buffers.
    """

    session: "FrameSession"
    number: int
    kept: Mapping[str, np.ndarray] | None = None

    def __getitem__(self, name: str) -> np.ndarray:
        """Return an output; from a device it is copied to the host, always to the same place.

        Raises:
            UnknownName: The model has no such output.
            FrameGone: The session has computed a newer frame since.
        """
        if self.kept is None:
            return self.session.read(name, self.number)
        if name not in self.kept:
            raise UnknownName.among("output", name, self.kept)
        return self.kept[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.session.outputs if self.kept is None else self.kept)

    def handle(self, name: str) -> Any:
        """Return ONNX Runtime's ``OrtValue`` of an output, on the device, without copying.

        It is the same object in every frame.
        """
        return self.session.handle(name, self.number)

    @property
    def count(self) -> int:
        """How many rows are live: what the model says, else all that there are.

        Raises:
            LayoutMismatch: The manifest declares no packed rows.
        """
        outputs = self._declared()
        rows = self._capacity(outputs.gaussians.name) if outputs.gaussians else 0
        if outputs.count is None:
            return rows
        return int(min(max(self[outputs.count.name].reshape(-1)[0], 0), rows))

    @property
    def rows(self) -> np.ndarray:
        """The packed rows that are live, [count, 10], as the model gave them."""
        outputs = self._declared()
        if outputs.gaussians is None:
            raise _undeclared("gaussians")
        return self[outputs.gaussians.name][: self.count]

    @property
    def appearance(self) -> np.ndarray:
        """The appearance of the live rows, [count, C], as the model gave it."""
        outputs = self._declared()
        if outputs.appearance is None:
            raise _undeclared("appearance")
        return self[outputs.appearance.name][: self.count]

    @property
    def cells(self) -> np.ndarray:
        """The packed cells that have a live row, [cells, 10], as the model gave them."""
        outputs = self._declared()
        if outputs.cells is None:
            raise _undeclared("cells")
        return self[outputs.cells.name][: -(-self.count // outputs.cells.per_cell)]

    def gaussians(self) -> DecodedGaussians:
        """Return the live rows, unpacked into float32 arrays of their own.

        Raises:
            LayoutMismatch: The manifest does not declare both outputs, or their shapes are others.
        """
        appearance = self._declared().appearance
        if appearance is None:
            raise _undeclared("appearance")
        with self.session.still(self.number) if self.kept is None else nullcontext():
            return decode(self.rows, self.appearance, appearance.space)

    def _capacity(self, name: str) -> int:
        """Return how many rows an output has, without copying it from the device."""
        held = self.session.outputs if self.kept is None else self.kept
        return held[name].shape[0]

    def _declared(self) -> GeneratorOutputs:
        manifest = self.session.manifest
        if not isinstance(manifest, GeneratorManifest):
            raise _undeclared("gaussians")
        return manifest.outputs


def _undeclared(output: str) -> LayoutMismatch:
    what = f"no manifest says which output holds the {output}"
    hint = (
        "Embed one (`gsgen inspect --emit-manifest`), or read outputs by name: frame[NAME]."
    )
    return LayoutMismatch(what, where="frame", hint=hint)
