"""A model's outputs for one set of test inputs, for rules to read whole or in chunks of rows."""

__all__ = ["CHUNK_ROWS", "ModelOutputs", "Rows", "chunks", "read_outputs"]

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from gsgen.contract._array_types import Bool, Float, UInt
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.layout import COVARIANCE, CULL_OPACITY, OPACITY, POSITION, ROW_LENGTH
from gsgen.contract.spec.manifest import AppearanceOutput

if TYPE_CHECKING:
    from gsgen.contract.causes.readings import Explanation, SeenRows

# Rows checked at a time: their unpacked columns stay in the second-level cache.
CHUNK_ROWS = 16384

_SAMPLE_ROWS = 1 << 13
_ORDER_SAMPLE = 1 << 10
# Half of the smallest step of float16.
_HALF_FLOAT16_STEP = 2.0**-25
_EXPONENT_MASK_BY_BYTES = {2: 0x7C00, 4: 0x7F800000}
_MAGNITUDE_MASK_BY_BYTES = {2: 0x7FFF, 4: 0x7FFFFFFF}
_UINT_TYPE_BY_ITEMSIZE: dict[int, type[np.unsignedinteger]] = {2: np.uint16, 4: np.uint32}


@dataclass(frozen=True, kw_only=True)
class ModelOutputs:
    """The model outputs for one set of test inputs: Gaussians, colours, row count, cells (groups).

    Attributes:
        probe: The probe's label.
        zeros: Whether all inputs of the probe were zero.
        outputs: Output name → array, as computed.
        gaussians: The packed rows, or None if they are not a [N, 10] array of floats.
        appearance: The appearance rows, or None if they are not [N, C] floats.
        count: Number of live rows that the model outputs, clipped to the capacity.
        declared: The declaration of the appearance.
        subject: The model.
        cells: The packed cells, or None if the output is absent or malformed.
        cameras: The rows of runs that differ in the camera alone.
    """

    probe: str
    zeros: bool
    outputs: dict[str, np.ndarray]
    gaussians: Float[np.ndarray, "n 10"] | None
    appearance: Float[np.ndarray, "n c"] | None
    count: int
    declared: AppearanceOutput | None
    subject: InspectedModel
    cells: Float[np.ndarray, "c 10"] | None = None
    cameras: "tuple[SeenRows, ...]" = ()

    @property
    def rows_label(self) -> str:
        """The name of the packed Gaussians' output in reports, such as ``gaussian``."""
        declared = self.subject.declared_gaussians
        return f"output {declared.name if declared else '?'}"

    @property
    def color_label(self) -> str:
        """The name of the appearance output in reports, such as ``color``."""
        return f"output {self.declared.name if self.declared else '?'}"

    @property
    def cells_label(self) -> str:
        """The name of the output with cells (groups of Gaussians) in reports, such as ``cells``."""
        declared = self.subject.declared_cells
        return f"output {declared.name if declared else '?'}"

    @property
    def is_sh(self) -> bool:
        """Whether the manifest declares the appearance as SH coefficients."""
        return self.declared is not None and self.declared.space == "sh"

    @cached_property
    def shown_colors(self) -> Float[np.ndarray, "m c"]:
        """A sample of the finite colours of visible Gaussians, in float32."""
        rows, color = self.gaussians, self.appearance
        if rows is None or color is None:
            return np.zeros((0, 0))
        live = slice(0, self.count, max(1, self.count // _SAMPLE_ROWS))
        is_drawn = rows[live, OPACITY].astype(np.float32) >= CULL_OPACITY
        sample = color[live][is_drawn].astype(np.float32)
        finite = np.isfinite(sample).all(axis=1)
        return sample if finite.all() else np.asarray(sample[finite])

    @cached_property
    def explanation(self) -> "Explanation | None":
        """The reading in which the rows are Gaussians of one scene, unlike as declared; or None."""
        if self.gaussians is None or self.zeros:
            return None
        from gsgen.contract.causes.explanations import explain_rows

        step = max(1, self.count // _ORDER_SAMPLE)
        generator = getattr(self.subject, "generator", None)
        bounds = generator.bounds if generator is not None else None
        planes = self.gaussians.reshape(ROW_LENGTH, -1).T[: self.count : step]
        return explain_rows(
            self.gaussians[: self.count : step].astype(np.float64),
            (bounds.min, bounds.max) if bounds is not None else None,
            planes.astype(np.float64),
            rounding_error=_HALF_FLOAT16_STEP if self.gaussians.dtype == np.float16 else 0.0,
            cameras=self.cameras,
        )


def read_outputs(
    subject: InspectedModel,
    probe: str,
    outputs: dict[str, np.ndarray],
    *,
    zeros: bool = False,
    cameras: "tuple[SeenRows, ...]" = (),
) -> ModelOutputs:
    """Assign the outputs of a model run to the roles that the manifest declares.

    Args:
        subject: The model.
        probe: The label of the probe.
        outputs: Name → array.
        zeros: Whether all inputs of the probe are zero.
        cameras: The rows of runs that differ in the camera alone.
    """

    def take_output(name: str | None) -> np.ndarray | None:
        return outputs.get(name) if name else None

    rows = _float_rows(take_output(getattr(subject.declared_gaussians, "name", None)), 10)
    color = _float_rows(take_output(getattr(subject.declared_appearance, "name", None)), None)
    if rows is not None and color is not None and len(rows) != len(color):
        color = None  # another rule reports it
    count = take_output(getattr(subject.declared_count, "name", None))
    capacity = len(rows) if rows is not None else 0
    is_integer_count = count is not None and count.size and count.dtype.kind in "iu"
    live = int(count.reshape(-1)[0]) if count is not None and is_integer_count else capacity
    clipped_count = min(max(live, 0), capacity)
    cells = _float_rows(take_output(getattr(subject.declared_cells, "name", None)), 10)
    per_cell = getattr(subject.declared_cells, "per_cell", 0)
    if cells is not None and len(cells) * per_cell != capacity:
        cells = None  # another rule reports it
    declared = subject.declared_appearance
    return ModelOutputs(
        probe=probe,
        zeros=zeros,
        outputs=outputs,
        gaussians=rows,
        appearance=color,
        count=clipped_count,
        declared=declared,
        subject=subject,
        cells=cells,
        cameras=cameras,
    )


def _float_rows(array: np.ndarray | None, columns: int | None) -> np.ndarray | None:
    if array is None or array.ndim != 2 or array.dtype not in (np.float32, np.float16):
        return None
    return array if columns in (None, array.shape[1]) else None


@dataclass(frozen=True)
class Rows:
    """A chunk of a model's packed Gaussians, unpacked to float32 on first access.

    Attributes:
        emission: The outputs that contain the chunk.
        start: Index of its first row.
        packed: The packed rows, as stored.
        color: The appearance rows, as stored, or None if they cannot be read.
    """

    emission: ModelOutputs
    start: int
    packed: Float[np.ndarray, "n 10"]
    color: Float[np.ndarray, "n c"] | None

    def __len__(self) -> int:
        return len(self.packed)

    @cached_property
    def float32_columns(self) -> Float[np.ndarray, "10 n"]:
        """The packed Gaussians in float32, one contiguous array per column."""
        return np.ascontiguousarray(self.packed.T, np.float32)

    @property
    def position(self) -> Float[np.ndarray, "3 n"]:
        """The centres of the chunk's Gaussians, one array per axis."""
        return np.asarray(self.float32_columns[POSITION])

    @property
    def opacity(self) -> Float[np.ndarray, " n"]:
        """The opacity of each packed Gaussian in the chunk."""
        return np.asarray(self.float32_columns[OPACITY])

    @property
    def covariance(self) -> Float[np.ndarray, "6 n"]:
        """The covariances of the chunk's Gaussians, one array per entry of the upper triangle."""
        return np.asarray(self.float32_columns[COVARIANCE])

    @cached_property
    def live_rows(self) -> int:
        """The number of the chunk's rows before the model's row count; later rows are padding."""
        return int(np.clip(self.emission.count - self.start, 0, len(self)))

    @cached_property
    def counted(self) -> Bool[np.ndarray, " n"]:
        """The mask of the chunk's rows before the model's row count; later rows are padding."""
        return np.arange(len(self)) < self.live_rows

    @cached_property
    def finite(self) -> Bool[np.ndarray, " n"]:
        """The mask of the Gaussians whose packed values and colours are all finite."""
        is_finite: Bool[np.ndarray, " n"] = np.isfinite(self.float32_columns).all(axis=0)
        if self.color is not None:
            is_finite &= self.color_peak < _EXPONENT_MASK_BY_BYTES[self.color.itemsize]
        return is_finite

    @cached_property
    def color_peak(self) -> UInt[np.ndarray, " n"]:
        """The largest absolute colour value of each Gaussian, as the integer of its float bits.

        Zero if no value of the chunk is near the largest value of its dtype.
        """
        assert self.color is not None
        bits = _magnitude_bits(self.color)
        if bits.size == 0 or int(bits.max()) < _EXPONENT_MASK_BY_BYTES[self.color.itemsize] - 1:
            return np.zeros(len(self), bits.dtype)
        return np.asarray(bits.max(axis=1))

    @cached_property
    def drawn(self) -> Bool[np.ndarray, " n"]:
        """The mask of finite, non-padding Gaussians that are opaque enough to change a pixel."""
        return np.asarray(self.counted & self.finite & (self.opacity >= CULL_OPACITY))

    @cached_property
    def drawn_count(self) -> int:
        """The number of finite, non-padding Gaussians that are opaque enough to change a pixel."""
        return int(np.count_nonzero(self.drawn))

    @cached_property
    def trace(self) -> Float[np.ndarray, " n"]:
        """The trace of each Gaussian's covariance: the sum of the variances along the axes."""
        xx, _, _, yy, _, zz = self.covariance
        return np.asarray(xx + yy + zz)

    @cached_property
    def corners(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """The bounding box of all centres in the chunk; NaN if a centre is NaN."""
        return self.position.min(axis=1), self.position.max(axis=1)

    @cached_property
    def max_variance(self) -> Float[np.ndarray, " n"]:
        """The largest variance of each Gaussian along x, y or z."""
        xx, _, _, yy, _, zz = self.covariance
        return np.asarray(np.maximum(np.maximum(xx, yy), zz))


def _magnitude_bits(array: np.ndarray) -> UInt[np.ndarray, "..."]:
    """Return float bits without the sign, which sort by magnitude; NaN and infinity sort last."""
    word = _UINT_TYPE_BY_ITEMSIZE[array.itemsize]
    return np.asarray(
        np.ascontiguousarray(array).view(word) & word(_MAGNITUDE_MASK_BY_BYTES[array.itemsize])
    )


def chunks(emission: ModelOutputs) -> Iterator[Rows]:
    """Yield the packed Gaussians of a model run in chunks of :data:`CHUNK_ROWS` rows."""
    packed = emission.gaussians
    for start in range(0, 0 if packed is None else len(packed), CHUNK_ROWS):
        assert packed is not None
        part = slice(start, start + CHUNK_ROWS)
        color = None if emission.appearance is None else emission.appearance[part]
        yield Rows(emission, start, packed[part], color)
