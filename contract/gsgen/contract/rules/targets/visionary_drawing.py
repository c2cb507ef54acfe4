"""Rules of drawing (TV, GL): predict how the Visionary web viewer 1.0.1 draws the outputs.

Source: its ``gaussian_preprocessor.ts`` and ``preprocess.wgsl``, version 1.0.1.
"""

from collections.abc import Iterator

import numpy as np

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.outputs import ModelOutputs, Rows
from gsgen.contract.rules.targets.visionary import TARGET
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Location, Violation, line_hint, set_hint
from gsgen.contract.validation.gates import MANIFEST_PARSED
from gsgen.contract.validation.rule import rule

_WORKGROUP_ROWS = 256
# The viewer's filter, in squared pixels; a lens of 45 degrees on 1080 rows; a camera that sees all.
_KERNEL_PIXELS = 0.1
_FOCAL_PIXELS = 1304.0
_WHOLE_VIEW_RADII = 2.2
_MIN_OPACITY_SHARE = 0.5


@rule("GL006", Severity.WARNING, target=TARGET, needs=("GV025", "GO001", "GO002", "GO010", "GO011"))
def capacity_fills_workgroups(emission: ModelOutputs) -> Iterator[Violation]:
    """A capacity with padding rows is a multiple of 256, the size of a workgroup.

    Why:
        The viewer draws with workgroups of 256 and does not stop at the end of the buffer. The values
        there depend on the driver; one draws hundreds of ghosts. A model that pads anyway can
        pad to whole workgroups, whose last rows are inert.

    Hint:
        Raise the capacity to the next multiple of 256.
    """
    rows = emission.gaussians
    if rows is not None and emission.count < len(rows) and len(rows) % _WORKGROUP_ROWS:
        expected = f"{-(-len(rows) // _WORKGROUP_ROWS) * _WORKGROUP_ROWS} rows"
        subject, hint = emission.subject, ""
        color, missing = emission.appearance, -len(rows) % _WORKGROUP_ROWS
        if color is not None and subject.appearance is not None and emission.cells is None:
            lines = []
            for label, columns in (
                (emission.rows_label, 10),
                (emission.color_label, color.shape[1]),
            ):
                name = label.removeprefix("output ")
                fill = f"torch.zeros({missing}, {columns}, dtype={name}.dtype)"
                lines.append(line_hint(f"{name} = torch.cat([{name}, {fill}])"))
            capacity = set_hint("outputs.gaussians.capacity", len(rows) + missing)
            hint = " ".join([*lines, capacity])
        yield Violation.at(emission.rows_label, f"{len(rows)} rows", expected, hint=hint)


@rule("TV107", Severity.INFO, target=TARGET, needs=("GO010",))
def visionary_ignores_count(subject: InspectedModel) -> Iterator[Violation]:
    """The row count is constant, because Visionary draws all rows regardless of the count.

    Why:
        The test of the count is commented out in the viewer's shader. Rows behind it are drawn as
        they are, so only their opacity of 0 keeps them invisible (rule padding-inert).

    Hint:
        Nothing, if rows behind the count are zeros; do not rely on the count alone.
    """
    declared = subject.declared_count
    if declared is not None and subject.graph.varies(declared.name):
        yield Violation.at(f"output {declared.name}", "the count varies", "a constant count")


@rule("TV109", Severity.INFO, target=TARGET, needs=("GO008", "GG019"))
def visionary_needs_f16(subject: InspectedModel) -> Iterator[Violation]:
    """A model with float32 outputs does not compute in float16, which needs a GPU feature.

    Why:
        Kernels in float16 need the WebGPU feature shader-f16. Outputs in float32 look as if the
        model ran without it, and on a device that lacks it the viewer stops.

    Hint:
        Compute in float32, or emit float16 as well, which at least halves the memory traffic.
    """
    outputs = (subject.gaussians, subject.appearance)
    if any(tensor is not None and tensor.dtype == "float16" for tensor in outputs):
        return
    for placement in subject.placements:
        if placement.dtype == "float16":
            location = (
                f"node {placement.node.name or placement.node.output[0]} ({placement.node.op_type})"
            )
            yield Violation.at(location, "computes in float16", "float32, as the outputs are")
            return


@rule("TV110", Severity.INFO, target=TARGET, needs=("GV025", "GO001", "GO002", "GO008", "GM009"))
def visionary_fades_small(rows: Rows) -> Iterator[Violation]:
    """Most Gaussians are large enough that the Visionary viewer's low-pass filter does not fade them.

    Why:
        The viewer always compensates for its filter, regardless of the manifest: a Gaussian
        narrower than a third of a pixel loses most of its opacity. This is a prediction for a
        camera that sees all of the bounds on a screen of 1080 rows.

    Hint:
        Set antialias to "mip" if the model was trained so; else make tiny Gaussians larger.
    """
    generator = rows.emission.subject.generator
    if generator is None or generator.bounds is None or generator.antialias == "mip":
        return
    low, high = np.asarray([generator.bounds.min, generator.bounds.max])
    distance = _WHOLE_VIEW_RADII * float(np.linalg.norm(high - low)) / 2
    pixels = rows.max_variance * np.float32((_FOCAL_PIXELS / max(distance, 1e-9)) ** 2)
    opacity_share = pixels / (pixels + np.float32(_KERNEL_PIXELS))
    yield Violation.rows(
        Location(rows.emission.rows_label, "covariance"),
        rows.drawn & (opacity_share < _MIN_OPACITY_SHARE),
        rows.max_variance,
        f"more than {_MIN_OPACITY_SHARE:.0%} of the opacity in most rows",
        checked=rows.drawn_count,
        min_fraction=0.5,
        certainty="possible",
    )


@rule("TV111", Severity.WARNING, target=TARGET, needs=("GO005", *MANIFEST_PARSED))
def visionary_shows_srgb(subject: InspectedModel) -> Iterator[Violation]:
    """The declared colours are sRGB, as the Visionary viewer shows them.

    Why:
        The viewer writes colours to the screen as they are: linear ones are too dark.

    Hint:
        Convert colours to sRGB before packing.
    """
    declared = subject.declared_appearance
    if declared is not None and declared.color_space != "srgb":
        where, hint = f"output {declared.name}", _srgb_hint(declared.space)
        yield Violation.at(where, declared.color_space, "srgb", hint=hint)


def _srgb_hint(space: str) -> str:
    """Return the hint to encode RGB; SH have no sRGB curve."""
    curve = "1.055 * rows.clamp(0.0031308) ** 0.416666667 - 0.055"
    line = line_hint(f"rows = torch.where(rows < 0.0031308, 12.92 * rows, {curve})")
    srgb = set_hint("outputs.appearance.color_space", "srgb")
    return f"Convert colours to sRGB before packing. {line} {srgb}" if space == "rgb" else ""


@rule("TV112", Severity.WARNING, target=TARGET, needs=("GM017",))
def visionary_sorts(subject: InspectedModel) -> Iterator[Violation]:
    """Gaussians are blended by sorting, not by a weighted sum, which Visionary does not support.

    Why:
        The viewer knows no other way: it sorts Gaussians by depth, and neither reads cells nor
        divides by a sum of weights. A model trained for a weighted sum looks near its own picture
        at best, and cells are computed every frame for nothing.

    Hint:
        Export for sorting, where the method has such an option (`--blend alpha`), and compare
        pictures.
    """
    generator = subject.generator
    if generator is not None and generator.blend != "alpha":
        yield Violation.at("manifest blend", generator.blend, "alpha")
