"""Render pipelines of the rasterisation hardware, which renderers of a device share."""

__all__ = ["render_pipeline"]

from collections.abc import Sequence
from typing import Any

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.handles import BindGroupLayout, RenderPipeline


def render_pipeline(
    device: Device,
    label: str,
    code: str,
    kinds: Sequence[dict[str, Any]],
    *,
    fragment: str = "color_at",
    topology: str = "triangle-list",
    targets: Sequence[dict[str, Any]],
    depth_stencil: dict[str, Any] | None = None,
) -> tuple[RenderPipeline, BindGroupLayout]:
    """Return the render pipeline of a shader, and the layout of its bind group.

    Equal pipelines of a device are one: a second renderer compiles none.

    Args:
        device: Device of the pipeline.
        label: What tools call it.
        code: WGSL text; its vertices' entry point is ``corner_of``.
        kinds: The bindings of its one bind group, in order, as in WebGPU's layout entries.
        fragment: Entry point of its fragments.
        topology: What the vertices make up, as in WebGPU.
        targets: Formats and blending of the colour targets, as in WebGPU.
        depth_stencil: The depth test, as in WebGPU; None without one.
    """
    key = code, repr((kinds, fragment, topology, targets, depth_stencil))
    if key not in device.render_pipelines:
        raw = device.raw
        entries = [
            {"binding": binding, "visibility": "VERTEX|FRAGMENT", **kind}
            for binding, kind in enumerate(kinds)
        ]
        layout = raw.create_bind_group_layout(label=label, entries=entries)
        module = raw.create_shader_module(label=label, code=code)
        pipeline = raw.create_render_pipeline(
            label=label,
            layout=raw.create_pipeline_layout(bind_group_layouts=[layout]),
            vertex={"module": module, "entry_point": "corner_of", "buffers": []},
            primitive={"topology": topology, "cull_mode": "none"},
            depth_stencil=depth_stencil,
            fragment={"module": module, "entry_point": fragment, "targets": list(targets)},
        )
        device.render_pipelines[key] = pipeline, layout
    return device.render_pipelines[key]
