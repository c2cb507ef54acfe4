"""Small weights are read as arrays of numbers, and everything else as None."""

import numpy as np
import pytest
from onnx import TensorProto, numpy_helper

from gsgen.contract.model.model_file import STUB_BYTES, small_array


@pytest.mark.parametrize("dtype", [np.float32, np.float16, np.int64, np.uint8, np.bool_])
def test_small_numeric_weights_are_read(dtype: type) -> None:
    array = np.arange(6).reshape(2, 3).astype(dtype)
    result = small_array(numpy_helper.from_array(array, "w"))
    assert result is not None
    assert result.dtype == array.dtype
    np.testing.assert_array_equal(result, array)


@pytest.mark.parametrize(
    "weight",
    [
        numpy_helper.from_array(np.zeros((0, 3), np.float32), "empty"),
        numpy_helper.from_array(np.array([b"a", b"b"], object), "strings"),
        numpy_helper.from_array(np.array([1j], np.complex64), "complex"),
        TensorProto(name="unread", data_type=TensorProto.FLOAT, dims=[2], raw_data=STUB_BYTES),
        TensorProto(name="short", data_type=TensorProto.FLOAT, dims=[2], raw_data=b"abc"),
        TensorProto(name="unknown", data_type=9999, dims=[1], raw_data=b"abcd"),
    ],
    ids=lambda weight: weight.name,
)
def test_unreadable_weights_give_none(weight: TensorProto) -> None:
    assert small_array(weight) is None
