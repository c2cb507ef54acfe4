"""Export a post-process model: trace it, finish the graph, compare it with torch, validate it.

The file appears at its place only if all of that succeeded.
"""

__all__ = ["ExportedImage", "export_post_process"]

import copy
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.contract.errors import GsgenError
from gsgen.contract.probing.probes import Probe, default_probes
from gsgen.contract.spec.manifest import (
    ImageOutput,
    Input,
    PostProcessManifest,
    PostProcessOutputs,
    Producer,
)
from gsgen.contract.spec.roles import POST_PROCESS, ROLES
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.settings import Settings
from gsgen.sdk.authoring.module_checks import validate_module
from gsgen.sdk.authoring.post_process import PostProcess
from gsgen.sdk.errors import GeneratorInvalid, ParityFailed
from gsgen.sdk.exporting.embed_manifest import finish
from gsgen.sdk.exporting.source_lines import line_of
from gsgen.sdk.exporting.tracing import Named, trace_module
from gsgen.sdk.exporting.verification import check_contract, run_exported
from gsgen.sdk.float16.convert_image_model import HalvedImage, halve_image
from gsgen.sdk.parity import FieldParity, Parity
from gsgen.sdk.rewriting.atomic_model_files import atomic_write
from gsgen.sdk.rewriting.model_io import save_model
from gsgen.sdk.rewriting.rewrite import Change

OUTPUT = "result"
_PROBES = 4
_HALF_PROBES = 3
_CHANNELS = (3, 4)
# Sizes at which a model of open size is traced, and at which it is compared.
_TRACED, _OTHER = (64, 64), (48, 80)


def _silent(_: str) -> None:
    return


@dataclass(frozen=True, slots=True)
class ExportedImage:
    """A finished export.

    Attributes:
        path: The file.
        manifest: What was embedded.
        parity: How closely it agrees with eager torch, in shares of the output's range.
        report: What the validator says; it conforms.
        changes: What the rewrites did to the graph.
        halved: What became float16, where images did.
    """

    path: Path
    manifest: PostProcessManifest
    parity: Parity
    report: Report
    changes: tuple[Change, ...] = ()
    halved: HalvedImage | None = None

    @property
    def contents(self) -> str:
        """What the model gives, in a few words."""
        shape = _image(self.manifest.inputs).shape
        size = "any size" if shape is None else f"{shape[2]} × {shape[3]} (height × width)"
        return f"an image of {size}, {self.manifest.outputs.image.dtype}"


def export_post_process(
    model: PostProcess,
    path: str | os.PathLike[str],
    *,
    name: str | None = None,
    dtype: Literal["float32", "float16"] = "float32",
    opset: int = 18,
    target: str = "core",
    rewrite: bool = True,
    settings: Settings | None = None,
    progress: Callable[[str], None] = _silent,
) -> ExportedImage:
    """Write ``model`` as an ONNX post-process model that conforms and agrees with torch.

    Args:
        model: The module; it is put into evaluation mode and moved to the CPU.
        path: Where the model goes; it is replaced only by a model that passed every check.
        name: What people call it; the file's stem where absent.
        dtype: Of the images that come in and go out; float16 halves weights, too, and what of the
            arithmetic does not show (:mod:`gsgen.sdk.float16.convert_image_model`).
        opset: ONNX operator set, 18 being the one that every runtime has kernels for.
        target: The consumer to rewrite and validate for.
        rewrite: Rewrite the graph so that it is captured; without, it stays as torch wrote it.
        settings: Limits and severities of that validation.
        progress: Called with a few words whenever a new stage begins.

    Raises:
        GeneratorInvalid: The module declares or returns something the contract does not know.
        ExportFailed: Torch could not export it.
        ParityFailed: The model computes something else than the module.
        ExportRejected: The model breaks a rule; the error carries the report.
    """
    path = Path(path)
    validate_module(model)
    model = model.eval().cpu()
    _check_inputs(model)
    manifest = _manifest(model, name or path.stem, dtype)
    sizes = (_TRACED, _OTHER) if _image(model.inputs).shape is None else (_TRACED,)
    shapes = [(1, model.channels, *size) for size in sizes]
    probes = [probe for shape in shapes for probe in _probes(manifest, dtype, shape)]
    progress("running the module in eager torch")
    wanted = [_run_eager(model, probe) for probe in probes]
    progress("tracing the graph")
    # Halving is left to the rewrite, which measures what has to stay float32.
    halves = dtype == "float16" and rewrite
    plain = not halves and dtype == "float16"
    module = _Positional(copy.deepcopy(model).half() if plain else model)
    named = Named(tuple(probes[1].inputs), (OUTPUT,), _open_axes(model.inputs))
    example = _widened(probes[1]) if halves else probes[1]
    graph = trace_module(module, example, named, opset, where=type(model).__name__)
    progress("rewriting the graph")
    changes = finish(graph, manifest, load_target(target), rewrite=rewrite)
    allowed = model.half_tolerance if dtype == "float16" else model.tolerance
    halved = None
    if halves:
        name = _image(model.inputs).name
        sound = [
            probe
            for probe, image in zip(probes, wanted, strict=True)
            if np.isfinite(image).all()
        ]
        halved = halve_image(graph, name, sound[:_HALF_PROBES], allowed, progress)
    with atomic_write(path) as draft:
        save_model(graph, draft)
        progress(f"comparing with eager torch at {len(probes)} probes")
        parity = _check_parity(draft, manifest, probes, wanted, allowed)
        report = check_contract(draft, path, target, settings, progress)
    return ExportedImage(path, manifest, parity, report, tuple(changes), halved)


def _widened(probe: Probe) -> Probe:
    """Return a probe whose image is float32."""
    inputs = {
        name: value.astype(np.float32) if value.dtype == np.float16 else value
        for name, value in probe.inputs.items()
    }
    return replace(probe, inputs=inputs)


class _Positional(nn.Module):
    """A model whose arguments have no names, whatever its author calls them."""

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Tensor:
        made: Tensor = self.model(*inputs)
        return made


def _image(inputs: Any) -> Input:
    """Return the entry of the image."""
    found: Input = next(entry for entry in inputs if entry.role == "image")
    return found


def _check_inputs(model: PostProcess) -> None:
    where = f"{type(model).__name__}.inputs"
    names = [entry.name for entry in model.inputs]
    images = [entry.name for entry in model.inputs if entry.role == "image"]
    if len(images) != 1:
        hint = "Give one gsgen.sdk.authoring.inputs.image()."
        raise GeneratorInvalid(f"{len(images)} images, wanted one", where=where, hint=hint)
    image = _image(model.inputs)
    if image.range is not None and image.range != model.image_range:
        what = f"{image.name!r} has the range {image.range}, but image_range is {model.image_range}"
        hint = "Give inputs.image() the same range."
        raise GeneratorInvalid(what, where=where, hint=hint)
    for entry in model.inputs:
        if names.count(entry.name) > 1 or entry.name == OUTPUT:
            what = f"{entry.name!r} stands twice, or is the name of the result"
            raise GeneratorInvalid(
                what, where=where, hint="Give each input a name of its own."
            )
        if POST_PROCESS not in ROLES[entry.role].kinds:
            what = f"{entry.name!r} has the role {entry.role}, which a post-process model has not"
            raise GeneratorInvalid(what, where=where)
        if entry.shape is None and entry.role != "image":
            hint = "Make inputs with the functions of gsgen.sdk.authoring.inputs."
            raise GeneratorInvalid(f"{entry.name!r} has no shape", where=where, hint=hint)


def _manifest(model: PostProcess, name: str, dtype: Any) -> PostProcessManifest:
    image = ImageOutput(OUTPUT, dtype, model.output_range, model.color_space)
    return PostProcessManifest(
        name=name,
        family=model.family,
        producer=model.producer or Producer(f"gsgen {version('gsgen')}"),
        inputs=tuple(model.inputs),
        outputs=PostProcessOutputs(image),
        image_range=model.image_range,
    )


def _probes(
    manifest: PostProcessManifest, dtype: str, open_shape: tuple[int, ...]
) -> tuple[Probe, ...]:
    shapes = {entry.name: entry.shape or open_shape for entry in manifest.inputs}
    dtypes = {
        entry.name: dtype if entry.role == "image" else "float32"
        for entry in manifest.inputs
    }
    return default_probes(manifest, shapes, dtypes, count=_PROBES)


def _open_axes(inputs: Any) -> tuple[dict[int, Any], ...] | None:
    if _image(inputs).shape is not None:
        return None
    auto = torch.export.Dim.AUTO
    sizes = {2: auto, 3: auto}
    return tuple(sizes if entry.role == "image" else {} for entry in inputs)


def _run_eager(model: PostProcess, probe: Probe) -> Float[np.ndarray, "1 c h w"]:
    """Run the module in float32, whatever it will be exported as."""
    tensors = [torch.from_numpy(np.array(value)).float() for value in probe.inputs.values()]
    try:
        with torch.no_grad():
            made = model(*tensors)
    except GsgenError:
        raise
    except Exception as error:  # the user's code may raise anything
        what = f"forward raised {type(error).__name__}: {error}"
        where = line_of(error) or type(model).__name__
        raise GeneratorInvalid(what, where=where) from error
    height, width = probe.inputs[_image(model.inputs).name].shape[2:]
    fits = isinstance(made, torch.Tensor) and made.ndim == 4
    if not fits or made.shape[1] not in _CHANNELS or made.shape[2:] != (height, width):
        seen = list(made.shape) if isinstance(made, torch.Tensor) else type(made).__name__
        what = f"forward returned {seen}, wanted [1, 3 or 4, {height}, {width}]"
        raise GeneratorInvalid(what, where=type(model).__name__)
    return np.asarray(made.to(torch.float64).numpy())


def _check_parity(
    path: Path,
    manifest: PostProcessManifest,
    probes: list[Probe],
    wanted: list[np.ndarray],
    allowed: float,
) -> Parity:
    low, high = manifest.outputs.image.range
    made = [one[OUTPUT] for one in run_exported(path, (OUTPUT,), probes)]
    compared = list(_compared(made, wanted, probes, abs(high - low), allowed))
    worst = max(compared, key=lambda one: one.excess)
    parity = Parity((worst,), len(probes))
    if not parity.holds:
        what = (
            f"the image is off by {worst.error:.3g} of its range at probe {worst.probe!r}, "
            f"{worst.excess:.3g} times what is allowed"
        )
        raise ParityFailed(what, where=path.name, parity=parity)
    return parity


def _compared(
    made: list[np.ndarray],
    wanted: list[np.ndarray],
    probes: list[Probe],
    span: float,
    allowed: float,
) -> Iterator[FieldParity]:
    for seen, expected, probe in zip(made, wanted, probes, strict=True):
        if probe.zeros and not np.isfinite(expected).all():
            continue  # a fault of the module itself, which rule GI009 reports
        error = np.abs(seen.astype(np.float64) - expected) / span
        error[np.isnan(error)] = np.inf
        at, largest = int(np.argmax(error)), float(error.max())
        yield FieldParity("image", largest, largest / allowed, probe.label, at)
