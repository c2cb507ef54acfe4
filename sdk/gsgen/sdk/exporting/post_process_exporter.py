"""Exports a post-process model to ONNX: runs it in torch, traces, rewrites and verifies it."""

__all__ = ["export_post_process"]

import copy
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import onnx_ir as ir
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gsgen.contract.probing.probes import Probe
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.spec.fields.roles import IMAGE_CHANNELS, POST_PROCESS, ROLES
from gsgen.contract.spec.manifest import (
    ImageOutput,
    Input,
    PostProcessManifest,
    PostProcessOutputs,
    Producer,
)
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.agreement import FieldError
from gsgen.contract.validation.settings import Settings
from gsgen.sdk.authoring.module_checks import validate_module
from gsgen.sdk.authoring.on_cpu import on_cpu
from gsgen.sdk.authoring.post_process import PostProcess
from gsgen.sdk.errors import GeneratorInvalid, ParityFailed
from gsgen.sdk.exporting.eager_reference import call_module
from gsgen.sdk.exporting.embed_manifest import rewrite_and_embed
from gsgen.sdk.exporting.pipeline import (
    OPSET,
    Dtype,
    Exported,
    ExportOptions,
    Progress,
    StageClock,
    check_contract,
    no_progress,
    probes_of,
)
from gsgen.sdk.exporting.tracing.trace import TensorNames, trace_module
from gsgen.sdk.exporting.verification import run_exported
from gsgen.sdk.float16.convert_image_model import image_to_float16
from gsgen.sdk.parity import Parity
from gsgen.sdk.rewriting.model_io import save_model

OUTPUT_NAME = "result"
# Sets of inputs for each image size that is compared, and for the search for float16 nodes.
_RUNS_PER_SIZE = 4
_FLOAT16_ERROR_PROBE_COUNT = 3
# Height and width: models of any size are traced at the first, and compared at both.
_TRACED_IMAGE_SIZE, _SECOND_IMAGE_SIZE = (64, 64), (48, 80)


@on_cpu()
def export_post_process(
    model: PostProcess,
    path: str | os.PathLike[str],
    *,
    name: str | None = None,
    dtype: Dtype = "float32",
    opset: int = OPSET,
    target: str = "core",
    rewrite: bool = True,
    skip: Sequence[str] = (),
    settings: Settings | None = None,
    progress: Progress = no_progress,
) -> Exported:
    """Export a post-process model as an ONNX file that conforms and agrees with torch.

    Args:
        model: The module; it is put into evaluation mode and moved to the CPU.
        path: The model file; it is replaced only by a model that passed every check.
        name: Name in the manifest; the file's stem if absent.
        dtype: The dtype of the input and output images. float16 converts weights and arithmetic,
            too, if the error is below the tolerance
            (:mod:`gsgen.sdk.float16.convert_image_model`).
        opset: ONNX operator set; every runtime has kernels for 18.
        target: The consumer to rewrite and validate for.
        rewrite: Whether to rewrite the graph so that it is captured; if False, it stays as torch
            exported it.
        skip: Names of passes to leave out of the rewriting; ``gsgen rewrite --list`` has them.
        settings: Level, limits and severities of the validation.
        progress: Called with a message when a step begins.

    Raises:
        GeneratorInvalid: The module declares or returns something that the contract does not allow.
        ExportFailed: Torch could not export it.
        ParityFailed: The model computes something else than the module.
        ExportRejected: The model breaks a rule; the error carries the report.
    """
    path = Path(path)
    options = ExportOptions(
        path=path,
        name=name or path.stem,
        opset=opset,
        target=target,
        settings=settings,
        progress=progress,
        rewrite=rewrite,
        skip=skip,
    )
    clock = StageClock.of(progress)
    validate_module(model, PostProcess)
    model = model.eval().cpu()
    # Step 1: eager reference.
    _check_inputs(model)
    manifest = _manifest(model, options.name, dtype)
    probes = list(_probes_of_sizes(model, manifest, dtype))
    clock.begin("running the module in eager torch")
    expected = [_run_eager_model(model, probe) for probe in probes]
    # Step 2: tracing, in float32 if a search decides which nodes become float16.
    clock.begin("tracing the graph")
    half = dtype == "float16"
    graph = _trace(model, probes[1], opset, half=half and not rewrite)
    # Steps 3 and 4: rewriting and manifest.
    clock.begin("rewriting the graph")
    changes = rewrite_and_embed(graph, manifest, load_target(target), rewrite=rewrite, skip=skip)
    allowed = model.half_tolerance if half else model.tolerance
    float16_result = None
    if half and rewrite:
        pairs = zip(probes, expected, strict=True)
        finite_probes = [probe for probe, image in pairs if np.isfinite(image).all()]
        image_name = _image(model.inputs).name
        float16_result = image_to_float16(
            graph, image_name, finite_probes[:_FLOAT16_ERROR_PROBE_COUNT], allowed, progress
        )
    # Steps 5 to 7: verification, validation and atomic write.
    with atomic_write(path) as draft:
        save_model(graph, draft)
        clock.begin("comparing with eager torch")
        parity = _check_parity(draft, manifest, probes, expected, allowed, options)
        clock.begin("validating the model")
        report = check_contract(draft, options)
    shape = _image(manifest.inputs).shape
    size = "any size" if shape is None else f"{shape[2]} × {shape[3]} (height × width)"
    times = f", enlarged {model.scale} times" if model.scale > 1 else ""
    return Exported(
        path=path,
        manifest=manifest,
        report=report,
        dtype=dtype,
        contents=f"an image of {size}, {dtype}{times}",
        parity=parity,
        changes=tuple(changes),
        float16_result=float16_result,
        stages=clock.stages(),
    )


def _trace(model: PostProcess, example: Probe, opset: int, *, half: bool) -> ir.Model:
    """Trace a post-process model to an ONNX graph in float32, or a float16 copy of it."""
    dtype = np.float16 if half else np.float32
    inputs = {
        name: value.astype(dtype) if value.dtype == np.float16 else value
        for name, value in example.inputs.items()
    }
    module = _PositionalModule(copy.deepcopy(model).half() if half else model)
    names = TensorNames(tuple(inputs), (OUTPUT_NAME,), _dynamic_axes(model.inputs))
    where = type(model).__name__
    return trace_module(module, replace(example, inputs=inputs), names, opset, where=where)


class _PositionalModule(nn.Module):
    """Calls a torch module with positional inputs, so that traced inputs keep manifest names."""

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Tensor:
        image: Tensor = self.model(*inputs)
        return image


def _image(inputs: Any) -> Input:
    image: Input = next(entry for entry in inputs if entry.role == "image")
    return image


def _check_inputs(model: PostProcess) -> None:
    where = f"{type(model).__name__}.inputs"
    images = [entry.name for entry in model.inputs if entry.role == "image"]
    if len(images) != 1:
        hint = "Give one gsgen.sdk.inputs.image()."
        raise GeneratorInvalid(
            f"the model declares {len(images)} image inputs, expected one", where=where, hint=hint
        )
    image = _image(model.inputs)
    if image.range is not None and image.range != model.image_range:
        message = (
            f"{image.name!r} has the range {image.range}, but image_range is {model.image_range}"
        )
        hint = "Give inputs.image() the same range."
        raise GeneratorInvalid(message, where=where, hint=hint)
    for entry in model.inputs:
        if entry.name == OUTPUT_NAME:
            message = f"{entry.name!r} is the name of the result"
            raise GeneratorInvalid(message, where=where, hint="Give the input another name.")
        if POST_PROCESS not in ROLES[entry.role].kinds:
            message = (
                f"{entry.name!r} has the role {entry.role}, which post-process models do not have"
            )
            raise GeneratorInvalid(message, where=where)


def _manifest(model: PostProcess, name: str, dtype: Any) -> PostProcessManifest:
    image = ImageOutput(
        OUTPUT_NAME, dtype, model.output_range, model.color_space, scale=model.scale
    )
    return PostProcessManifest(
        name=name,
        family=model.family,
        producer=model.producer or Producer(f"gsgen {version('gsgen')}"),
        inputs=tuple(model.inputs),
        outputs=PostProcessOutputs(image),
        image_range=model.image_range,
    )


def _probes_of_sizes(
    model: PostProcess, manifest: PostProcessManifest, dtype: Dtype
) -> Iterator[Probe]:
    """Yield the test inputs for each tested image size: two sizes if the model takes any size."""
    is_any_size = _image(model.inputs).shape is None
    for size in (_TRACED_IMAGE_SIZE, _SECOND_IMAGE_SIZE) if is_any_size else (_TRACED_IMAGE_SIZE,):
        shape = (1, model.channels, *size)
        yield from probes_of(manifest, count=_RUNS_PER_SIZE, image=(dtype, shape))


def _dynamic_axes(inputs: Any) -> tuple[dict[int, Any], ...] | None:
    if _image(inputs).shape is not None:
        return None
    auto_dim = torch.export.Dim.AUTO
    sizes = {2: auto_dim, 3: auto_dim}
    return tuple(sizes if entry.role == "image" else {} for entry in inputs)


def _run_eager_model(model: PostProcess, probe: Probe) -> Float[np.ndarray, "1 c h w"]:
    """Run a post-process module in eager torch in float32, even for a float16 export."""
    tensors = [torch.from_numpy(np.array(value)).float() for value in probe.inputs.values()]
    image = call_module(model, tensors)
    shape = probe.inputs[_image(model.inputs).name].shape
    height, width = (model.scale * side for side in shape[2:])
    is_image = isinstance(image, torch.Tensor) and image.ndim == 4
    if not is_image or image.shape[1] not in IMAGE_CHANNELS or image.shape[2:] != (height, width):
        is_tensor = isinstance(image, torch.Tensor)
        actual = list(image.shape) if is_tensor else type(image).__name__
        message = f"forward returned {actual}, expected [1, 3 or 4, {height}, {width}]"
        raise GeneratorInvalid(message, where=type(model).__name__)
    return np.asarray(image.to(torch.float64).numpy())


def _check_parity(
    path: Path,
    manifest: PostProcessManifest,
    probes: list[Probe],
    expected: list[np.ndarray],
    allowed: float,
    options: ExportOptions,
) -> Parity:
    options.progress(f"comparing with eager torch at {len(probes)} probes")
    low, high = manifest.outputs.image.range
    frame_bytes = max(image.nbytes for image in expected)
    runs = run_exported(path, (OUTPUT_NAME,), probes, options.limits, frame_bytes=frame_bytes)
    images = [np.array(outputs[OUTPUT_NAME]) for outputs in runs]
    field_errors = list(_image_errors(images, expected, probes, abs(high - low), allowed))
    worst_error = max(field_errors, key=lambda field: field.excess)
    parity = Parity((worst_error,), len(probes))
    if not parity.holds:
        message = (
            f"the image is off by {worst_error.error:.3g} of its range for the test inputs {worst_error.probe!r}, "
            f"{worst_error.excess:.3g} times the tolerance"
        )
        raise ParityFailed(message, where=path.name, parity=parity)
    return parity


def _image_errors(
    images: list[np.ndarray],
    expected_images: list[np.ndarray],
    probes: list[Probe],
    value_range: float,
    allowed: float,
) -> Iterator[FieldError]:
    for actual, expected, probe in zip(images, expected_images, probes, strict=True):
        if probe.zeros and not np.isfinite(expected).all():
            continue  # the module's own fault, which rule GI009 reports
        error = np.abs(actual.astype(np.float64) - expected) / value_range
        error[np.isnan(error)] = np.inf
        largest = float(error.max())
        yield FieldError(
            field="image",
            error=largest,
            excess=largest / allowed,
            probe=probe.label,
            row=int(np.argmax(error)),
        )
