"""Executes a frame plan of plans.json on a wgpu device, and knows no stage, kernel or buffer."""

import base64
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.splat_residency import Page
from web_client.formulas import evaluate
from web_client.recording import page_kind

TYPES = {"u": "uniform", "r": "read-only-storage", "w": "storage"}


def choose(document: dict[str, Any], sizes: dict[str, int], **shape: object) -> dict[str, Any]:
    """Return the first plan of a shape whose guards hold, as the client does."""
    return next(
        plan
        for plan in document["plans"]
        if all(plan[name] == value for name, value in shape.items())
        and all(evaluate(guard, sizes) for guard in plan["guards"])
    )


class PlanExecutor:
    """The GPU objects of one plan for pages whose buffers exist.

    Args:
        device: Device of the pages.
        document: The parsed plans.json.
        plan: One of its plans.
        sizes: Sizes of the image, and the capacity for pairs.
        pages: The pages, in the scene's order.
    """

    def __init__(self, device: Device, document: dict[str, Any], plan: dict[str, Any],
                 sizes: dict[str, int], pages: Sequence[Page]) -> None:  # fmt: skip
        self.device, self.document, self.plan, self.pages = device, document, plan, pages
        gaussians = sum(page.capacity for page in pages)
        self.sizes = sizes | {"gaussians": gaussians, "pages": len(pages)}
        self.layout, self.pipeline = cache(self._layout), cache(self._pipeline)
        self.buffers = {row: self._buffer(document["buffers"][row]) for row in plan["buffers"]}
        self.commands = [
            command
            for entries in plan["stages"].values()
            for entry in entries
            for command in self._commands(entry)
        ]
        self.clears = [(self.buffers[row], *remaining) for row, *remaining in plan["clears"]]
        self.clears += [
            (getattr(page.slots, name), *remaining)
            for page in pages
            if page.slots is not None
            for name, *remaining in plan["pool_clears"]
        ]

    def _buffer(self, entry: dict[str, Any]) -> Any:
        raw = self.device.raw
        size = evaluate(entry["size"], self.sizes)
        buffer = raw.create_buffer(label=entry["label"], size=size, usage=entry["usage"])
        if "data" in entry:
            words = np.frombuffer(base64.b64decode(entry["data"]), np.uint32).copy()
            for offset, name in entry.get("sizes", ()):
                words[offset // 4] = self.sizes[name]
            raw.queue.write_buffer(buffer, 0, words)
        return buffer

    def _layout(self, kinds: str) -> Any:
        entries = [
            {"binding": index, "visibility": "COMPUTE", "buffer": {"type": TYPES[kind]}}
            for index, kind in enumerate(kinds)
        ]
        return self.device.raw.create_bind_group_layout(entries=entries)

    def _pipeline(self, row: int) -> Any:
        raw, entry = self.device.raw, self.document["pipelines"][row]
        module = self.document["modules"][entry["module"]]
        code = module["constants"] + self.document["texts"][module["text"]]
        layouts = [self.layout(kinds) for kinds in entry["groups"]]
        return raw.create_compute_pipeline(
            layout=raw.create_pipeline_layout(bind_group_layouts=layouts),
            compute={"module": raw.create_shader_module(code=code), "entry_point": entry["entry"]},
        )

    def _commands(self, entry: int | dict[str, Any]) -> list[Any]:
        """Return pipeline, bind groups and workgroups of a step, or of those of every page."""
        if isinstance(entry, int):
            return [self._command(entry, None, 0)]
        return [
            self._command(row, page, slot)
            for slot, page in enumerate(self.pages)
            for row in np.atleast_1d(entry[page_kind(page)]).tolist()
        ]

    def _command(self, row: int, page: Page | None, slot: int) -> Any:
        step, sizes = self.document["steps"][row], self.sizes | {"slot": slot}
        if page is not None:
            sizes |= {"capacity": page.capacity, "slots": page.slots.count if page.slots else 0}
        groups = [self._bind_group(bind, page, sizes) for bind in step["binds"]]
        if "indirect" in step:
            buffer, offset = step["indirect"]
            return self.pipeline(step["pipeline"]), groups, (self.resolved(buffer, page), offset)
        counts = tuple(evaluate(count, sizes) for count in step["groups"])
        return self.pipeline(step["pipeline"]), groups, counts

    def _bind_group(self, row: int, page: Page | None, sizes: dict[str, int]) -> Any:
        bind = self.document["binds"][row]
        entries = []
        for index, (name, offset, size) in enumerate(bind["entries"]):
            buffer = self.resolved(name, page)
            size = buffer.size if size is None else evaluate(size, sizes)
            resource = {"buffer": buffer, "offset": evaluate(offset, sizes), "size": size}
            entries.append({"binding": index, "resource": resource})
        return self.device.raw.create_bind_group(layout=self.layout(bind["kinds"]), entries=entries)

    def resolved(self, name: int | str, page: Page | None) -> Any:
        """Return a buffer of the plan by its row, or of a page by its name."""
        if isinstance(name, int):
            return self.buffers[name]
        return getattr(page if hasattr(page, name) else page.slots, name)

    def input(self, name: str) -> Any:
        """Return the buffer of a uniform that the host writes."""
        return self.buffers[self.plan["inputs"][name]]

    def run(self) -> dict[str, np.ndarray]:
        """Encode a frame, and return its images as 32-bit words."""
        raw = self.device.raw
        encoder = raw.create_command_encoder()
        for buffer, offset, size in self.clears:
            encoder.clear_buffer(buffer, offset, size)
        compute = encoder.begin_compute_pass()
        for pipeline, binds, groups in self.commands:
            compute.set_pipeline(pipeline)
            for index, bind in enumerate(binds):
                compute.set_bind_group(index, bind)
            if len(groups) == 2:
                compute.dispatch_workgroups_indirect(*groups)
            elif min(groups) > 0:
                compute.dispatch_workgroups(*groups)
        compute.end()
        raw.queue.submit([encoder.finish()])
        return {
            name: np.frombuffer(raw.queue.read_buffer(self.buffers[row]), np.uint32)
            for name, row in self.plan["images"].items()
        }
