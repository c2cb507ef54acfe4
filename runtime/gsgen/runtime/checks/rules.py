"""GB, render: what the model emits can be seen.

Registered under the entry point group ``gsgen.rules``; importing this costs little.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.layout import CULL_OPACITY
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.level_backend import LevelBackend, LevelContext
from gsgen.contract.validation.rule import rule

if TYPE_CHECKING:
    from gsgen.runtime.checks.level import RenderEvidence


def _prepare(trial: ProbeRuns) -> AbstractContextManager[LevelContext]:
    from gsgen.runtime.checks.level import prepare_render

    return prepare_render(trial)


RUNNER = LevelBackend(Level.RENDER, "drawing frames", _prepare)

_LEAST_AGREEMENT = 60
_NEEDS = ("GV025", "GO001", "GO002", "GO005", "GO008")


@rule(
    "GB018",
    "picture-not-empty",
    Severity.ERROR,
    over="render",
    fixture="too_fine_to_be_seen",
    needs=_NEEDS,
)
def picture_not_empty(showing: "RenderEvidence") -> Iterator[Violation]:
    """A camera that looks at the model sees it in at least one of the frames that are drawn.

    Why:
        Every tensor may keep the contract, and yet nothing is on the screen: Gaussians of the
        wrong unit, behind the camera that they are culled for, or so fine that antialiasing
        leaves nothing of them.

    Hint:
        Draw the model with `gsgen render`, and compare the scale of positions and covariances with
        "bounds". With antialias "mip", Gaussians must be about a pixel wide to be seen.
    """
    frames = [frame for frame in showing.frames if frame.live]
    if frames and not any(_is_seen(frame.covered) for frame in frames):
        most = max(frame.covered for frame in frames)
        actual = (
            f"no pixel is covered by more than {most:.2g} in any of {len(frames)} frames"
        )
        yield Violation.at("picture", actual, f"at least {CULL_OPACITY:.2g} somewhere")


@rule(
    "GB019",
    "every-frame-shows",
    Severity.WARNING,
    over="render",
    fixture="grows_out_of_nothing",
    needs=(*_NEEDS, "GB018"),
)
def every_frame_shows(showing: "RenderEvidence") -> Iterator[Violation]:
    """Every frame that is drawn, and that has live rows, shows something.

    Why:
        A model that is empty for some cameras or times flickers, and most often culls by a matrix
        that it reads in the wrong order.

    Hint:
        Draw the frame that is named with `gsgen render`. If nothing is to be seen there, give a
        count of zero; else check what depends on the camera and the time.
    """
    for frame in showing.frames:
        if frame.live and not _is_seen(frame.covered):
            actual = f"{frame.visible} of {frame.live} rows are drawn at {frame.probe!r}, none visibly"
            yield Violation.at("picture", actual, "a pixel that something covers")


@rule(
    "GB020",
    "rasterisers-agree",
    Severity.WARNING,
    over="render",
    fixture="opaque_behind_opaque",
    needs=(*_NEEDS, "GB018"),
)
def rasterisers_agree(showing: "RenderEvidence") -> Iterator[Violation]:
    """Compute tiles and the hardware's quads draw the same picture, to 60 dB.

    Why:
        Viewers blend in one of two ways: tiles leave out what is behind a pixel that is finished,
        quads draw it. Up to a hundredth of the light is between them. A model of sheets that are
        as good as opaque, one behind the other, looks different from viewer to viewer.

    Hint:
        Leave out what is hidden behind opaque Gaussians that are much wider than a pixel, or give
        both the same colour.
    """
    for frame in showing.frames:
        if frame.agreement is not None and frame.agreement < _LEAST_AGREEMENT:
            actual = f"{frame.agreement:.1f} dB between tiles and quads at {frame.probe!r}"
            yield Violation.at("picture", actual, f"at least {_LEAST_AGREEMENT} dB")


@rule(
    "GB021",
    "reference-images-match",
    Severity.WARNING,
    over="render",
    fixture="looks_otherwise",
    needs=(*_NEEDS, "GM002", "GM003", "GM005"),
)
def reference_images_match(showing: "RenderEvidence") -> Iterator[Violation]:
    """Every picture that the manifest declares is beside the model, and the model draws it.

    Why:
        Tensors that agree to a tolerance say little to whoever wants to know that a model looks
        as it did at its author's. A picture, its camera and a least number of decibels do.

    Hint:
        Give the file along with the model. If the model is right, draw its pictures anew:
        `gsgen references MODEL -o MODEL --force`. Models without pictures are fine.
    """
    for number, reference in enumerate(showing.references):
        subject = f"manifest reference_images.{number}"
        if reference.psnr is None:
            yield Violation.at(
                subject, f"{reference.path!r}: {reference.problem}", "a PNG to compare with"
            )
        elif reference.psnr < reference.expected:
            actual = f"{reference.path!r}: {reference.psnr:.1f} dB"
            yield Violation.at(subject, actual, f"at least {reference.expected:g} dB")


def _is_seen(covered: float) -> bool:
    return covered >= CULL_OPACITY
