"""Errors of a frame name the model, the frame, and the part of the frame."""

import pytest

from gsgen.contract.errors import GsgenError
from gsgen.runtime.errors import SceneInvalid, locate_in_frame


@pytest.mark.parametrize(
    ("where", "expected"),
    [
        ("", "a.onnx, frame 7"),
        ("a.onnx", "a.onnx, frame 7"),
        ("output color", "a.onnx, frame 7, output color"),
    ],
)
def test_an_error_of_a_frame_names_model_and_frame(where: str, expected: str) -> None:
    error = locate_in_frame(SceneInvalid("3 rows", where=where, hint="try 4"), "a.onnx", 7)
    assert type(error) is SceneInvalid
    assert isinstance(error, GsgenError)
    assert (error.message, error.where, error.hint) == ("3 rows", expected, "try 4")
