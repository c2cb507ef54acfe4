"""One input of a model: what may be fed to it, and how a value becomes its tensor."""

__all__ = ["InputBinding", "default_tensor"]

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from gsgen.contract.spec.manifest import Input
from gsgen.sdk.binding.providers.errors import InputInvalid

_MATRICES = ("view", "projection")


@dataclass(frozen=True, slots=True)
class InputBinding:
    """An input tensor, and what the manifest says of it.

    Attributes:
        name: The tensor's name.
        dtype: Its dtype.
        shape: Its static shape.
        declared: Its entry in the manifest, or None.
        order: Memory order of matrices, ``column`` or ``row``.
    """

    name: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    declared: Input | None
    order: str

    @property
    def role(self) -> str:
        """The declared role; empty where nothing is declared."""
        return self.declared.role if self.declared else ""

    @property
    def nbytes(self) -> int:
        """Its size in bytes."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def transposed(self) -> bool:
        """Whether the tensor holds Mᵀ where M is given."""
        return self.role in _MATRICES and self.order == "column"

    def tensor(self, value: object) -> np.ndarray:
        """Return ``value`` as this input's tensor: a number fills a tensor of one element.

        Matrices are given as in mathematics, and laid out as the manifest declares.

        Raises:
            InputInvalid: Its shape, dtype or range is another.
        """
        made = self.fitting(value)
        limits = self.declared.range if self.declared else None
        if limits is not None and made.size:
            low, high = np.asarray(limits).astype(self.dtype)
            if not (
                made.min() >= low and made.max() <= high
            ):  # so that NaN is refused, too
                actual = (
                    f"{made.min():g}"
                    if made.size == 1
                    else f"{made.min():g} … {made.max():g}"
                )
                raise self._invalid(f"is {actual}, wanted {limits[0]:g} … {limits[1]:g}")
        return made.T if self.transposed else made

    def fitting(self, value: object) -> np.ndarray:
        """Return ``value`` as an array of this shape and dtype, as it lies in memory.

        Raises:
            InputInvalid: Its shape is another, or its dtype cannot be converted without loss of
                kind.
        """
        try:
            array = np.asarray(value)
        except ValueError as error:  # a list of rows of unequal length
            raise self._invalid(f"is no array ({error})") from error
        if array.shape != self.shape:
            if array.ndim or self.shape.count(1) != len(self.shape):
                actual = f"has shape {list(array.shape)}"
                raise self._invalid(f"{actual}, wanted {list(self.shape)}")
            array = array.reshape(self.shape)
        if array.dtype == self.dtype:
            return array
        if array.dtype.kind not in "biuf" or not np.can_cast(
            array.dtype, self.dtype, "same_kind"
        ):
            raise self._invalid(f"is {array.dtype}, wanted {self.dtype}")
        return self._converted(array)

    def default(self) -> np.ndarray:
        """Return what is fed as long as nobody says more."""
        if self.declared is None:
            return np.zeros(self.shape, self.dtype)
        made = default_tensor(self.declared, self.shape)
        return np.ascontiguousarray(made.T if self.transposed else made, self.dtype)

    def _converted(self, array: np.ndarray) -> np.ndarray:
        if self.dtype.kind in "iu" and array.size:
            limits = np.iinfo(self.dtype)
            if not (array.min() >= limits.min and array.max() <= limits.max):
                actual = f"{array.min()} … {array.max()}"
                raise self._invalid(f"is {actual}, which {self.dtype} cannot hold")
        return np.asarray(array.astype(self.dtype))

    def _invalid(self, what: str) -> InputInvalid:
        role = f" (role {self.role})" if self.role and self.role != self.name else ""
        return InputInvalid(what, where=f"input {self.name}{role}")


def default_tensor(declared: Input, shape: tuple[int, ...]) -> np.ndarray:
    """Return the value that the contract gives to an input before anybody does.

    Specified under "default" in the manifest's specification; matrices as in mathematics.

    Raises:
        InputInvalid: The declared default does not fill ``shape``.
    """
    default = declared.default
    if default is None:
        default = "identity" if declared.role in _MATRICES else _low(declared)
    if default == "zeros":
        return np.zeros(shape)
    if default == "identity":
        return _identity(declared.role, shape)
    values = np.asarray(default, np.float64)
    if values.ndim and values.size != np.prod(shape):
        what = f"default has {values.size} numbers, wanted {int(np.prod(shape))}"
        raise InputInvalid(what, where=f"input {declared.name}")
    return values.reshape(shape) if values.ndim else np.full(shape, values)


def _low(declared: Input) -> float:
    return declared.range[0] if declared.range else 0.0


def _identity(role: str, shape: tuple[int, ...]) -> np.ndarray:
    """Return the transform that changes nothing, in the form that ``shape`` has."""
    if role != "pose" and len(shape) == 2 and shape[0] == shape[1]:
        return np.eye(shape[0])
    made = np.zeros(shape)  # rotation vectors
    if shape[-1:] == (4,):
        made[..., 0] = 1.0  # quaternions (w, x, y, z)
    return made
