"""How far the exports of all plugins stay below the tolerance of their goldens.

A golden is what a method's own code computed for a checkpoint. The margin is the tolerance over the
error, the smallest of all fields and frames. Each checkpoint is exported in float32 and in float16.
Run by ``make bench``, or ``python -m pytest tests/bench/plugins/bench_golden_margins.py`` with the
options of that target; ``-k lgm`` measures one plugin. The goldens of the older plugins are taken
from the folder that ``GSGEN_SHARED`` names.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.anchors import duplex_gs_plugin
from gsgen.reference_plugins.enhancers import enhance_plugin
from gsgen.reference_plugins.images import denoiser_plugin
from gsgen.reference_plugins.people import gart_plugin
from gsgen.reference_plugins.spacetime import ex4dgs_plugin
from gsgen.sdk import GaussianGenerator, PostProcess, export
from gsgen.sdk.exporting.post_process_exporter import export_post_process
from plugins import test_golden_exports
from plugins.enhancers import cases as enhancers
from plugins.feed_forward import cases as feed_forward
from plugins.feed_forward import test_feed_forward
from plugins.people import test_avatar_exports, test_gart
from plugins.spacetime import test_ex4dgs
from plugins.styles import cases as styles
from plugins.styles import test_styles
from support.checkpoints.image_goldens import image_error
from support.checkpoints.plugin_checks import (
    ALLOWED,
    ALLOWED_FLOAT16,
    MARGIN,
    acceptance,
    field_errors,
)
from support.commands import shared
from support.measures import print_figure

Outputs = list[np.ndarray]
Shares = dict[str, float]  # errors as shares of their tolerance, by field


@dataclass(frozen=True, slots=True)
class Golden:
    """A module, its inputs of every frame, and the errors of its outputs."""

    module: GaussianGenerator | PostProcess
    frames: list[Mapping[str, Any]]
    shares: Callable[[int, Outputs, str], Shares]


def tolerances(dtype: str) -> dict[str, float]:
    return ALLOWED if dtype == "float32" else ALLOWED_FLOAT16


def over(errors: Shares, allowed: Mapping[str, float]) -> Shares:
    return {field: error / allowed[field] for field, error in errors.items()}


def of_checkpoint(name: str, build: Callable[[Path], GaussianGenerator], _: Path) -> Golden:
    """Return a golden whose checkpoint lies beside it."""
    tool, module = acceptance(), build(shared(f"data/checkpoints/{name}/ckpt"))
    targets = tool.targets(name)
    aliases = test_avatar_exports.NAMES

    def inputs(values: Mapping[str, Any]) -> dict[str, Any]:
        names = {entry.name: (entry.name, *aliases.get(entry.name, ())) for entry in module.inputs}
        return {
            name: next(values[known] for known in known_names if known in values)
            for name, known_names in names.items()
        }

    def shares(frame: int, outputs: Outputs, dtype: str) -> Shares:
        short = {"float32": "f32", "float16": "f16"}[dtype]
        _, errors = tool.check(name, frame, *outputs[:2], short, targets[frame][1])
        # What the method does not draw has no opacity: one step of 8 bits, at most.
        return over(errors, {"leak": 1 / 512, "tail_opacity": 1 / 512, **tool.TOL[short]})

    return Golden(module, [inputs(values) for values, _ in targets], shares)


def of_gart(name: str, folder: Path) -> Golden:
    case = test_gart.CASES[name]
    frames = [case.frame(index) for index in range(test_gart.POSES)]
    return Golden(
        gart_plugin.build(case.write(folder)),
        frames,
        lambda frame, outputs, dtype: over(
            field_errors(*outputs[:2], test_gart.golden(name, frame)), tolerances(dtype)
        ),
    )


def of_ex4dgs(name: str, folder: Path) -> Golden:
    case = test_ex4dgs.CASES[name]
    return Golden(
        ex4dgs_plugin.build(case.write(folder)),
        [{"time": time} for time in case.times()],
        lambda frame, outputs, dtype: over(
            field_errors(*outputs[:2], test_ex4dgs.golden(name, frame)), tolerances(dtype)
        ),
    )


def of_pictures(name: str, folder: Path) -> Golden:
    case = feed_forward.CASES[name]
    module = case.generator(case.write(folder))
    names = [entry.name for entry in module.inputs]
    return Golden(
        module,
        [dict(zip(names, case.inputs(), strict=True))],
        lambda _, outputs, dtype: over(
            field_errors(*test_feed_forward.golden_pairs(name, *outputs[:2])), tolerances(dtype)
        ),
    )


def of_image(path: Path, module: PostProcess, frame: Mapping[str, Any]) -> Golden:
    def shares(_: int, outputs: Outputs, dtype: str) -> Shares:
        allowed = module.half_tolerance if dtype == "float16" else module.tolerance
        return {"image": image_error(path, outputs[0], limits=(0, 1)) / allowed}

    return Golden(module, [frame], shares)


def of_enhancer(name: str, folder: Path) -> Golden:
    case = enhancers.CASES[name]
    height, width = case.size
    module = enhance_plugin.build(case.write(folder), size=f"{width}x{height}")
    return of_image(enhancers.GOLDENS / f"{name}.npz", module, {"image": case.image()})


def of_style(name: str, folder: Path) -> Golden:
    case = styles.CASES[name]
    module = test_styles.network_of(case, case.write(folder))
    return of_image(styles.GOLDENS / f"{name}.npz", module, test_styles.inputs_of(case))


def of_denoiser(timestep: int, _: Path) -> Golden:
    """Return one step of the U-Net on latents, as diffusers computes it."""
    saved = np.load(shared("data/checkpoints/unet/golden.npz"))
    folder = shared("data/checkpoints/unet/ckpt") / "sdlike"
    module = denoiser_plugin.build(folder, size="32x32", timestep=float(timestep))
    target = saved[f"out_onestep_t{timestep}"]

    def shares(_: int, outputs: Outputs, dtype: str) -> Shares:
        allowed = module.half_tolerance if dtype == "float16" else module.tolerance
        return {"image": float(np.abs(outputs[0].astype(np.float64) - target).max()) / allowed}

    return Golden(module, [{"image": saved["in_img"]}], shares)


def goldens() -> Iterator[Any]:
    """Yield a parameter for each golden: how it is made, from an empty folder."""
    of_weighted = partial(duplex_gs_plugin.build, blend="wsr")
    checkpoints: dict[str, Callable[..., GaussianGenerator]] = {
        **test_golden_exports.BUILD,
        **test_avatar_exports.BUILD,
        "duplex_a": of_weighted,
    }
    for name, build in checkpoints.items():
        yield pytest.param(partial(of_checkpoint, name, build), id=name)
    for make, cases in (
        (of_gart, test_gart.CASES),
        (of_ex4dgs, test_ex4dgs.CASES),
        (of_pictures, feed_forward.CASES),
        (of_enhancer, enhancers.CASES),
        (of_style, styles.CASES),
    ):
        for name in cases:
            yield pytest.param(partial(make, name), id=name)
    for timestep in (199, 999):
        yield pytest.param(partial(of_denoiser, timestep), id=f"unet_{timestep}")


@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize("make", tuple(goldens()))
def bench_margin(
    make: Callable[[Path], Golden], dtype: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    golden, path = make(tmp_path), tmp_path / "model.onnx"
    options: dict[str, Any] = {"dtype": dtype, "settings": Settings(level=Level.STATIC)}
    if isinstance(golden.module, GaussianGenerator):
        # Goldens judge the model: few probes are enough to search for weights of 16 bits.
        export(golden.module, path, target="webgpu", verify="quick", vectors=0, **options)
    else:
        export_post_process(golden.module, path, target="webgpu", **options)
    session = onnxruntime.InferenceSession(path)
    worst: Shares = {}
    for frame, values in enumerate(golden.frames):
        feeds = {
            entry.name: np.asarray(values[entry.name]).astype(_DTYPES[entry.type]).reshape(entry.shape)
            for entry in session.get_inputs()
        }  # fmt: skip
        shares = golden.shares(frame, session.run(None, feeds), dtype)
        worst = {field: max(share, worst.get(field, 0.0)) for field, share in shares.items()}
    field = max(worst, key=lambda name: worst[name])
    margin = 1 / worst[field] if worst[field] else np.inf
    name = request.node.callspec.id
    print_figure(f"{name:32} margin {margin:8.1f} (bar {MARGIN}), by its {field}")
    assert margin >= MARGIN, worst


_DTYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(int32)": np.int32}
