"""Rules of binding (TV): predict how the Visionary web viewer 1.0.1 binds inputs and outputs.

Only these rules look at parts of tensor names, because the viewer does.
Source: its ``onnx_gpu_io.ts`` and ``preprocess.wgsl``, version 1.0.1.
"""

from collections.abc import Iterator

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation, line_hint, rename_hint, set_hint
from gsgen.contract.validation.rule import rule

# The name of the viewer's target.
TARGET = "visionary"
_COLOR_OUTPUT_WORDS = ("color", "sh", "rgb")
_COLOR_CHANNELS = (3, 4, 12, 27, 48)
_SH_CHANNELS = 48


_BOUND_NAMES = {"view": "camera", "projection": "proj", "time": "time"}


def bound_role(name: str) -> str:
    """Return the input role that the Visionary viewer feeds to an input ``name``, or ""."""
    lower = name.lower()
    if any(word in lower for word in ("camera", "view", "matrix")):
        return "view"
    if "time" in lower or name == "t":
        return "time"
    return "projection" if "proj" in lower else ""


@rule("TV101", Severity.ERROR, target=TARGET, needs=("GO001",))
def visionary_finds_gaussians(subject: InspectedModel) -> Iterator[Violation]:
    """The Gaussian output is the first output whose name starts with `gauss`, as Visionary expects.

    Why:
        The viewer takes the first output with that prefix, in lower case, and falls back to
        2,000,000 rows without one.

    Hint:
        Call it gaussians, as `gsgen fix MODEL --rename -o COPY` does, and list it first.
    """
    tensor = subject.gaussians
    first_match = next((t.name for t in subject.graph.outputs if t.name.startswith("gauss")), None)
    if tensor is not None and first_match != tensor.name:
        actual = f"the viewer takes {first_match!r}" if first_match else "the viewer finds none"
        yield Violation.at(
            f"output {tensor.name}", actual, "a name that starts with 'gauss', first"
        )


@rule("TV102", Severity.ERROR, target=TARGET, needs=("GO005", "TV101"))
def visionary_finds_color(subject: InspectedModel) -> Iterator[Violation]:
    """The appearance (colours) is the first output whose name contains `color`, `sh` or `rgb`.

    Why:
        An earlier output such as `mesh` or `shift` with a fitting last dimension is taken instead.

    Hint:
        Call it color_sh or color_rgb, as `gsgen fix MODEL --rename -o COPY` does, and list it before
        other outputs.
    """
    tensor = subject.appearance
    candidates = [
        t.name
        for t in subject.graph.outputs
        if any(word in t.name for word in _COLOR_OUTPUT_WORDS)
        and t.dims
        and t.dims[-1] in _COLOR_CHANNELS
    ]
    first_match = candidates[0] if candidates else None
    if tensor is not None and first_match != tensor.name:
        actual = f"the viewer takes {first_match!r}" if first_match else "the viewer finds none"
        yield Violation.at(
            f"output {tensor.name}", actual, "a name with 'color', 'sh' or 'rgb', first"
        )


@rule("TV103", Severity.ERROR, target=TARGET, needs=("GM004", "GI005"))
def visionary_binds_inputs(subject: InspectedModel) -> Iterator[Violation]:
    """The Visionary viewer feeds every input, with the data of the input's declared role.

    Why:
        The viewer tests for `camera`, `view` and `matrix` before `proj`: an input called
        projection_matrix receives the view matrix. Inputs that match nothing are never fed, and
        inference fails.

    Hint:
        Call them camera, proj and time; bake other inputs in before export. In place of the camera
        position, take inputs.view() and compute gsgen.sdk.math.camera_centre(view).
    """
    for entry in subject.manifest.inputs if subject.manifest else ():
        viewer_role = bound_role(entry.name)
        if viewer_role != entry.role:
            actual = f"will receive the {viewer_role}" if viewer_role else "will never be fed"
            hint = _name_hint(entry.name, entry.role)
            where, expected = f"input {entry.name}", f"the {entry.role}"
            yield Violation.at(where, actual, expected, hint=hint)


def _name_hint(name: str, role: str) -> str:
    new_name = _BOUND_NAMES.get(role)
    return rename_hint(name, new_name) if new_name else ""


@rule("TV104", Severity.ERROR, target=TARGET, needs=("GO006", "GO008", "GM005"))
def visionary_reads_color(subject: InspectedModel) -> Iterator[Violation]:
    """The appearance is SH with 48 channels or float16 RGB with 4, as Visionary reads it.

    Why:
        The shader's row strides are fixed for these two. All other layouts are accepted and drawn
        with the colours of neighbouring rows.

    Hint:
        Emit SH of degree 3 or float16 RGB with four channels.
    """
    tensor, declared = subject.appearance, subject.declared_appearance
    if tensor is None or declared is None or not tensor.dims:
        return
    channels = tensor.dims[-1]
    if declared.space == "sh" and channels != _SH_CHANNELS:
        hint, rows = "", tensor.dims[0]
        if isinstance(channels, int) and isinstance(rows, int) and channels < _SH_CHANNELS:
            zeros = f"torch.zeros({rows}, {_SH_CHANNELS - channels}, dtype=rows.dtype)"
            line = line_hint(f"rows = torch.cat([rows, {zeros}], 1)")
            hint = f"Pad SH with zeros. {line} {set_hint('outputs.appearance.degree', 3)}"
        actual = f"SH with {channels} channels"
        yield Violation.at(f"output {tensor.name}", actual, "48 channels", hint=hint)
    if declared.space == "rgb" and (channels, tensor.dtype) != (4, "float16"):
        actual = f"RGB as {tensor.dtype} with {channels} channels"
        hint = _half_hint(subject, channels)
        yield Violation.at(f"output {tensor.name}", actual, "float16 with 4 channels", hint=hint)


def _half_hint(subject: InspectedModel, channels: int | str | None) -> str:
    """Return the hint to pad RGB to four channels, and to cast both outputs to float16."""
    rows = subject.gaussians
    if channels not in (3, 4) or rows is None:
        return ""
    four = "torch.cat([rows, rows[:, :1] * 0 + 1], 1)" if channels == 3 else "rows"
    lines = f"rows = {four}.to(torch.float16)", f"{rows.name} = {rows.name}.to(torch.float16)"
    return " ".join([*map(line_hint, lines), set_hint("outputs.gaussians.dtype", "float16")])


@rule("TV108", Severity.WARNING, target=TARGET, needs=("GM004",))
def visionary_time_range(subject: InspectedModel) -> Iterator[Violation]:
    """The declared time range is 0 to 1, which the Visionary viewer feeds.

    Why:
        The viewer feeds (timeline · 0.4) mod 1, regardless of the manifest.

    Hint:
        Scale time inside the model, so that its range is [0, 1].
    """
    for entry, _ in subject.inputs_of("time"):
        if entry.range is not None and entry.range != (0.0, 1.0):
            low, high = entry.range
            line = line_hint(
                f"{entry.name} = {low:.9g} + {entry.name} * {high - low:.9g}", first=True
            )
            is_mended = entry.default in (None, "zeros", 0.0)  # another default needs a number, too
            range_hint = set_hint(f"{subject.path_of(entry)}.range", [0, 1])
            hint = f"{line} {range_hint}" if is_mended else ""
            yield Violation.at(f"input {entry.name}", f"range {[low, high]}", "[0, 1]", hint=hint)
