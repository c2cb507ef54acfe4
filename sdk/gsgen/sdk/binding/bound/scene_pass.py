"""Runs a generator in two passes: its scene pass when an input of the scene changes, then frames.

The passes are parts of one graph ("Passes" of the specification's manifest): operators whose result
depends on inputs of the scene and on none of the frame, and all others.
"""

__all__ = ["ScenePassSession", "SplitModel", "open_scene_pass", "split_model"]

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
import onnx_ir as ir
from onnx import ModelProto, NodeProto, TensorProto, ValueInfoProto

from gsgen.contract.model.graph import names_read
from gsgen.contract.spec.manifest import GeneratorManifest, Manifest
from gsgen.sdk.binding.bound.bound_session import BoundSession
from gsgen.sdk.binding.providers.buffers import Buffer, same_bits


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SplitModel:
    """The two passes of a generator's graph.

    Attributes:
        model: The whole model.
        scene: The nodes of the scene pass, and those of constants that it needs.
        frame: The nodes of the frame pass, and those of constants that it needs.
        passed: Names of the tensors that the frame pass reads from the scene pass.
        scene_outputs: Names of the model's outputs that the scene pass computes.
    """

    model: ModelProto
    scene: tuple[NodeProto, ...]
    frame: tuple[NodeProto, ...]
    passed: tuple[str, ...]
    scene_outputs: tuple[str, ...]

    def scene_model(self) -> ModelProto:
        """Return a model of the scene pass, whose outputs are the tensors that it passes on."""
        outputs = [ValueInfoProto(name=name) for name in self.passed]
        declared = {value.name: value for value in self.model.graph.output}
        outputs += [declared[name] for name in self.scene_outputs if name not in self.passed]
        return self._part(self.scene, (), outputs)

    def frame_model(self, passed: Mapping[str, Buffer]) -> ModelProto:
        """Return a model of the frame pass, with inputs for the tensors of the scene pass."""
        inputs = [_declared_input(name, passed[name]) for name in self.passed]
        outputs = [
            value for value in self.model.graph.output if value.name not in self.scene_outputs
        ]
        return self._part(self.frame, inputs, outputs)

    def _part(
        self,
        nodes: Iterable[NodeProto],
        inputs: Iterable[ValueInfoProto],
        outputs: Iterable[ValueInfoProto],
    ) -> ModelProto:
        part = ModelProto()
        part.ir_version = self.model.ir_version
        part.opset_import.extend(self.model.opset_import)
        part.functions.extend(self.model.functions)
        graph = part.graph
        graph.name = self.model.graph.name or "pass"
        graph.node.extend(nodes)
        graph.output.extend(outputs)
        read_names = {name for node in graph.node for name in names_read(node)}
        read_names |= {value.name for value in graph.output}
        graph.input.extend(value for value in self.model.graph.input if value.name in read_names)
        graph.input.extend(inputs)
        graph.initializer.extend(
            tensor for tensor in self.model.graph.initializer if tensor.name in read_names
        )
        graph.sparse_initializer.extend(
            tensor
            for tensor in self.model.graph.sparse_initializer
            if tensor.values.name in read_names
        )
        return part


def _declared_input(name: str, buffer: Buffer) -> ValueInfoProto:
    """Return the declaration of a graph input with the dtype and shape of a buffer."""
    value = ValueInfoProto(name=name)
    tensor_type = value.type.tensor_type
    tensor_type.elem_type = int(ir.DataType.from_numpy(buffer.dtype))
    for size in buffer.shape:
        tensor_type.shape.dim.add().dim_value = size
    return value


def split_model(model: ModelProto, manifest: Manifest | None) -> SplitModel | None:
    """Return the two passes of a model; None if it has one pass, or weights in other files."""
    if not isinstance(manifest, GeneratorManifest):
        return None
    graph = model.graph
    if any(tensor.data_location == TensorProto.EXTERNAL for tensor in graph.initializer):
        return None
    scene_names = {entry.name for entry in manifest.inputs if entry.is_of_scene}
    weights = {tensor.name for tensor in graph.initializer}
    frame_names = {value.name for value in graph.input} - scene_names - weights
    scene_nodes: list[NodeProto] = []
    frame_nodes: list[NodeProto] = []
    constant_nodes: list[NodeProto] = []
    outputs = [value.name for value in graph.output]
    for node in _needed(list(graph.node), set(outputs)):
        names = names_read(node)
        if any(name in frame_names for name in names):
            frame_names.update(node.output)
            frame_nodes.append(node)
        elif any(name in scene_names for name in names):
            scene_names.update(node.output)
            scene_nodes.append(node)
        else:
            constant_nodes.append(node)
    if not scene_nodes or not frame_nodes:
        return None
    computed = {name for node in scene_nodes for name in node.output if name}
    frame_reads = {name for node in frame_nodes for name in names_read(node)}
    # A constant output belongs to the frame pass, whose nodes then compute it.
    frame_needs = frame_reads | {name for name in outputs if name not in computed}
    scene_reads = {name for node in scene_nodes for name in names_read(node)}
    return SplitModel(
        model=model,
        scene=(*_needed(constant_nodes, scene_reads), *scene_nodes),
        frame=(*_needed(constant_nodes, frame_needs), *frame_nodes),
        passed=tuple(name for node in scene_nodes for name in node.output if name in frame_reads),
        scene_outputs=tuple(name for name in outputs if name in computed),
    )


def _needed(nodes: list[NodeProto], names: set[str]) -> list[NodeProto]:
    """Return the nodes, in order, whose results are named, or needed by others of them."""
    needed_names, needed_nodes = set(names), []
    for node in reversed(nodes):
        if needed_names.intersection(node.output):
            needed_names.update(names_read(node))
            needed_nodes.append(node)
    return needed_nodes[::-1]


@final
class ScenePassSession:
    """Two bound sessions of one generator, with the interface of one.

    The scene pass runs if a value of its inputs differs from that of its last run, by content.

    Attributes:
        inputs: Name → buffer, of both passes.
        outputs: Name → buffer, of both passes.
        scene: The session of the scene pass.
        frame: The session of the frame pass.
        scene_runs: How often the scene pass has run.
    """

    def __init__(self, scene: BoundSession, frame: BoundSession, split: SplitModel) -> None:
        self.scene, self.frame, self._passed = scene, frame, split.passed
        frame_inputs = {
            name: buffer for name, buffer in frame.inputs.items() if name not in split.passed
        }
        self.inputs = {**scene.inputs, **frame_inputs}
        self.outputs = {name: scene.outputs[name] for name in split.scene_outputs} | frame.outputs
        self._last_inputs: dict[str, np.ndarray] = {}
        self.scene_runs = 0

    def write(self, tensors: Mapping[str, np.ndarray]) -> frozenset[str]:
        """Copy tensors into the input buffers; return the names of changed model inputs."""
        return frozenset(
            [name for name, array in tensors.items() if self.inputs[name].write(array)]
        )

    def run(self) -> None:
        """Compute a frame; the scene pass first, if one of its inputs changed."""
        self._run(self.frame.run)

    def run_uncaptured(self) -> None:
        """Compute a frame without graph capture."""
        self._run(self.frame.run_uncaptured)

    def _run(self, run_frame: Callable[[], None]) -> None:
        inputs = self.scene.inputs.items()
        is_unchanged = self._last_inputs and all(
            same_bits(self._last_inputs[name], buffer.host) for name, buffer in inputs
        )
        if not is_unchanged:
            self._last_inputs = {}  # a run that fails leaves no results
            self.scene.run_uncaptured()
            for name in self._passed:
                self.frame.inputs[name].write(self.scene.read(name))
            self._last_inputs = {name: buffer.host.copy() for name, buffer in inputs}
            self.scene_runs += 1
        run_frame()

    def read(self, name: str) -> np.ndarray:
        """Return a model output as a read-only array."""
        return (self.frame if name in self.frame.outputs else self.scene).read(name)

    def copies(self) -> dict[str, np.ndarray]:
        """Return copies of all model outputs, by output name."""
        return {name: self.read(name).copy() for name in self.outputs}

    def close(self) -> None:
        """Release both sessions."""
        self.frame.close()
        self.scene.close()
        self.inputs, self.outputs = {}, {}


def open_scene_pass(split: SplitModel, bind: Callable[[bytes], BoundSession]) -> ScenePassSession:
    """Open the sessions of both passes.

    Args:
        split: The passes.
        bind: Opens a session of a serialised model, and binds its buffers.
    """
    scene = bind(split.scene_model().SerializeToString())
    frame = bind(split.frame_model(scene.outputs).SerializeToString())
    return ScenePassSession(scene, frame, split)
