"""A graphics device that records what the renderer creates on it, and computes nothing."""

__all__ = [
    "RecordedBind",
    "RecordedBuffer",
    "RecordedModule",
    "RecordedPipeline",
    "RecordingDevice",
]

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, final

import numpy as np

from web_client.formulas import UNLIMITED

_KINDS = {"uniform": "u", "read-only-storage": "r", "storage": "w"}


@final
@dataclass(slots=True, eq=False, weakref_slot=True)
class RecordedBuffer:
    """A recorded GPU buffer: label, size (possibly a formula), usage and initial bytes."""

    label: str
    size: int
    usage: int
    data: dict[int, bytes] = field(default_factory=dict)


@final
@dataclass(frozen=True, slots=True)
class RecordedModule:
    """The label and the WGSL text of a shader module."""

    label: str
    code: str


@final
@dataclass(frozen=True, slots=True)
class RecordedPipeline:
    """A recorded compute pipeline; letters (u, r, w) are the types of its bindings."""

    label: str
    module: RecordedModule
    entry: str
    groups: tuple[str, ...]


@final
@dataclass(frozen=True, slots=True, eq=False)
class RecordedBind:
    """A recorded bind group: a type letter, a buffer, an offset and a size per binding."""

    kinds: str
    entries: tuple[tuple[RecordedBuffer, int, int], ...]


@final
class RecordingDevice:
    """Stands in for a ``wgpu.GPUDevice``, and records the objects that the renderer creates.

    It has no limits, no optional features, and is not a software driver: browsers get the kernels of
    GPUs, which every driver runs.
    """

    def __init__(self) -> None:
        self.features = frozenset[str]()
        self.limits = dict.fromkeys(
            ("max-buffer-size", "max-storage-buffer-binding-size", "max-texture-dimension-2d"),
            UNLIMITED,
        )
        self.adapter = SimpleNamespace(info={"device": "a recording", "adapter_type": "Unknown"})
        self.queue = self

    def create_buffer(self, *, label: str, size: int, usage: str) -> RecordedBuffer:
        """Record a GPU buffer; ``usage`` holds the names of wgpu's flags, separated by ``|``."""
        import wgpu

        flags = sum(getattr(wgpu.BufferUsage, name) for name in usage.split("|"))
        return RecordedBuffer(label, size, flags)

    def write_buffer(self, buffer: RecordedBuffer, offset: int, data: np.ndarray) -> None:
        """Record bytes that are written to a GPU buffer."""
        buffer.data[int(offset)] = data.tobytes()

    def create_shader_module(self, *, label: str, code: str) -> RecordedModule:
        """Record a shader module: its label and WGSL code."""
        return RecordedModule(label, code)

    def create_bind_group_layout(self, *, label: str, entries: Sequence[Mapping[str, Any]]) -> str:
        """Return the type of each binding as a letter: u (uniform), r (read-only), w (writable)."""
        return "".join(_KINDS[entry["buffer"]["type"]] for entry in entries)

    def create_pipeline_layout(
        self, *, label: str, bind_group_layouts: Sequence[str]
    ) -> tuple[str, ...]:
        """Return the binding types of each bind group of a pipeline, as letters."""
        return tuple(bind_group_layouts)

    def create_compute_pipeline(
        self, *, label: str, layout: tuple[str, ...], compute: Mapping[str, Any]
    ) -> RecordedPipeline:
        """Record a compute pipeline: its shader module, entry point and binding types."""
        return RecordedPipeline(label, compute["module"], compute["entry_point"], layout)

    def create_bind_group(
        self, *, label: str, layout: str, entries: Sequence[Mapping[str, Any]]
    ) -> RecordedBind:
        """Record a bind group: its buffers, offsets and sizes."""
        resources = [entry["resource"] for entry in entries]
        return RecordedBind(
            layout,
            tuple(
                (resource["buffer"], resource["offset"], resource["size"]) for resource in resources
            ),
        )
