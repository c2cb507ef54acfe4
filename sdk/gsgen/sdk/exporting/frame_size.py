"""The memory that one frame's outputs take, and whether the target's GPU can bind them."""

__all__ = ["check_fits", "describe_size", "frame_bytes"]

from dataclasses import dataclass

import numpy as np

from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.spec.spherical_harmonics import coefficients
from gsgen.contract.spec.targets import load_target
from gsgen.contract.spec.units import format_mebibytes
from gsgen.sdk.authoring.generator import GaussianGenerator
from gsgen.sdk.errors import GeneratorInvalid

# Rows of RGB are padded to four numbers where they must fill words.
_RGB_CHANNELS = 4
# Frames below this size are exported too quickly for an estimate to matter.
_LARGE_FRAME_BYTES = 64 << 20
# Arrays of one frame that a comparison holds: eager torch's, its float64 covariances, the model's.
_FRAMES_IN_MEMORY = 4


@dataclass(frozen=True, slots=True)
class _OutputSizes:
    rows: int  # bytes of the packed Gaussians
    color: int  # bytes of the appearance


def _sizes(manifest: GeneratorManifest, dtype: str) -> _OutputSizes:
    gaussians, appearance = manifest.outputs.gaussians, manifest.outputs.appearance
    assert gaussians is not None
    assert appearance is not None
    degree = appearance.degree
    channels = _RGB_CHANNELS if degree is None else 3 * coefficients(degree)
    numbers = gaussians.capacity * np.dtype(dtype).itemsize
    return _OutputSizes(layout.ROW_LENGTH * numbers, channels * numbers)


def frame_bytes(manifest: GeneratorManifest, dtype: str | None = None) -> int:
    """Return the size in bytes of one frame's outputs, stored in the manifest's or another dtype."""
    assert manifest.outputs.gaussians is not None
    sizes = _sizes(manifest, dtype or manifest.outputs.gaussians.dtype)
    return sizes.rows + sizes.color


def describe_size(manifest: GeneratorManifest, dtype: str, *, seconds: float, runs: int) -> str:
    """Return a sentence about size, time and memory of a large export; empty for a small one.

    Args:
        manifest: Declares the outputs.
        dtype: The dtype in which they are stored in the end.
        seconds: The time of one run in eager torch.
        runs: Number of runs in eager torch and in ONNX Runtime that follow.
    """
    size = frame_bytes(manifest, dtype)
    if size < _LARGE_FRAME_BYTES:
        return ""
    assert manifest.outputs.gaussians is not None
    memory = (_FRAMES_IN_MEMORY * size + (1 << 30)) / (1 << 30)
    minutes = seconds * runs / 60
    return (
        f"{manifest.outputs.gaussians.capacity:,} Gaussians: {format_mebibytes(size, 0)} a frame; "
        f"{runs} runs of about {seconds:.1f} s take {minutes:.0f} minutes or more, and up to "
        f"{memory:.1f} GiB of memory"
    )


def check_fits(
    generator: GaussianGenerator, manifest: GeneratorManifest, target: str, dtype: str
) -> None:
    """Raise if an output of the generator model exceeds the storage buffer size of the target GPU.

    Raises:
        GeneratorInvalid: It is; the hint names the options that make it smaller.
    """
    limit = load_target(target).limits.get("binding_bytes")
    if limit is None:
        return
    assert manifest.outputs.gaussians is not None
    assert manifest.outputs.appearance is not None
    sizes = _sizes(manifest, dtype)
    largest, name = max(
        (sizes.rows, manifest.outputs.gaussians.name),
        (sizes.color, manifest.outputs.appearance.name),
    )
    if largest <= limit:
        return
    fits_as_float16 = dtype == "float32" and largest // 2 <= limit
    options = (["--dtype float16"] if fits_as_float16 else []) + list(generator.smaller)
    raise GeneratorInvalid(
        f"{name} has {format_mebibytes(largest, 0)} a frame, but {target} binds at most "
        f"{format_mebibytes(limit, 0)}",
        where=type(generator).__name__,
        hint=f"Export with {' or '.join(options)}." if options else "Return fewer Gaussians.",
    )
