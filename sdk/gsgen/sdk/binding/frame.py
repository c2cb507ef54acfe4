"""The outputs of one computed frame of a model, decoded on request."""

__all__ = ["Frame"]

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from gsgen.contract.errors import LayoutMismatch, UnknownName
from gsgen.contract.spec.layout import DecodedGaussians, decode
from gsgen.contract.spec.manifest import GeneratorManifest, GeneratorOutputs, Manifest
from gsgen.sdk.binding.providers.buffers import Buffer


class FrameSource(Protocol):
    """Protocol of a model's session that computed a frame and holds the frame's output buffers."""

    manifest: Manifest | None

    @property
    def outputs(self) -> Mapping[str, Buffer]:
        """The output buffers of the model's session, by output name."""

    def read(self, name: str, number: int) -> np.ndarray:
        """Return an output of frame ``number``; raise if a newer frame has overwritten it."""

    def handle(self, name: str, number: int) -> Any:
        """Return the ``OrtValue`` that holds a model output of frame ``number``."""

    def hold_frame(self, number: int) -> AbstractContextManager[None]:
        """Prevent other threads from computing a new frame while frame ``number`` is read."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """The outputs that a model computed for one set of input values.

    Arrays are read-only views of the session's buffers and valid until its next run; a frame
    computed with ``copy=True`` has arrays of its own.

    Attributes:
        session: The session that computed the frame.
        number: Number of the frame in the session, from 0.
        copies: Output name → array of its own; None if outputs are in the session's buffers.
    """

    session: FrameSource
    number: int
    copies: Mapping[str, np.ndarray] | None = None

    def __getitem__(self, name: str) -> np.ndarray:
        """Return an output of the frame as an array; device memory is copied to the host.

        Raises:
            UnknownName: The model has no such output.
            FrameExpired: The session has computed a newer frame.
        """
        if self.copies is None:
            return self.session.read(name, self.number)
        if name not in self.copies:
            raise UnknownName.among("output", name, self.copies)
        return self.copies[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.session.outputs if self.copies is None else self.copies)

    def __repr__(self) -> str:
        return f"<Frame {self.number}: outputs {', '.join(self)}>"

    def handle(self, name: str) -> Any:
        """Return ONNX Runtime's ``OrtValue`` of an output, on the device, without copying.

        The handle is the same object in every frame.
        """
        return self.session.handle(name, self.number)

    @property
    def count(self) -> int:
        """The frame's number of Gaussians: the row count output if declared, else all rows.

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
        """The frame's packed Gaussians, [count, 10], without padding rows, in the model's dtype."""
        outputs = self._declared()
        if outputs.gaussians is None:
            raise _undeclared_output_error("gaussians")
        return self[outputs.gaussians.name][: self.count]

    @property
    def appearance(self) -> np.ndarray:
        """The SH or RGB of the frame's Gaussians without padding, [count, C], in model dtype."""
        outputs = self._declared()
        if outputs.appearance is None:
            raise _undeclared_output_error("appearance")
        return self[outputs.appearance.name][: self.count]

    @property
    def cells(self) -> np.ndarray:
        """The frame's packed cells (groups of Gaussians), [cells, 10], without padding cells."""
        outputs = self._declared()
        if outputs.cells is None:
            raise _undeclared_output_error("cells")
        return self[outputs.cells.name][: -(-self.count // outputs.cells.per_cell)]

    def gaussians(self) -> DecodedGaussians:
        """Decode the frame's packed Gaussians, up to the row count, to new float32 arrays.

        Raises:
            LayoutMismatch: The manifest does not declare both outputs, or their shapes differ.
        """
        appearance = self._declared().appearance
        if appearance is None:
            raise _undeclared_output_error("appearance")
        with self.session.hold_frame(self.number) if self.copies is None else nullcontext():
            return decode(self.rows, self.appearance, appearance.space)

    def _capacity(self, name: str) -> int:
        """Return the number of rows of an output without copying the output from the device."""
        tensors = self.session.outputs if self.copies is None else self.copies
        return tensors[name].shape[0]

    def _declared(self) -> GeneratorOutputs:
        manifest = self.session.manifest
        if not isinstance(manifest, GeneratorManifest):
            raise _undeclared_output_error("gaussians")
        return manifest.outputs


def _undeclared_output_error(output: str) -> LayoutMismatch:
    message = f"no manifest declares the output that holds the {output}"
    hint = "Embed one (`gsgen inspect --emit-manifest`), or read outputs by name: frame[NAME]."
    return LayoutMismatch(message, where="frame", hint=hint)
