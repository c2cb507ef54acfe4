"""Run a generator in eager torch, as the reference that an exported model is compared with."""

__all__ = ["Reference", "measure_bounds", "run_eager", "run_watched"]
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gsgen.contract.errors import GsgenError
from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec import layout
from gsgen.contract.spec.geometry import covariance_upper
from gsgen.contract.spec.manifest import Bounds
from gsgen.sdk.authoring.cells import Cells
from gsgen.sdk.authoring.generator import GaussianGenerator, Gaussians
from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.exporting.source_lines import line_of
from gsgen.sdk.exporting.trace_hazards import Watch
from gsgen.sdk.parity import Reference

# Bounds are widened by this share of their size, so that times and poses between the probes
# stay inside too.
_MARGIN = 0.02


def run_eager(generator: GaussianGenerator, probe: Probe) -> Reference:
    """Run ``generator`` once, without gradients.

    Raises:
        GeneratorInvalid: ``forward`` raised, or returned something else than Gaussians.
    """
    return _reference(generator, probe, _call(generator, _tensors(probe)))


def run_watched(generator: GaussianGenerator, probe: Probe) -> tuple[Reference, Watch]:
    """Run ``generator`` like :func:`run_eager`, and note what tracing could not follow.

    Raises:
        GeneratorInvalid: As there.
    """
    tensors = _tensors(probe)
    with Watch(generator, tensors) as watch:
        made = _call(generator, tensors)
    return _reference(generator, probe, made), watch


def _tensors(probe: Probe) -> list[Tensor]:
    return [torch.from_numpy(np.array(value)) for value in probe.inputs.values()]


def _call(generator: GaussianGenerator, tensors: list[Tensor]) -> Any:
    try:
        with torch.no_grad():
            return generator(*tensors)
    except GsgenError:
        raise
    except Exception as error:  # the user's code may raise anything
        what = f"forward raised {type(error).__name__}: {error}"
        where = line_of(error) or type(generator).__name__
        raise GeneratorInvalid(what, where=where) from error


def _reference(generator: GaussianGenerator, probe: Probe, made: Any) -> Reference:
    if not isinstance(made, Gaussians):
        what = f"forward returned {type(made).__name__}, wanted gsgen.sdk.Gaussians"
        raise GeneratorInvalid(what, where=type(generator).__name__)
    n = made.position.shape[0]
    count = n if made.count is None else int(np.clip(int(made.count.reshape(-1)[0]), 0, n))
    if made.scale is not None and not probe.zeros:
        _refuse_negative(_wide(made.scale[:count]))
    cells = None if made.cells is None else _unpacked_cells(made.cells)
    return Reference(probe, _unpacked(made), count, cells)


def _refuse_negative(scale: np.ndarray) -> None:
    """Refuse scales that are mostly negative: logarithms, squared, would pass as huge Gaussians.

    Single ones are let be: methods that add an offset to a scale (Deformable-3D-Gaussians) have
    them, and draw their squares.
    """
    wrong = int((scale < 0).all(axis=1).sum())
    if wrong > len(scale) / 2:
        raise GeneratorInvalid(
            f"is negative in {wrong:,} of {len(scale):,} rows, down to {scale.min():g}; "
            "wanted standard deviations",
            where="Gaussians.scale",
            hint="Take torch.exp of logarithms, which 3DGS stores; or abs, if signs mean nothing.",
        )


def _unpacked(made: Gaussians) -> layout.DecodedGaussians:
    return layout.DecodedGaussians(
        position=_wide(made.position),
        opacity=_wide(made.opacity).reshape(-1),
        covariance=_covariance(made),
        sh=None if made.sh is None else _wide(made.sh),
        rgb=None if made.rgb is None else _wide(made.rgb),
    )


def _unpacked_cells(made: Cells) -> layout.Cells:
    visibility = _wide(made.visibility).reshape(-1)
    return layout.Cells(_wide(made.position), visibility, _covariance(made))


def _covariance(made: Gaussians | Cells) -> np.ndarray:
    if made.covariance is not None:
        return _wide(made.covariance)
    assert made.scale is not None
    assert made.rotation is not None
    return covariance_upper(_wide(made.scale), _wide(made.rotation))


def _wide(tensor: Tensor) -> np.ndarray:
    return np.asarray(tensor.detach().to(torch.float64).cpu().numpy())


def measure_bounds(references: list[Reference]) -> Bounds:
    """Return the box around all visible centres of ``references``, slightly widened.

    Raises:
        GeneratorInvalid: No centre is finite and visible, so there is nothing to bound.
    """
    centres = [
        r.gaussians.position[: r.count][_visible(r)]
        for r in references
        if not r.probe.zeros
    ]
    points = np.concatenate(centres) if centres else np.zeros((0, 3))
    bounds = Bounds.around(points, _MARGIN)
    if bounds is None:
        raise GeneratorInvalid(
            "no probe gives a single finite, visible Gaussian",
            where="forward",
            hint="Check that opacity is activated and that positions are finite.",
        )
    return bounds


def _visible(reference: Reference) -> np.ndarray:
    g, n = reference.gaussians, reference.count
    finite = np.isfinite(g.position[:n]).all(axis=1)
    return np.asarray(finite & (g.opacity[:n] >= layout.CULL_OPACITY))
