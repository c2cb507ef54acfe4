"""Compute kernels: WGSL entry points with their bind groups and dispatches."""

__all__ = ["THREADS_PER_WORKGROUP", "VEC4", "Dispatch", "Kernel", "Step", "run"]

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias, final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import (
    BindGroup,
    BindGroupLayout,
    Buffer,
    Encoder,
    PassTimestamps,
    RawDevice,
    Resource,
)
from gsgen.runtime.gpu.native import create_shader_module
from gsgen.runtime.kernels.shared.shader import source

Dispatch: TypeAlias = tuple[int, int, int] | tuple[Buffer, int]
"""Workgroup counts in x, y and z, or a buffer with an offset that holds them."""

THREADS_PER_WORKGROUP: Final = 64
"""Workgroup size of kernels with one invocation per row."""

VEC4: Final = 16
"""Bytes of four 32-bit words, as in a pixel of every image."""

_BINDING_TYPES: Final = {"u": "uniform", "r": "read-only-storage", "w": "storage"}


@final
class Kernel:
    """A compute pipeline of one shader entry point, with its bind group layouts.

    Kernels of a device with the same text, entry point and bindings share one pipeline: a second
    renderer compiles none of them.

    Args:
        device: Device of the pipeline.
        name: Name of the shader file.
        entry: Name of its entry point.
        groups: For each bind group one letter per binding: u uniform, r read-only storage,
            w storage.
        constants: Constants of the shader.
    """

    def __init__(
        self,
        device: Device,
        name: str,
        entry: str,
        groups: Sequence[str],
        **constants: int | float | bool,
    ) -> None:
        raw = device.raw
        self._device = device
        self.label = entry
        text = source(name, wide_words=device.has_int64, **constants)
        key = text, entry, tuple(groups)
        if key not in device.pipelines:
            layouts = [_layout(raw, entry, kinds) for kinds in groups]
            pipeline = raw.create_compute_pipeline(
                label=entry,
                layout=raw.create_pipeline_layout(label=entry, bind_group_layouts=layouts),
                compute={"module": create_shader_module(raw, name, text), "entry_point": entry},
            )
            device.pipelines[key] = pipeline, layouts
        self.pipeline, self.layouts = device.pipelines[key]

    def bind(self, *resources: Resource, group: int = 0) -> BindGroup:
        """Return a bind group of buffers, or of (buffer, offset, size), for the kernel."""
        entries = [
            {"binding": binding, "resource": _binding_resource(resource)}
            for binding, resource in enumerate(resources)
        ]
        return self._device.raw.create_bind_group(
            label=self.label, layout=self.layouts[group], entries=entries
        )


def _layout(raw: RawDevice, label: str, kinds: str) -> BindGroupLayout:
    entries = [
        {"binding": binding, "visibility": "COMPUTE", "buffer": {"type": _BINDING_TYPES[kind]}}
        for binding, kind in enumerate(kinds)
    ]
    return raw.create_bind_group_layout(label=label, entries=entries)


def _binding_resource(resource: Resource) -> dict[str, object]:
    buffer, offset, size = resource if isinstance(resource, tuple) else (resource, 0, resource.size)
    return {"buffer": buffer, "offset": offset, "size": size}


@final
@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One kernel dispatch of a frame, recorded once and encoded every frame."""

    kernel: Kernel
    bind_groups: tuple[BindGroup, ...]
    groups: Dispatch


def run(
    encoder: Encoder,
    steps: Iterable[Step],
    label: str,
    pass_timestamps: PassTimestamps | None = None,
) -> None:
    """Encode kernel dispatches as one compute pass, which may write timestamps."""
    compute = encoder.begin_compute_pass(label=label, timestamp_writes=pass_timestamps)
    last: Kernel | None = None
    for step in steps:
        if step.kernel is not last:
            compute.set_pipeline(step.kernel.pipeline)
            last = step.kernel
        for group, bind in enumerate(step.bind_groups):
            compute.set_bind_group(group, bind)
        if len(step.groups) == 2:
            compute.dispatch_workgroups_indirect(*step.groups)
        elif min(step.groups) > 0:
            compute.dispatch_workgroups(*step.groups)
    compute.end()
