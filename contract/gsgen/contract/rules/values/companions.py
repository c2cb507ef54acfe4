"""Validation rules of post-process models: images are finite, of the declared size and range."""

from collections.abc import Iterator

import numpy as np

from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.fields.roles import IMAGE_CHANNELS, POST_PROCESS
from gsgen.contract.spec.manifest import PostProcessManifest
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import MODEL_RUNS, NOT_RANDOM
from gsgen.contract.validation.rule import rule

# An image may leave its range by this fraction of it, in so many of its values.
_RANGE_SLACK = 0.1
_MAX_OUTLIER_SHARE = 0.01


def _outputs(probe_runs: ProbeRuns, name: str) -> Iterator[tuple[str, np.ndarray]]:
    """Yield label and output ``name`` of each test run, except for all-zero inputs."""
    for run in probe_runs.execution.runs[: probe_runs.plan.values]:
        probe = probe_runs.plan.probes[run.probe]
        value = probe_runs.execution.samples[run.sample].outputs.get(name)
        if value is not None and not probe.zeros:
            yield probe.label, value


@rule("GV055", Severity.ERROR, needs=(MODEL_RUNS,), kinds=(POST_PROCESS,))
def image_finite(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """Every value of the output image is finite.

    Why:
        A picture with NaN shows black or white holes.

    Hint:
        Find the division, logarithm or norm that sees zero, and clamp before it.
    """
    for name in probe_runs.subject.output_names:
        for label, value in _outputs(probe_runs, name):
            if value.dtype.kind == "f" and not np.isfinite(value).all():
                count = int(np.count_nonzero(~np.isfinite(value)))
                actual = f"{count} of {value.size} values not finite at {label!r}"
                yield Violation.at(f"output {name}", actual, "finite values")
                break


@rule("GV056", Severity.ERROR, needs=(MODEL_RUNS, "GO018"), kinds=(POST_PROCESS,), at_moments=True)
def image_keeps_size(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """The output image is `scale` times as high and as wide as the input image, at odd sizes, too.

    Why:
        The result is drawn over the pixels of the rendered image. Where sizes are open in the
        graph, only a run shows a pooling or a padding that was left in.

    Hint:
        Pad the image to the multiple that the network needs, and crop its result to the size of
        the input times the declared scale; channels stay first.
    """
    manifest = probe_runs.subject.manifest
    images = probe_runs.subject.inputs_of("image")
    if not isinstance(manifest, PostProcessManifest) or not images:
        return
    name, scale = manifest.outputs.image.name, manifest.outputs.image.scale
    plan = probe_runs.plan
    for index in (*range(plan.values), *plan.trials.get("sizes", ())):
        run, probe = probe_runs.execution.runs[index], plan.probes[index]
        batch, _, height, width = probe.inputs[images[0][0].name].shape
        value = probe_runs.execution.samples[run.sample].outputs.get(name)
        if value is None:
            continue
        has_fitting_shape = value.ndim == 4 and value.shape[1] in IMAGE_CHANNELS
        expected_size = (batch, scale * height, scale * width)
        if not has_fitting_shape or (value.shape[0], *value.shape[2:]) != expected_size:
            times = f"{scale} times " if scale > 1 else ""
            expected = f"{times}the size of the input, {height} × {width}, with 3 or 4 channels"
            yield Violation.at(f"output {name}", f"shape {list(value.shape)}", expected)
            return


@rule("GV057", Severity.WARNING, needs=("GV055", "GV056", *NOT_RANDOM), kinds=(POST_PROCESS,))
def image_within_range(probe_runs: ProbeRuns) -> Iterator[Violation]:
    """Nearly all values of the output image lie in the declared range, with some margin.

    Why:
        A runtime clips the image to its range: bytes declared as [0, 1] are all white, and signed
        values declared so lose their darker half.

    Hint:
        Declare the range that the model gives, or scale the image at its end.
    """
    manifest = probe_runs.subject.manifest
    if not isinstance(manifest, PostProcessManifest):
        return
    (low, high), name = manifest.outputs.image.range, manifest.outputs.image.name
    slack = _RANGE_SLACK * (high - low)
    images = [value.astype(np.float32) for _, value in _outputs(probe_runs, name)]
    outside_shares = [np.mean((value < low - slack) | (value > high + slack)) for value in images]
    if images and np.mean(outside_shares) > _MAX_OUTLIER_SHARE:
        min_value, max_value = min(v.min() for v in images), max(v.max() for v in images)
        actual = f"values from {min_value:.3g} to {max_value:.3g}"
        expected = f"the declared range {[low, high]}"
        yield Violation.at(f"output {name}", actual, expected, certainty="possible")
