"""Converts values to a model input's tensor, by the input's shape, dtype and range."""

__all__ = ["InputBinding"]

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from gsgen.contract.spec.fields.roles import MATRIX_ROLES
from gsgen.contract.spec.input_defaults import default_tensor
from gsgen.contract.spec.manifest import Input
from gsgen.sdk.binding.providers.errors import InputInvalid


@dataclass(frozen=True, slots=True, kw_only=True)
class InputBinding:
    """An input tensor of a model, and its declaration in the manifest.

    Attributes:
        name: The tensor's name.
        dtype: The tensor's dtype.
        shape: The tensor's static shape.
        declared: Its entry in the manifest, if any.
        order: Memory order of matrices, ``column`` or ``row``.
    """

    name: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    declared: Input | None
    order: str

    @property
    def role(self) -> str:
        """The input role (such as ``view``) in the manifest; empty for an undeclared input."""
        return self.declared.role if self.declared else ""

    @property
    def nbytes(self) -> int:
        """The size of the input tensor in bytes."""
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def transposed(self) -> bool:
        """Whether the matrix input is column-major, so that matrices are fed transposed."""
        return self.role in MATRIX_ROLES and self.order == "column"

    def tensor(self, value: object) -> np.ndarray:
        """Convert a value to the tensor of a model input; a number fills a one-element tensor.

        Matrices are passed as in mathematics, and stored as the manifest declares.

        Raises:
            InputInvalid: The shape, dtype or range does not fit.
        """
        array = self.convert_value(value)
        limits = self.declared.range if self.declared else None
        if limits is not None and array.size:
            low, high = np.asarray(limits).astype(self.dtype)
            if not (array.min() >= low and array.max() <= high):  # so that NaN is refused, too
                actual = (
                    f"{array.min():g}" if array.size == 1 else f"{array.min():g} … {array.max():g}"
                )
                raise self._invalid_value_error(
                    f"the value is {actual}, expected {limits[0]:g} … {limits[1]:g}"
                )
        return np.swapaxes(array, -1, -2) if self.transposed else array

    def convert_value(self, value: object) -> np.ndarray:
        """Convert a value to an array of the model input's shape and dtype, without transposing.

        Raises:
            InputInvalid: The shape differs, or the dtype is of another kind.
        """
        try:
            array = np.asarray(value)
        except ValueError as error:  # a list of rows of unequal length
            raise self._invalid_value_error(
                f"the value cannot be converted to an array: {error}"
            ) from error
        if array.shape != self.shape:
            if array.ndim or self.shape.count(1) != len(self.shape):
                shape, expected = list(array.shape), list(self.shape)
                raise self._invalid_value_error(
                    f"the value has shape {shape}, expected shape {expected}"
                )
            array = array.reshape(self.shape)
        if array.dtype == self.dtype:
            return array
        if array.dtype.kind not in "biuf" or not np.can_cast(array.dtype, self.dtype, "same_kind"):
            raise self._invalid_value_error(f"the value is {array.dtype}, expected {self.dtype}")
        return self._convert_to_dtype(array)

    def default(self) -> np.ndarray:
        """Return the tensor that a model input has until the caller sets a value."""
        if self.declared is None:
            return np.zeros(self.shape, self.dtype)
        try:
            tensor = default_tensor(self.declared, self.shape)
        except ValueError as error:
            raise InputInvalid(str(error), where=f"input {self.declared.name}") from error
        return np.ascontiguousarray(
            np.swapaxes(tensor, -1, -2) if self.transposed else tensor, self.dtype
        )

    def _convert_to_dtype(self, array: np.ndarray) -> np.ndarray:
        if self.dtype.kind in "iu" and array.size:
            limits = np.iinfo(self.dtype)
            if not (array.min() >= limits.min and array.max() <= limits.max):
                actual = f"{array.min()} … {array.max()}"
                raise self._invalid_value_error(
                    f"the value is {actual}, which {self.dtype} cannot represent"
                )
        return np.asarray(array.astype(self.dtype))

    def _invalid_value_error(self, message: str) -> InputInvalid:
        role = f" (role {self.role})" if self.role and self.role != self.name else ""
        return InputInvalid(message, where=f"input {self.name}{role}")
