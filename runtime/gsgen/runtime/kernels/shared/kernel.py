"""A kernel: one entry point of a shader, with the layout of what it binds."""

__all__ = ["Kernel", "Step", "run"]

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.shader import source

_TYPES: Final = {"u": "uniform", "r": "read-only-storage", "w": "storage"}


@final
class Kernel:
    """A compute pipeline.

    Args:
        device: Where it runs.
        name: Of the shader file.
        entry: Of its entry point.
        groups: For each bind group a letter per binding: u uniform, r read-only storage,
            w storage.
        constants: What the shader is compiled with.
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
        self._raw = raw
        self.label = entry
        module = raw.create_shader_module(label=name, code=source(name, **constants))
        self.layouts = [_layout(raw, entry, kinds) for kinds in groups]
        self.pipeline = raw.create_compute_pipeline(
            label=entry,
            layout=raw.create_pipeline_layout(label=entry, bind_group_layouts=self.layouts),
            compute={"module": module, "entry_point": entry},
        )

    def bind(self, *resources: Any, group: int = 0) -> Any:
        """Return a bind group; a resource is a buffer, or (buffer, offset, size)."""
        entries = [
            {"binding": place, "resource": _resource(one)}
            for place, one in enumerate(resources)
        ]
        return self._raw.create_bind_group(
            label=self.label, layout=self.layouts[group], entries=entries
        )


def _layout(raw: Any, label: str, kinds: str) -> Any:
    entries = [
        {"binding": place, "visibility": "COMPUTE", "buffer": {"type": _TYPES[kind]}}
        for place, kind in enumerate(kinds)
    ]
    return raw.create_bind_group_layout(label=label, entries=entries)


def _resource(one: Any) -> dict[str, Any]:
    buffer, offset, size = one if isinstance(one, tuple) else (one, 0, one.size)
    return {"buffer": buffer, "offset": offset, "size": size}


@final
@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One dispatch of a frame, recorded once and encoded every frame.

    Attributes:
        kernel: What runs.
        binds: Its bind groups.
        groups: Workgroups in x, y and z, or the buffer and the offset they are read from.
    """

    kernel: Kernel
    binds: tuple[Any, ...]
    groups: tuple[int, int, int] | tuple[Any, int]


def run(
    encoder: Any, steps: Iterable[Step], label: str, stamps: dict[str, Any] | None = None
) -> None:
    """Encode ``steps`` as one compute pass, which may write timestamps."""
    compute = encoder.begin_compute_pass(label=label, timestamp_writes=stamps)
    last: Kernel | None = None
    for step in steps:
        if step.kernel is not last:
            compute.set_pipeline(step.kernel.pipeline)
            last = step.kernel
        for place, bind in enumerate(step.binds):
            compute.set_bind_group(place, bind)
        if len(step.groups) == 2:
            compute.dispatch_workgroups_indirect(*step.groups)
        elif min(step.groups) > 0:
            compute.dispatch_workgroups(*step.groups)
    compute.end()
