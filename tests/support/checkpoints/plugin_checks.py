"""Compare a generator, eager or exported, with what its method computes."""

import importlib.util
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch

from gsgen.contract.spec.geometry import look_at
from gsgen.sdk import GaussianGenerator
from gsgen.sdk.authoring.packed_module import Packed, PackedGenerator
from support.checkpoints.plugin_oracles import ExpectedGaussians
from support.commands import shared

# Goldens are accepted with these shares of the largest expected value; tests ask for a third.
MARGIN = 3
ALLOWED = {"position": 2e-5, "opacity": 2e-5, "covariance": 5e-5, "color": 2e-5}
ALLOWED_FLOAT16 = {"position": 1.5e-3, "opacity": 1.5e-3, "covariance": 3e-3, "color": 2e-3}


def eager(generator: GaussianGenerator, *inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return packed rows and appearance."""
    tensors = [torch.from_numpy(np.array(value)) for value in inputs]
    with torch.no_grad():
        count = generator(*tensors).position.shape[0]
        packed = PackedGenerator(generator, Packed(torch.float32, count))
        rows, color, *_ = packed(*tensors)
    return rows.numpy(), color.numpy()


def camera(rng: np.random.Generator, distance: float = 4.0, scale: float = 1.0) -> np.ndarray:
    """Return a view matrix in column order, of a model that is ``scale`` times its size."""
    eye = rng.normal(size=3)
    eye *= distance / np.linalg.norm(eye)
    view = look_at(eye, rng.normal(0, 0.2, 3), np.array([0.0, -1.0, 0.0]))
    view[:3, :3] *= scale
    return np.ascontiguousarray(view.T, np.float32)


def assert_like(
    rows: np.ndarray,
    color: np.ndarray,
    expected: ExpectedGaussians,
    allowed: Mapping[str, float] = ALLOWED,
) -> None:
    """Demand that drawn rows agree, and that others cannot be seen."""
    retained = expected.retained
    is_certain = np.ones(len(retained), bool) if expected.doubtful is None else ~expected.doubtful
    assert np.isfinite(rows).all()
    assert np.isfinite(color).all()
    both = is_certain[retained]
    pairs = {
        "position": (rows[retained, :3], expected.position),
        "opacity": (rows[retained, 3], expected.opacity),
        "covariance": (rows[retained, 4:], expected.covariance),
        "color": (color[retained, : expected.color.shape[1]], expected.color),
    }
    for name, (values, target) in pairs.items():
        error = np.abs(values[both] - target[both]).max() / np.abs(target).max()
        assert error <= allowed[name] / MARGIN, (name, error)
    assert (rows[~retained & is_certain, 3] == 0).all()


def field_errors(
    rows: np.ndarray, color: np.ndarray, target: Mapping[str, np.ndarray]
) -> dict[str, float]:
    """Return the largest error of each field as a share of its largest expected value.

    Args:
        rows: [N, 10] packed rows.
        color: [N, C] appearance, of which the first columns are compared.
        target: ``position``, ``opacity``, ``covariance`` and ``color`` of the method's own code.
    """
    fields = {
        "position": rows[:, :3],
        "opacity": rows[:, 3],
        "covariance": rows[:, 4:],
        "color": color[:, : target["color"].shape[1]],
    }
    return {
        name: float(np.abs(values.astype(np.float64) - target[name]).max() / np.abs(target[name]).max())
        for name, values in fields.items()
    }  # fmt: skip


def assert_golden(
    rows: np.ndarray,
    color: np.ndarray,
    target: Mapping[str, np.ndarray],
    allowed: Mapping[str, float],
) -> None:
    """Demand that each field agrees with the method's own code three times better than allowed."""
    for field, error in field_errors(rows, color, target).items():
        assert error <= allowed[field] / MARGIN, (field, error)


def acceptance() -> ModuleType:
    """Return the tool that compares models with golden outputs, or skip where it is absent."""
    path = shared("tools/accept_checkpoint.py")
    spec = importlib.util.spec_from_file_location("accept_checkpoint", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def stored(model: Path) -> int:
    """Return how many bytes of float weights a model holds; indices stay as they are."""
    floats = (onnx.TensorProto.FLOAT, onnx.TensorProto.FLOAT16)
    weights = onnx.load(model).graph.initializer
    return sum(len(weight.raw_data) for weight in weights if weight.data_type in floats)


def weights_of(model: Path, names: set[str]) -> list[int]:
    """Return how many bytes the weights called so have."""
    weights = onnx.load(model).graph.initializer
    return [len(tensor.raw_data) for tensor in weights if tensor.name in names]


def run(model: Path, feeds: dict[str, Any]) -> list[np.ndarray]:
    """Run a model on the CPU, with those of ``feeds`` that it takes."""
    session = onnxruntime.InferenceSession(model)
    used = {
        declared.name: np.asarray(feeds[declared.name]).reshape(declared.shape)
        for declared in session.get_inputs()
    }
    return list(session.run(None, used))


def judge(case: str, model: Path) -> list[tuple[bool, dict[str, float]]]:
    """Compare a model with every golden frame of ``case``: whether it agrees, and how closely."""
    tool, results = acceptance(), []
    for index, (feeds, target) in enumerate(tool.targets(case)):
        rows, color = run(model, feeds)[:2]
        dtype = "f16" if rows.dtype == np.float16 else "f32"
        results.append(tool.check(case, index, rows, color, dtype, target))
    return results


def assert_margin(case: str, model: Path) -> None:
    """Demand that a model agrees with every golden frame three times better than is asked."""
    output_type = onnx.load(model).graph.output[0].type.tensor_type.elem_type
    dtype = "f16" if output_type == onnx.TensorProto.FLOAT16 else "f32"
    allowed = {"leak": 1 / 512, "tail_opacity": 1 / 512, **acceptance().TOL[dtype]}
    for index, (agrees, errors) in enumerate(judge(case, model)):
        assert agrees, (index, errors)
        for field, error in errors.items():
            assert error <= allowed[field] / MARGIN, (index, field, error)
