"""Rules of outputs (GO): names, shapes and dtypes of the packed layout, checked without a run."""

from collections.abc import Iterator
from typing import Final

from gsgen.contract.model.graph import Tensor
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.spec.layout import APPEARANCE_CHANNELS, ITEMSIZE, ROW_LENGTH, WORD_BYTES
from gsgen.contract.spec.manifest import AppearanceOutput
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.spherical_harmonics import degree_of
from gsgen.contract.validation.finding import Violation, line_hint, set_hint, size_hint
from gsgen.contract.validation.gates import DECLARATION_RULES
from gsgen.contract.validation.rule import rule

COLUMN_MEANINGS: Final = {
    7: "x y z, opacity and three scales without a rotation",
    11: "x y z, opacity, three scales and a quaternion",
    13: "x y z, opacity and the full matrix of nine covariances",
    14: "x y z, colour, opacity, three log scales and a quaternion of a PLY",
    59: "x y z, SH, opacity, three log scales and a quaternion of a PLY",
    62: "x y z, normal, SH, opacity, three log scales and a quaternion of a PLY",
}
"""What rows of another width usually hold, by their columns."""


def _dim_of_axis(tensor: Tensor | None, axis: int) -> int | str | None:
    return tensor.dims[axis] if tensor is not None and tensor.dims else None


@rule("GO001", Severity.ERROR, needs=DECLARATION_RULES)
def gaussians_declared(subject: InspectedModel) -> Iterator[Violation]:
    """The manifest declares one output that holds the packed Gaussians.

    Why:
        It is what a generator is for. Viewers that do not find it fall back to two million rows of
        nothing.

    Hint:
        Return one [N, 10] tensor and declare it as outputs.gaussians.
    """
    if subject.gaussians is not None:
        return
    outputs = ", ".join(str(tensor) for tensor in subject.graph.outputs) or "nothing"
    actual, expected = f"no packed Gaussians among {outputs}", f"one [N, {ROW_LENGTH}] output"
    yield Violation.at("outputs", actual, expected, hint=_role_hint(subject, "gaussians"))


def _role_hint(subject: InspectedModel, role: str) -> str:
    """Return the hint to declare the graph's output that has the name and the shape of a role.

    Three channels may be RGB or SH, so they are not guessed.
    """
    from gsgen.contract.model.manifest_inference import infer_manifest
    from gsgen.contract.spec.fields.json_schema import to_json

    entry = getattr(infer_manifest(subject.graph, "").manifest.outputs, role)
    declared = [
        output.name for output in (subject.gaussians, subject.appearance, subject.count) if output
    ]
    is_free = entry is not None and entry.name not in declared
    is_free = is_free and (role != "appearance" or entry.space == "sh")
    return set_hint(f"outputs.{role}", to_json(entry)) if is_free else ""


@rule("GO002", Severity.ERROR, needs=("GO001", "GO003"))
def gaussian_row_has_10(subject: InspectedModel) -> Iterator[Violation]:
    """The last dimension of the packed Gaussians is the static number 10.

    Why:
        A row is x y z opacity xx xy xz yy yz zz. A reader that steps by ten through rows of nine
        mixes positions with covariances.

    Hint:
        Pack all ten fields: the covariance is R S Sᵀ Rᵀ of scales and quaternion, and opacity comes
        after its sigmoid. The SDK packs for you.
    """
    tensor = subject.gaussians
    if tensor is not None and _dim_of_axis(tensor, -1) != ROW_LENGTH:
        expected = f"[N, {ROW_LENGTH}]" + _likely_columns(tensor)
        yield Violation.at(f"output {tensor.name}", f"shape {tensor}", expected)


def _likely_columns(tensor: Tensor) -> str:
    """Return the likely meaning of packed rows that are not ten wide, as text; empty if unknown."""
    columns = _dim_of_axis(tensor, -1)
    if _dim_of_axis(tensor, 0) == ROW_LENGTH:
        return "; this one is transposed, channels first"
    if isinstance(columns, int) and columns in COLUMN_MEANINGS:
        return f"; {columns} columns usually are {COLUMN_MEANINGS[columns]}"
    return ""


@rule("GO003", Severity.ERROR, needs=("GO001",))
def gaussians_rank_2(subject: InspectedModel) -> Iterator[Violation]:
    """The packed Gaussians are a tensor of rank 2, without a batch axis.

    Why:
        Readers take the first dimension as the capacity: [1, N, 10] is read as one Gaussian.

    Hint:
        Drop the batch axis; reshape flattened rows to [N, 10].
    """
    tensor = subject.gaussians
    if tensor is not None and (tensor.dims is None or len(tensor.dims) != 2):
        is_rank_1 = tensor.dims is not None and len(tensor.dims) == 1
        expected = "two axes, [N, 10]" + ("; these rows are flattened" if is_rank_1 else "")
        yield Violation.at(f"output {tensor.name}", f"shape {tensor}", expected)


@rule("GO004", Severity.ERROR, needs=("GO001", "GO003"))
def capacity_static(subject: InspectedModel) -> Iterator[Violation]:
    """The outputs of Gaussians and colours have static sizes: positive numbers, not symbols.

    Why:
        Viewers allocate buffers from it before the first frame: a symbol becomes NaN bytes. Graph
        capture needs fixed shapes too.

    Hint:
        Export with a fixed capacity (without dynamic_axes or dynamic_shapes), fill it with inert
        rows, and return the count in num_points.
    """
    tensor = subject.gaussians
    first = _dim_of_axis(tensor, 0)
    if tensor is not None and not (isinstance(first, int) and first > 0):
        yield Violation.at(
            f"output {tensor.name}",
            f"shape {tensor}",
            "a fixed, positive number of rows",
            hint=_rows_hint(subject, tensor.name),
        )
        return
    names = [part.name for part in (tensor, subject.appearance) if part is not None]
    for declared in subject.graph.declared_outputs:
        if declared.name in names and not all(isinstance(d, int) for d in declared.dims or ()):
            expected = "static sizes in place of symbols, although they can be inferred"
            hint = _rows_hint(subject, declared.name)
            yield Violation.at(f"output {declared.name}", f"shape {declared}", expected, hint=hint)


def _rows_hint(subject: InspectedModel, name: str) -> str:
    """Return the hint to give an output's symbolic number of rows the declared capacity."""
    declared = subject.declared_gaussians
    symbols = [t.dims[0] for t in subject.graph.declared_outputs if t.name == name and t.dims]
    if declared is None or subject.candidate is not None or not symbols:
        return ""
    symbol = symbols[0]
    if not isinstance(symbol, str) or not symbol:
        return ""
    size = size_hint(symbol, declared.capacity)
    return (
        "Export with a fixed capacity, fill it with inert rows, and return the count in num_points. "
        f"If the rows are always {declared.capacity}: {size}"
    )


@rule("GO005", Severity.ERROR, needs=DECLARATION_RULES)
def appearance_declared(subject: InspectedModel) -> Iterator[Violation]:
    """The manifest declares one output that holds the appearance (colours) of the Gaussians.

    Why:
        Without it there is no colour to draw.

    Hint:
        Return SH coefficients or RGB and declare them as outputs.appearance.
    """
    if subject.appearance is None:
        expected = "one [N, channels] output"
        yield Violation.at(
            "outputs", "no appearance", expected, hint=_role_hint(subject, "appearance")
        )


@rule("GO006", Severity.ERROR, needs=("GO005",))
def appearance_channels(subject: InspectedModel) -> Iterator[Violation]:
    """The appearance is [N, C] with a channel count C that the declared colour format allows.

    Why:
        Readers step through the buffer by C: 3 or 4 for RGB, 3, 12, 27 or 48 for SH. Any other
        number shows colours of neighbouring rows.

    Hint:
        Concatenate f_dc and f_rest of a PLY, pad SH to the next degree with zeros, and RGB to four
        channels with ones; reshape [N, K, 3] to [N, 3K].
    """
    tensor, declared = subject.appearance, subject.declared_appearance
    if tensor is None or declared is None:
        return
    allowed_channels = APPEARANCE_CHANNELS[declared.space]
    channels = _dim_of_axis(tensor, -1)
    if tensor.dims is None or len(tensor.dims) != 2 or channels not in allowed_channels:
        expected = f"[N, C] with C in {list(allowed_channels)} for {declared.space}"
        if (
            declared.space == "sh"
            and isinstance(channels, int)
            and channels + 3 in allowed_channels
        ):
            expected += f"; {channels} is f_rest without the constant term f_dc"
        elif tensor.dims is not None and len(tensor.dims) == 3:
            expected += "; reshape the last two axes into one"
        others = [
            s for s, sizes in APPEARANCE_CHANNELS.items() if channels in sizes and channels > 4
        ]
        hint = ""
        if declared.space == "rgb" and others == ["sh"] and isinstance(channels, int):
            degree = set_hint("outputs.appearance.degree", degree_of(channels // 3))
            hint = f"{set_hint('outputs.appearance.space', 'sh')} {degree}"
        elif isinstance(channels, int) and channels + 3 not in allowed_channels:
            hint = _cut_hint(declared, channels)
        yield Violation.at(f"output {tensor.name}", f"shape {tensor}", expected, hint=hint)


def _cut_hint(declared: AppearanceOutput, channels: int) -> str:
    """Return the hint to leave out the channels beyond those of a format; empty for too few."""
    fitting = [size for size in APPEARANCE_CHANNELS[declared.space] if size < channels]
    if not fitting:
        return ""
    kept = fitting[0] if declared.space == "rgb" else fitting[-1]
    hint = f"If the others are no colours: {line_hint(f'rows = rows[:, :{kept}]')}"
    degree = degree_of(kept // 3)
    if declared.space == "rgb" or declared.degree == degree:
        return hint
    return f"{hint} {set_hint('outputs.appearance.degree', degree)}"


@rule("GO007", Severity.ERROR, needs=("GO004", "GO006"))
def appearance_rows(subject: InspectedModel) -> Iterator[Violation]:
    """The appearance (colour) output has as many rows as the output of packed Gaussians.

    Why:
        Row i of one belongs to row i of the other; a shorter buffer is read beyond its end.

    Hint:
        Pad both outputs to the same capacity.
    """
    tensor, rows = subject.appearance, _dim_of_axis(subject.gaussians, 0)
    row_count = _dim_of_axis(tensor, 0)
    if tensor is not None and isinstance(rows, int) and row_count != rows:
        hint = "Pad both outputs to the same capacity."
        if isinstance(row_count, int):
            missing = f"rows.new_zeros({rows - row_count}, rows.shape[1])"
            fill = f"torch.cat([rows, {missing}])" if rows > row_count else f"rows[:{rows}]"
            hint += f" {line_hint(f'rows = {fill}')}"
        yield Violation.at(f"output {tensor.name}", f"{row_count} rows", f"{rows} rows", hint=hint)


@rule("GO008", Severity.ERROR, needs=("GO001", "GO005"))
def output_dtype(subject: InspectedModel) -> Iterator[Violation]:
    """Gaussians, appearance and cells (groups of Gaussians) are float32 or float16.

    Why:
        Shaders read these two. Integers would need a scale that readers do not apply, and WebGPU
        has neither float64 nor bfloat16.

    Hint:
        End the output on a cast to float32 or float16.
    """
    for tensor in (subject.gaussians, subject.appearance, subject.cells):
        if tensor is not None and tensor.dtype not in ITEMSIZE:
            hint = "Divide the bytes by 255 in float32." if tensor.dtype == "uint8" else ""
            yield Violation.at(
                f"output {tensor.name}", str(tensor.dtype), "float32 or float16", hint=hint
            )


@rule("GO009", Severity.WARNING, needs=("GO008",))
def output_dtypes_match(subject: InspectedModel) -> Iterator[Violation]:
    """The appearance (colour) output has the dtype of the output of packed Gaussians.

    Why:
        The Visionary viewer takes the colour's precision from the Gaussians and fails with
        "Unexpected output data type"; others need a second shader.

    Hint:
        Cast both to the same dtype.
    """
    rows, color = subject.gaussians, subject.appearance
    if rows is not None and color is not None and rows.dtype != color.dtype:
        yield Violation.at(
            f"output {color.name}", str(color.dtype), f"{rows.dtype}, as {rows.name}"
        )


@rule("GO015", Severity.ERROR, needs=("GO002", "GO006", "GO008"))
def rows_fill_words(subject: InspectedModel) -> Iterator[Violation]:
    """A row of each output takes a whole number of 4-byte words.

    Why:
        Shaders read storage buffers in words. A float16 row of three colours is six bytes, so
        every second row starts in the middle of a word and six of eight rows show wrong colours.

    Hint:
        Pad float16 RGB to four channels, and SH to 12 or 48 channels.
    """
    for tensor in (subject.gaussians, subject.appearance):
        channels = _dim_of_axis(tensor, -1)
        if tensor is None or not isinstance(channels, int):
            continue
        size = channels * ITEMSIZE.get(tensor.dtype or "", WORD_BYTES)
        if size % WORD_BYTES:
            actual = f"{channels} channels of {tensor.dtype}, {size} bytes a row"
            yield Violation.at(f"output {tensor.name}", actual, f"a multiple of {WORD_BYTES} bytes")


@rule("GO010", Severity.ERROR, needs=DECLARATION_RULES)
def count_declared(subject: InspectedModel) -> Iterator[Violation]:
    """The manifest declares an output that holds the number of live Gaussians (rows in use).

    Why:
        Runtimes fetch it every frame; without it the fetch fails ("Invalid output name").

    Hint:
        Return an int32 [1] tensor, a constant where nothing varies, and declare it as outputs.count.
    """
    if subject.count is None:
        expected = "one int32 [1] output, usually num_points"
        hint = _role_hint(subject, "count") or _count_hint(subject)
        yield Violation.at("outputs", "no row count", expected, hint=hint)


def _count_hint(subject: InspectedModel) -> str:
    """Return the hint to return the capacity as the count; empty if an output has its name."""
    rows, declared = subject.gaussians, subject.declared_gaussians
    has_name = any(tensor.name == "num_points" for tensor in subject.graph.outputs)
    if rows is None or declared is None or has_name:
        return ""
    count = f"torch.full_like({rows.name}[:1, 0], {declared.capacity}, dtype=torch.int32)"
    entry = set_hint("outputs.count", {"name": "num_points"})
    return f"If all rows are live: {line_hint(f'num_points = {count}')} Return it, too. {entry}"


@rule("GO011", Severity.ERROR, needs=("GO010",))
def count_is_int32(subject: InspectedModel) -> Iterator[Violation]:
    """The output with the row count (number of Gaussians) is int32 with the static shape [1].

    Why:
        Runtimes bind four bytes to it. An int64 count is refused ("Unexpected output data type"),
        and a scalar has another rank than the buffer.

    Hint:
        Cast the count to int32 and reshape it to [1]; `gsgen explain GG016` says in which order.
    """
    tensor = subject.count
    if tensor is not None and (tensor.dtype != "int32" or tensor.dims != (1,)):
        yield Violation.at(f"output {tensor.name}", str(tensor), "int32 [1]")
