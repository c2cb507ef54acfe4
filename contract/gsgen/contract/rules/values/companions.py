"""Validation rules of post-process models: finite images of the declared size, range and place."""

from collections.abc import Iterable, Iterator
from itertools import permutations

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun, ProbeRuns
from gsgen.contract.spec.fields.roles import IMAGE_CHANNELS, POST_PROCESS
from gsgen.contract.spec.manifest import PostProcessManifest
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Certainty, Statistic, Violation, line_hint, set_hint
from gsgen.contract.validation.gates import MODEL_RUNS, NOT_RANDOM, REPRODUCIBLE
from gsgen.contract.validation.rule import rule

# An image may leave its range by this fraction of it, in so many of its values: networks overshoot
# in few, and by less. A third and all of them are outside where signed values and bytes are declared
# as [0, 1].
_RANGE_SLACK = 0.25
_MAX_OUTLIER_SHARE = 0.1
# Of the range, where the mean of noise stays that a right model sharpens.
_MIN_PLACE, _MAX_PLACE = 0.25, 0.75


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
        Find the division, logarithm or norm that sees zero, and clamp before it; meanwhile, end on
        `rows = torch.where(rows.abs() < 3e38, rows, 0)`.
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
            are_channels_last = value.ndim == 4 and value.shape[3] in IMAGE_CHANNELS
            hint = "Channels come first: end on `permute(0, 3, 1, 2)`." if are_channels_last else ""
            actual = f"shape {list(value.shape)}"
            yield Violation.at(f"output {name}", actual, expected, hint=hint)
            return


@rule("GV057", Severity.ERROR, needs=("GV055", "GV056", *NOT_RANDOM), kinds=(POST_PROCESS,))
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
        # Filters that sharpen leave the range at noise, about its middle; other ranges have others.
        place = (np.mean([np.mean(value) for value in images]) - low) / (high - low)
        is_sure = not _MIN_PLACE <= place <= _MAX_PLACE
        min_value, max_value = min(v.min() for v in images), max(v.max() for v in images)
        actual = f"values from {min_value:.3g} to {max_value:.3g}"
        expected = f"the declared range {[low, high]}"
        hint = _range_hint(float(min_value), float(max_value), [low, high])
        certainty: Certainty = "confirmed" if is_sure else "possible"
        yield Violation.at(f"output {name}", actual, expected, certainty=certainty, hint=hint)


def _range_hint(low: float, high: float, declared: list[float]) -> str:
    """Return the hint to declare the usual range of the values; empty without, or if declared."""
    usual = ([0, 1], [-1, 1], [0, 255])
    fitting = [r for r in usual if r[0] - 0.1 <= low and 0.4 * r[1] <= high <= 1.1 * r[1]]
    if not fitting or fitting[0] == declared:
        return ""
    return f"{set_hint('outputs.image.range', fitting[0])} Or scale the image at its end."


# The statistic is the correlation of the result with a picture that has another gradient in each
# channel: 0.94 to 1 as it is where a network restores pictures. Another version of the picture must
# fit nearly so well, and better by far: turned, mirrored and exchanged pictures have 0.9 to 1, and
# −0.3 to 0.4 as they are; networks with random weights fit no other version by more than 0.34.
_MIN_OTHER_CORRELATION, _MIN_CORRELATION_MARGIN = 0.7, 0.3
# Edges of pictures of odd sizes, and of the first probes, fit best where they were: right models are
# off by 0 pixels, crops and paddings on the wrong side by 1 to 32.
_MIN_SHIFT, _MAX_SHIFT = 1, 32
_MIN_SHIFT_CORRELATION, _MIN_SHIFT_MARGIN = 0.5, 0.2
_VALUE_PICTURES = 2
# Of the picture's contrast, 0.12 are left by networks with random weights, 0.5 by one that darkens,
# and 0.004 where 0 to 1 is taken for 0 to 255.
_MIN_CONTRAST_SHARE = 0.02
_BYTE = 255
_TINY = 1e-12

Picture = Float[np.ndarray, "3 h w"]


@rule(
    "GB063",
    Severity.WARNING,
    needs=(*REPRODUCIBLE, "GM039", "GV055", "GV056"),
    kinds=(POST_PROCESS,),
)
def picture_keeps_its_place(behaviour: Behaviour) -> Iterator[Violation]:
    """A picture comes out upright, unmirrored, where it was, and with red, green and blue in order.

    Why:
        The result is drawn over the rendered image. Libraries differ in which row is the first,
        in the order of channels, and in the side at which they fill up a picture.

    Hint:
        Images are [1, channels, height, width] with the top row first, in the order R, G, B.
        Pad at the right and at the bottom, and crop there.
    """
    for run, picture, result in _shown_pictures(behaviour):
        words, correlation = _best_other_version(picture, result)
        as_it_is = _correlation(picture, result)
        if correlation < max(_MIN_OTHER_CORRELATION, as_it_is + _MIN_CORRELATION_MARGIN):
            continue
        actual = (
            f"{words}: the result at {run.probe.label!r} has the correlation {correlation:.2f} "
            f"with the picture so, and {as_it_is:.2f} with the picture as it is"
        )
        hint = line_hint(_lines_of_versions().get(words, ""))
        yield _violation(behaviour, actual, "the picture as it is", as_it_is, hint)
        return
    values = [run for run in behaviour.values if not run.probe.zeros][:_VALUE_PICTURES]
    for run, picture, result in _pictures_of(
        behaviour, [*behaviour.trial_runs("open sizes"), *values]
    ):
        (down, right), best, in_place = _best_shift(picture, result)
        if max(abs(down), abs(right)) >= _MIN_SHIFT and best >= max(
            _MIN_SHIFT_CORRELATION, abs(in_place) + _MIN_SHIFT_MARGIN
        ):
            actual = (
                f"moved by {down} pixels down and {right} to the right at {run.probe.label!r}: its "
                f"edges have the correlation {best:.2f} there, and {in_place:.2f} in their place"
            )
            yield _violation(behaviour, actual, "the picture in its place", in_place)
            return


@rule(
    "GB064",
    Severity.WARNING,
    needs=(*REPRODUCIBLE, "GG006", "GV055", "GV056", "GB063"),
    kinds=(POST_PROCESS,),
)
def picture_keeps_contrast(behaviour: Behaviour) -> Iterator[Violation]:
    """The result of a picture has more than a fiftieth of the picture's contrast.

    Why:
        A network that was trained on bytes takes 0 to 1 for black: its result is one flat colour,
        or the declared range is not that of the result.

    Hint:
        Multiply the image by 255 before the network, and divide the result by 255; or declare the
        range that the network takes.
    """
    manifest = behaviour.subject.manifest
    assert isinstance(manifest, PostProcessManifest)
    spans = [high - low for low, high in (manifest.image_range, manifest.outputs.image.range)]
    for run, picture, result in _shown_pictures(behaviour):
        contrasts = [float(image.std(axis=(1, 2)).mean()) for image in (picture, result)]
        share = (contrasts[1] / spans[1]) / max(contrasts[0] / spans[0], _TINY)
        if share <= _MIN_CONTRAST_SHARE:
            actual = f"{share:.2g} of the picture's contrast at {run.probe.label!r}"
            expected = f"more than {_MIN_CONTRAST_SHARE} of it"
            statistic = Statistic("share of the contrast", share, _MIN_CONTRAST_SHARE)
            where = f"output {manifest.outputs.image.name}"
            image = next(iter(behaviour.subject.inputs_of("image")))[0].name
            hint = (
                f"If the network takes bytes: {line_hint(f'{image} = {image} * 255', first=True)} "
                f"{line_hint('rows = rows / 255')} Or declare the range that the network takes."
            )
            if 0.5 < share * _BYTE < 2:
                hint = f"The result is divided by 255 once more. {line_hint('rows = rows * 255')}"
            yield Violation.at(
                where, actual, expected, certainty="possible", statistic=statistic, hint=hint
            )
            return


# Pictures with an alpha at random: their product fits the result so well, and better by far.
_MIN_PRODUCT_CORRELATION, _MIN_PRODUCT_MARGIN = 0.85, 0.15
# A uniform picture comes out in stripes: its columns or rows differ by steps of a hundredth of the
# range or more at some lines, at two of five at most, and by a tenth of that elsewhere. An eighth at
# each border is left out, where a convolution meets the padding.
_MIN_SEAM, _MAX_SEAM_SHARE, _BORDER = 0.01, 0.4, 8


@rule(
    "GB072",
    Severity.WARNING,
    needs=(*REPRODUCIBLE, "GV055", "GV056", "GB063", "GB064"),
    kinds=(POST_PROCESS,),
)
def picture_keeps_its_colors(behaviour: Behaviour) -> Iterator[Violation]:
    """A picture comes out sRGB-encoded, without a tint or a product with alpha, and uniform if it was.

    Why:
        Networks take pictures normalised in their own way. Means that are subtracted and not added back
        tint the picture, linear numbers darken it, and tiles that are normalised alone have seams.

    Hint:
        Undo at the end what the model does to the picture at its beginning: means, deviations,
        range and curve. Normalise the whole picture, not its tiles.
    """
    manifest = behaviour.subject.manifest
    assert isinstance(manifest, PostProcessManifest)
    where, output = f"output {manifest.outputs.image.name}", manifest.outputs.image
    from gsgen.contract.causes.picture_colors import MIN_DECLARED_ERROR, explain_colors

    for run, picture, result in _shown_pictures(behaviour):
        before, after = (
            ((image - low) / (high - low)).reshape(3, -1).T
            for image, (low, high) in ((picture, manifest.image_range), (result, output.range))
        )
        reading = explain_colors(before, after)
        if reading is not None:
            line = line_hint(reading.line if output.range == (0, 1) else "")
            yield Violation.at(
                where,
                f"{reading.name}: half of the pixels differ at {run.probe.label!r}",
                "the picture's colours",
                certainty="possible",
                statistic=Statistic("error over contrast", reading.declared, 0, MIN_DECLARED_ERROR),
                hint=f"{reading.hint} {line}".strip(),
            )
            return
    yield from _products_with_alpha(behaviour, where)
    for run, _, result in _pictures_of(behaviour, behaviour.trial_runs("pictures")):
        image = next(iter(behaviour.subject.inputs_of("image")))[0]
        if np.ptp(run.probe.inputs[image.name]) == 0 and (words := _seams(result, output.range)):
            actual = f"{words} of {run.probe.label!r} differ in stripes"
            yield Violation.at(where, actual, "one colour", certainty="possible")
            return


def _products_with_alpha(behaviour: Behaviour, where: str) -> Iterator[Violation]:
    """Yield a violation if the result fits the product of colours and alpha, and not the colours."""
    image = next(iter(behaviour.subject.inputs_of("image")))[0]
    runs = [run for run in behaviour.values if not run.probe.zeros][:_VALUE_PICTURES]
    for run, picture, result in _pictures_of(behaviour, runs):
        alpha = run.probe.inputs[image.name][0, 3:]
        if not len(alpha) or not np.ptp(alpha):
            return
        product, plain = _correlation(picture * alpha, result), _correlation(picture, result)
        if product >= max(_MIN_PRODUCT_CORRELATION, plain + _MIN_PRODUCT_MARGIN):
            actual = (
                f"colours multiplied by alpha: the result at {run.probe.label!r} has the "
                f"correlation {product:.2f} with the product, and {plain:.2f} with the picture"
            )
            hint = "Take the first three channels as they are: they are not multiplied by alpha."
            yield Violation.at(where, actual, "the colours", certainty="possible", hint=hint)
            return


def _seams(result: Picture, span: tuple[float, float]) -> str:
    """Return whether columns or rows of a uniform picture's result differ in stripes, or nothing."""
    height, width = result.shape[1:]
    inner = result[
        :,
        height // _BORDER : -(height // _BORDER) or None,
        width // _BORDER : -(width // _BORDER) or None,
    ]
    limit = _MIN_SEAM * (span[1] - span[0])
    for words, axis in (("columns", 1), ("rows", 2)):
        lines = inner.mean(axis=axis, keepdims=True)
        if float(np.abs(inner - lines).max(initial=0)) > limit / 10:
            continue
        steps = np.abs(np.diff(lines.reshape(3, -1), axis=1)).max(axis=0, initial=0)
        is_seam = steps > limit
        if (
            is_seam.any()
            and is_seam.mean() <= _MAX_SEAM_SHARE
            and not (steps[~is_seam] > limit / 10).any()
        ):
            return words
    return ""


def _violation(
    behaviour: Behaviour, actual: str, expected: str, correlation: float, hint: str = ""
) -> Violation:
    manifest = behaviour.subject.manifest
    assert isinstance(manifest, PostProcessManifest)
    return Violation.at(
        f"output {manifest.outputs.image.name}",
        actual,
        expected,
        certainty="possible",
        statistic=Statistic("correlation", correlation, _MIN_OTHER_CORRELATION, 1.0),
        hint=hint,
    )


def _shown_pictures(behaviour: Behaviour) -> Iterator[tuple[ProbeRun, Picture, Picture]]:
    """Yield the run with another gradient in each channel, its picture and its result."""
    from gsgen.contract.probing.picture_probes import CHANNEL_GRADIENTS

    runs = behaviour.trial_runs("pictures")
    yield from _pictures_of(
        behaviour, [run for run in runs if run.probe.label == CHANNEL_GRADIENTS]
    )


def _pictures_of(
    behaviour: Behaviour, runs: Iterable[ProbeRun]
) -> Iterator[tuple[ProbeRun, Picture, Picture]]:
    """Yield runs with the colours of picture and result, which is reduced to the picture's size."""
    manifest = behaviour.subject.manifest
    assert isinstance(manifest, PostProcessManifest)
    image = next(entry for entry in manifest.inputs if entry.role == "image")
    output = manifest.outputs.image
    for run in runs:
        picture, result = run.probe.inputs[image.name], run.outputs.get(output.name)
        if result is None or min(picture.shape[1], result.shape[1]) < 3:
            continue
        height, width = picture.shape[2:]
        blocks = result[0, :3].astype(np.float64)
        blocks = blocks.reshape(3, height, output.scale, width, output.scale)
        yield run, picture[0, :3].astype(np.float64), blocks.mean(axis=(2, 4))


def _lines_of_versions() -> dict[str, str]:
    """Return the lines that undo changes of pictures, by the words of :func:`_best_other_version`."""
    lines = {
        "upside down": "rows = rows.flip(2)",
        "mirrored": "rows = rows.flip(3)",
        "turned by half a turn": "rows = rows.flip(2, 3)",
    }
    for order in permutations(range(3)):
        name = " ".join("RGB"[channel] for channel in order)
        inverse = [order.index(channel) for channel in range(3)]
        lines[f"with channels in the order {name}"] = f"rows[:, :3] = rows[:, {inverse}]"
    return lines


def _correlation(first: Picture, second: Picture) -> float:
    """Return the correlation of two pictures over all channels, whose means are left out."""
    a, b = (image - image.mean(axis=(1, 2), keepdims=True) for image in (first, second))
    return float((a * b).sum() / max(float(np.sqrt((a * a).sum() * (b * b).sum())), _TINY))


def _best_other_version(picture: Picture, result: Picture) -> tuple[str, float]:
    """Return which change of the picture fits the result best, and how well."""
    shape = picture.shape
    versions = {
        "upside down": picture[:, ::-1],
        "mirrored": picture[:, :, ::-1],
        "turned by half a turn": picture[:, ::-1, ::-1],
        "transposed, with height and width exchanged": picture.swapaxes(1, 2).reshape(shape),
        "with channels written last": picture.transpose(1, 2, 0).reshape(shape),
        "with channels read last": picture.reshape(*shape[1:], 3).transpose(2, 0, 1),
    }
    for order in list(permutations(range(3)))[1:]:
        name = " ".join("RGB"[channel] for channel in order)
        versions[f"with channels in the order {name}"] = picture[list(order)]
    correlations = {words: _correlation(image, result) for words, image in versions.items()}
    return max(correlations.items(), key=lambda entry: entry[1])


def _best_shift(picture: Picture, result: Picture) -> tuple[tuple[int, int], float, float]:
    """Return by how many pixels down and right edges moved, and their correlation there and before.

    The edges of all channels are compared: the Laplacian of each picture.
    """
    a = _edges(picture)
    limit = float(np.abs(a).max())  # a border of another colour is one edge among others
    b = np.clip(_edges(result), -limit, limit)
    size = float(np.sqrt((a * a).sum() * (b * b).sum()))
    spectrum = (np.conj(np.fft.rfft2(a)) * np.fft.rfft2(b)).sum(axis=0)
    correlations = np.fft.irfft2(spectrum, a.shape[1:]) / max(size, _TINY)
    reach = range(-_MAX_SHIFT, _MAX_SHIFT + 1)
    height, width = a.shape[1:]
    down, right = (np.array([s for s in reach if 2 * abs(s) < side]) for side in (height, width))
    window = correlations[np.ix_(down % height, right % width)]
    row, column = np.unravel_index(int(window.argmax()), window.shape)
    shift = (int(down[row]), int(right[column]))
    return shift, float(window[row, column]), float(correlations[0, 0])


def _edges(image: Picture) -> Float[np.ndarray, "3 i j"]:
    return np.asarray(
        4 * image[:, 1:-1, 1:-1]
        - image[:, :-2, 1:-1]
        - image[:, 2:, 1:-1]
        - image[:, 1:-1, :-2]
        - image[:, 1:-1, 2:]
    )
