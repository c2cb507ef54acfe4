"""Convolutions whose channels WebGPU reads in threes: the same numbers with channels of zeros."""

from pathlib import Path

import numpy as np
import onnx
import onnx_ir as ir
import pytest
from onnx import numpy_helper

from gsgen.sdk.binding import FrameSession
from gsgen.sdk.passes.portability.pad_channels import PadChannels
from gsgen.sdk.rewriting.model_io import save_model
from support.passes import HEAD, operators, run

GENERATOR = np.random.default_rng(0)


def convolution(
    channels: int, count: int, kernel: list[int], dtype: str = "float", attributes: str = ""
) -> ir.Model:
    """Return a model of one Conv with constant random weights and a bias."""
    sizes = ",".join(["2", str(channels), *["8"] * len(kernel)])
    text = f"g ({dtype}[{sizes}] x) => ({dtype}[A,B{',C' * len(kernel)}] y) {{ y = Conv{attributes} (x, w, b) }}"
    proto = onnx.parser.parse_model(HEAD + text)
    kind = {"float": np.float32, "float16": np.float16}[dtype]
    groups = 3 if "group" in attributes else 1
    weights = GENERATOR.normal(size=(count, channels // groups, *kernel)).astype(kind)
    bias = GENERATOR.normal(size=count).astype(kind)
    proto.graph.initializer.extend(
        [numpy_helper.from_array(weights, "w"), numpy_helper.from_array(bias, "b")]
    )
    return ir.serde.deserialize_model(onnx.shape_inference.infer_shapes(proto))


def picture(model: ir.Model, dtype: type = np.float32) -> np.ndarray:
    (value,) = [entry for entry in model.graph.inputs if entry.name == "x"]
    return GENERATOR.normal(size=value.shape.numpy()).astype(dtype)


@pytest.mark.parametrize(
    ("channels", "count", "kernel", "attributes"),
    [
        (6, 4, [3, 3], ""),
        (9, 8, [3, 3], "<pads = [1, 1, 1, 1]>"),
        (9, 32, [4, 4], "<strides = [4, 4]>"),
        (15, 12, [1, 3], "<dilations = [1, 2]>"),
        (21, 4, [5], "<pads = [2, 2]>"),
    ],
)
def test_padded_channels_keep_the_value(
    channels: int, count: int, kernel: list[int], attributes: str
) -> None:
    model = convolution(channels, count, kernel, attributes=attributes)
    x = picture(model)
    (expected,) = run(model, x=x)
    assert PadChannels()(model).modified
    (actual,) = run(model, x=x)
    np.testing.assert_allclose(actual, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
    assert operators(model) == {"Pad", "Conv"}
    assert not PadChannels()(model).modified


@pytest.mark.parametrize(
    ("channels", "count", "kernel", "attributes"),
    [
        (3, 4, [3, 3], ""),  # right: the narrow vectors hold exactly one pixel
        (8, 4, [3, 3], ""),
        (12, 4, [3, 3], ""),
        (9, 6, [3, 3], ""),
        (9, 4, [1, 1], ""),
        (9, 12, [3, 3], "<group = 3>"),
        (9, 4, [3, 3, 3], ""),
    ],
)
def test_other_convolutions_are_left_alone(
    channels: int, count: int, kernel: list[int], attributes: str
) -> None:
    assert not PadChannels()(convolution(channels, count, kernel, attributes=attributes)).modified


@pytest.mark.parametrize("channels", range(1, 25))
def test_a_convolution_of_webgpu_is_right_after_the_pass(channels: int, tmp_path: Path) -> None:
    model = convolution(channels, 8, [3, 3])
    x = picture(model)
    (expected,) = run(model, x=x)
    PadChannels()(model)
    save_model(model, tmp_path / "m.onnx")
    with FrameSession(tmp_path / "m.onnx", provider="webgpu", capture=False) as session:
        actual = session.run({"x": x})["y"]
    np.testing.assert_allclose(actual, expected, atol=1e-4 * np.abs(expected).max())


def test_the_fault_of_the_provider_is_still_there(tmp_path: Path) -> None:
    """What the pass is for: without it, a picture of nine channels is computed wrongly."""
    model = convolution(9, 8, [3, 3])
    x = picture(model)
    (expected,) = run(model, x=x)
    save_model(model, tmp_path / "m.onnx")
    with FrameSession(tmp_path / "m.onnx", provider="webgpu", capture=False) as session:
        actual = session.run({"x": x})["y"]
    assert np.abs(actual - expected).max() > 0.1 * np.abs(expected).max()
