"""Validation rules of level ``render`` (GB018 to GB021): the drawn frames show the model.

The rules are registered under the entry point group ``gsgen.rules``.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from functools import partial
from typing import TYPE_CHECKING

from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.layout import CULL_OPACITY
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.level_backend import LevelBackend, LevelContext
from gsgen.contract.validation.rule import rule

if TYPE_CHECKING:
    from gsgen.runtime.checks.level import RenderEvidence


def _prepare_level(probe_runs: ProbeRuns) -> AbstractContextManager[LevelContext]:
    from gsgen.runtime.checks.level import prepare_render

    return prepare_render(probe_runs)


RENDER_BACKEND = LevelBackend(Level.RENDER, "drawing frames", _prepare_level)

_MIN_AGREEMENT = 60  # decibels
_render_rule = partial(rule, over="render")
_PREREQUISITE_RULES = ("GV025", "GO001", "GO002", "GO005", "GO008")


@_render_rule("GB018", Severity.ERROR, needs=_PREREQUISITE_RULES)
def picture_not_empty(evidence: "RenderEvidence") -> Iterator[Violation]:
    """At least one drawn frame shows the model.

    Why:
        All tensors may be valid, and the screen still be empty: Gaussians have the wrong unit,
        are behind the camera that they are culled for, or are so small that antialiasing makes
        them invisible.

    Hint:
        Draw the model with `gsgen render`, and compare positions and covariances with "bounds".
        With antialias "mip", visible Gaussians are about a pixel wide or more.
    """
    frames = [frame for frame in evidence.frames if frame.live]
    if frames and not any(_is_visible(frame.coverage) for frame in frames):
        max_coverage = max(frame.coverage for frame in frames)
        actual = (
            f"no pixel is covered by more than {max_coverage:.2g} in any of {len(frames)} frames"
        )
        yield Violation.at("picture", actual, f"at least {CULL_OPACITY:.2g} somewhere")


@_render_rule("GB019", Severity.WARNING, needs=(*_PREREQUISITE_RULES, "GB018"))
def every_frame_shows(evidence: "RenderEvidence") -> Iterator[Violation]:
    """Every drawn frame shows at least one Gaussian, unless its count of Gaussians is zero.

    Why:
        A model that is empty for some cameras or times flickers. Most often it culls by a matrix
        that it reads in the wrong order.

    Hint:
        Draw the named frame with `gsgen render`. If the frame is meant to be empty, set the count
        to zero; else check the parts of the model that read the camera and the time.
    """
    for frame in evidence.frames:
        if frame.live and not _is_visible(frame.coverage):
            actual = (
                f"{frame.visible} of {frame.live} rows are drawn at {frame.probe!r}, none visible"
            )
            yield Violation.at("picture", actual, f"a pixel covered by at least {CULL_OPACITY:.2g}")


@_render_rule("GB020", Severity.WARNING, needs=(*_PREREQUISITE_RULES, "GB018"))
def rasterisers_agree(evidence: "RenderEvidence") -> Iterator[Violation]:
    """The tile and the quad rasteriser draw the same picture, to 60 dB.

    Why:
        Viewers blend in one of two ways: tiles skip Gaussians behind an opaque pixel, quads draw
        them. The two differ by up to a hundredth of the light. A model of nearly opaque sheets,
        one behind the other, looks different from viewer to viewer.

    Hint:
        Remove Gaussians that are hidden behind opaque ones much wider than a pixel, or give both
        the same colour.
    """
    for frame in evidence.frames:
        if frame.agreement is not None and frame.agreement < _MIN_AGREEMENT:
            actual = f"{frame.agreement:.1f} dB between tiles and quads at {frame.probe!r}"
            yield Violation.at("picture", actual, f"at least {_MIN_AGREEMENT} dB")


@_render_rule("GB021", Severity.WARNING, needs=(*_PREREQUISITE_RULES, "GM002", "GM003", "GM005"))
def reference_images_match(evidence: "RenderEvidence") -> Iterator[Violation]:
    """Every reference image of the manifest exists, and the model draws it.

    Why:
        Tensors that agree to a tolerance do not show that a model looks the same as on its
        author's machine. A picture, its camera and a least number of decibels do.

    Hint:
        Ship the picture with the model. If a picture is from the source, look for swapped channels,
        a mirrored axis or other signs of SH first. If the model is right, draw its pictures again:
        `gsgen references MODEL -o MODEL --force`. Models without pictures are fine.
    """
    for number, reference in enumerate(evidence.references):
        subject = f"manifest reference_images.{number}"
        if reference.psnr is None:
            yield Violation.at(
                subject, f"{reference.path!r}: {reference.problem}", "a PNG to compare with"
            )
        elif reference.psnr < reference.expected:
            actual = f"{reference.path!r}: {reference.psnr:.1f} dB"
            yield Violation.at(subject, actual, f"at least {reference.expected:g} dB")


def _is_visible(coverage: float) -> bool:
    return coverage >= CULL_OPACITY
