"""Exports a static scene as an ONNX generator without inputs; torch is not needed.

The graph holds weights alone. Each output ends on a Mul by one, so that capture and replay have a
kernel to record.
"""

__all__ = [
    "Axis", "ConstantRows", "ConstantSource", "constant_manifest", "export_constant",
    "write_constant",
]  # fmt: skip

import os
from abc import abstractmethod
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import onnx
from jaxtyping import Float
from onnx import ModelProto, NodeProto, numpy_helper

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.model_file import MANIFEST_KEY
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.sandbox import execute
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import (
    AppearanceOutput,
    Bounds,
    CountOutput,
    GaussiansOutput,
    GeneratorManifest,
    GeneratorOutputs,
    Producer,
    Space,
    Tolerances,
)
from gsgen.contract.spec.manifest_io import dumps
from gsgen.contract.spec.onnx_facts import INLINE_LIMIT
from gsgen.contract.spec.reader_needs import smallest_profile
from gsgen.contract.spec.spherical_harmonics import degree_of
from gsgen.contract.validation.settings import Settings
from gsgen.sdk.errors import GeneratorInvalid, ParityFailed
from gsgen.sdk.exporting.pipeline import (
    OPSET,
    Dtype,
    Exported,
    ExportOptions,
    GraphSource,
    Progress,
    check_contract,
    no_progress,
)

Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
"""An axis of a scene with its sign."""

_IR_VERSION = 8
_BOUNDS_MARGIN = 1e-3
_OUTPUT_NAMES = {"sh": "color_sh", "rgb": "color_rgb"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstantRows:
    """The packed Gaussians of a static scene, and their colours as SH or RGB."""

    rows: Float[np.ndarray, "n 10"]  # packed Gaussians, float32 or float16 [N, 10]
    appearance: Float[np.ndarray, "n c"]  # SH or RGB, float32 or float16 [N, C]
    space: Literal["sh", "rgb"]  # whether ``appearance`` holds SH or RGB
    description: str  # the origin of the rows, such as "500 splats of SH degree 3"
    color_space: Literal["srgb", "linear"] = "srgb"  # color space of the appearance
    # the antialiasing that the scene was trained with
    antialias: Literal["classic", "mip"] = "classic"
    up: Axis = "-y"  # the upward axis of the scene
    # the point of the author's world that positions are relative to
    origin: tuple[float, float, float] | None = None
    notes: tuple[str, ...] = ()  # changes that the user should know of, a sentence each
    # whether the rows are the user's own, written even if they break rules
    passes_through: bool = False

    @property
    def degree(self) -> int | None:
        """The SH degree of the stored colours, or None if they are raw RGB."""
        return degree_of(self.appearance.shape[1] // 3) if self.space == "sh" else None

    @property
    def dtype(self) -> Dtype:
        """The dtype of the packed Gaussians."""
        return "float16" if self.rows.dtype == np.float16 else "float32"


class ConstantSource(GraphSource):
    """Base class of static scenes that can be packed as float32 or float16."""

    family: ClassVar[str | None] = None  # the manifest's word for the kind of generator

    @abstractmethod
    def pack(self, dtype: Dtype | None, target: str) -> ConstantRows:
        """Return the Gaussians of the scene as packed rows.

        Without ``dtype``, the rows have the source's own; ``target`` may read one SH degree alone.
        """

    def export(self, path: str | os.PathLike[str], **options: Any) -> Exported:
        """Export the scene by :func:`export_constant`, which has the same options."""
        return export_constant(self, path, **options)


def export_constant(
    source: ConstantSource,
    path: str | os.PathLike[str],
    *,
    name: str | None = None,
    dtype: Dtype | None = None,
    capacity: int | None = None,
    opset: int = OPSET,
    target: str = "core",
    settings: Settings | None = None,
    progress: Progress = no_progress,
) -> Exported:
    """Export a static scene as an ONNX generator that outputs equal Gaussians in every frame.

    Options are those of :func:`gsgen.sdk.export`; the graph needs no rewrites. ``dtype`` is the
    source's own by default. Rows up to ``capacity`` are zero. The bits of the outputs are compared,
    and the file is replaced only by a model that passed every check.
    """
    path = Path(path)
    options = ExportOptions(
        path=path,
        name=name or path.stem,
        opset=opset,
        target=target,
        settings=settings,
        progress=progress,
    )
    progress("packing the rows")
    packed = source.pack(dtype, target)
    manifest = constant_manifest(packed, options.name, family=source.family, capacity=capacity)
    outputs = _outputs(packed.rows, packed.appearance, manifest, len(packed.rows))
    with atomic_write(path) as draft:
        _save(_model(outputs, manifest, opset), draft)
        _check_written_model(draft, outputs)
        report = check_contract(draft, options, must_conform=not packed.passes_through)
    return Exported(
        path=path,
        manifest=manifest,
        report=report,
        dtype=packed.dtype,
        contents=f"{packed.description}, {packed.dtype}",
        notes=packed.notes,
    )


def constant_manifest(
    packed: ConstantRows, name: str, *, family: str | None, capacity: int | None = None
) -> GeneratorManifest:
    """Return the manifest of an ONNX generator that outputs constant packed Gaussians."""
    count = len(packed.rows)
    total = count if capacity is None else capacity
    if total < count:
        message = f"{total} is less than the {count} packed Gaussians"
        hint = f"Give {count} or more, or leave it out."
        raise ConfigInvalid(message, where="--capacity", hint=hint)
    return GeneratorManifest(
        name=name,
        family=family,
        producer=Producer(f"gsgen {version('gsgen')}"),
        outputs=GeneratorOutputs(
            GaussiansOutput("gaussians", total, packed.dtype),
            AppearanceOutput(
                _OUTPUT_NAMES[packed.space], packed.space, packed.degree, packed.color_space
            ),
            CountOutput("num_points"),
        ),
        space=Space(up=packed.up, origin=packed.origin),
        bounds=Bounds.from_points(packed.rows[:, layout.POSITION], _BOUNDS_MARGIN),
        antialias=packed.antialias,
        tolerances=Tolerances(),
    )


def write_constant(
    rows: Float[np.ndarray, "n 10"],
    appearance: Float[np.ndarray, "n c"],
    manifest: GeneratorManifest,
    path: Path,
    *,
    count: int | None = None,
    opset: int = OPSET,
) -> None:
    """Write an ONNX generator that outputs given packed Gaussians and appearance bit for bit.

    ``manifest`` names the outputs; rows up to its capacity are zero, and the first ``count`` rows
    are live, by default all. Write to the draft of
    :func:`gsgen.contract.process.atomic_files.atomic_write` to replace a model.
    """
    outputs = _outputs(rows, appearance, manifest, len(rows) if count is None else count)
    _save(_model(outputs, manifest, opset), path)
    _check_written_model(path, outputs)


def _outputs(
    rows: np.ndarray, appearance: np.ndarray, manifest: GeneratorManifest, count: int
) -> dict[str, np.ndarray]:
    declared = manifest.outputs
    if declared.gaussians is None or declared.appearance is None or declared.count is None:
        raise GeneratorInvalid(
            "the manifest names no gaussians, appearance or count, expected all three",
            where="manifest.outputs",
        )
    if declared.cells is not None:
        message = "the manifest declares cells, but a constant scene is written without cells"
        raise GeneratorInvalid(message, where="manifest.outputs")
    if rows.ndim != 2 or rows.shape[1] != layout.ROW_LENGTH or len(rows) != len(appearance):
        shapes = (
            f"rows and appearance have the shapes {list(rows.shape)} and {list(appearance.shape)}"
        )
        raise GeneratorInvalid(
            f"{shapes}, expected [N, {layout.ROW_LENGTH}] and [N, C]", where="rows"
        )
    if not 0 <= count <= len(rows):
        raise GeneratorInvalid(
            f"the row count {count} is not within 0 to {len(rows)}", where="count"
        )
    return {
        declared.gaussians.name: _padded(rows, declared.gaussians.capacity),
        declared.appearance.name: _padded(appearance, declared.gaussians.capacity),
        declared.count.name: np.array([count], np.int32),
    }


def _padded(rows: np.ndarray, total: int) -> np.ndarray:
    if total <= len(rows):
        return rows
    padding_rows = np.zeros((total - len(rows), rows.shape[1]), rows.dtype)
    return np.concatenate([rows, padding_rows])


def _model(outputs: dict[str, np.ndarray], manifest: GeneratorManifest, opset: int) -> ModelProto:
    model = ModelProto(ir_version=_IR_VERSION, producer_name="gsgen")
    full_manifest = replace(manifest, operator_profile=smallest_profile({"Mul"}, opset))
    model.opset_import.add(domain="", version=opset)
    model.metadata_props.add(key=MANIFEST_KEY, value=dumps(full_manifest, indent=None))
    graph = model.graph
    graph.name = "static"
    for name, value in outputs.items():
        weight, unit = f"{name}_weight", f"{name}_one"
        graph.initializer.append(numpy_helper.from_array(np.ascontiguousarray(value), weight))
        graph.initializer.append(numpy_helper.from_array(np.ones((), value.dtype), unit))
        graph.node.append(
            NodeProto(op_type="Mul", name=f"{name}_end", input=[weight, unit], output=[name])
        )
        declared = graph.output.add(name=name).type.tensor_type
        declared.elem_type = graph.initializer[-1].data_type
        for size in value.shape:
            declared.shape.dim.add(dim_value=size)
    return model


def _save(model: ModelProto, path: Path) -> None:
    size = sum(len(tensor.raw_data) for tensor in model.graph.initializer)
    if size <= INLINE_LIMIT:
        path.write_bytes(model.SerializeToString())
        return
    onnx.save_model(
        model, os.fspath(path), save_as_external_data=True, location=f"{path.name}.data"
    )


def _check_written_model(path: Path, outputs: dict[str, np.ndarray]) -> None:
    """Run an exported static scene once; raise unless its outputs equal the source bit for bit."""
    limits = Limits().for_model(sum(value.nbytes for value in outputs.values()))
    with execute(path, list(outputs), [Probe(label="no inputs", inputs={})], limits) as execution:
        if execution.fault is not None:
            message = f"ONNX Runtime cannot run the model: {execution.fault.message}"
            raise ParityFailed(message, where=path.name)
        for name, expected in outputs.items():
            actual = execution.samples[0].outputs[name]
            where = f"{path.name}, {name}"
            if actual.shape != expected.shape or actual.dtype != expected.dtype:
                shapes = f"{actual.dtype} {list(actual.shape)}"
                message = f"output is {shapes}, expected {expected.dtype} {list(expected.shape)}"
                raise ParityFailed(message, where=where)
            # NaN equals NaN: its payload does not change what is drawn.
            is_equal = (actual == expected) | ((actual != actual) & (expected != expected))
            if not is_equal.all():
                count = f"{np.count_nonzero(~is_equal):,} of {is_equal.size:,}"
                message = f"{count} output values differ from the source's, expected equal ones"
                raise ParityFailed(message, where=where)
