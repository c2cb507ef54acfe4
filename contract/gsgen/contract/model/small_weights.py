"""Reads small weights of an ONNX model, whose data were read with the graph structure."""

__all__ = ["small_array"]

import numpy as np
from onnx import TensorProto, numpy_helper

from gsgen.contract.model.model_file import STUB


def small_array(weight: TensorProto) -> np.ndarray | None:
    """Return the array of a small weight; None if the weight was not read or is not numeric."""
    if weight.raw_data == STUB:
        return None
    try:
        array = np.asarray(numpy_helper.to_array(weight))
    except (ValueError, TypeError, KeyError):  # damaged: other rules report it
        return None
    return array if array.dtype.kind in "biuf" and array.size else None
