"""Repairs a model file: only faults with one right repair, each validated and listed."""

__all__ = ["Repair", "RepairRequest", "RepairResult", "repair"]

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import onnx_ir as ir
from onnx_ir import passes
from onnx_ir.passes.common import NameFixPass

from gsgen.contract.errors import GsgenError, UnknownName
from gsgen.contract.model.inspected_model import InspectedModel, inspect_model
from gsgen.contract.model.model_file import MANIFEST_KEY, NEUTRAL_KEY, declared_opset, open_model
from gsgen.contract.model.versions import lowest_ir_version, operators_changed_since
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.process.drafts import temporary_folder
from gsgen.contract.spec.manifest import GeneratorManifest, TestVector, VectorRows
from gsgen.contract.spec.manifest_io import dumps
from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.sdk.authoring.output_names import APPEARANCE_RGB, APPEARANCE_SH, COUNT_OUTPUT, GAUSSIANS
from gsgen.sdk.exporting.embed_manifest import with_profile
from gsgen.sdk.passes import (
    CastCountOutput,
    PadColor,
    PinDimensions,
    RenameOutputs,
    ReorderHarmonics,
    SilencePadding,
)
from gsgen.sdk.rewriting.model_io import (
    has_external_weights,
    load_model,
    refuse_overwriting,
    save_model,
)
from gsgen.sdk.rewriting.rule_regression import refuse_new_violations


@dataclass(frozen=True, slots=True)
class RepairRequest:
    """The user's choices for repairing a model file: facts that it lacks, optional repairs."""

    sizes: Mapping[str, int] = field(default_factory=dict)  # symbolic dimension → its size
    manifest: GeneratorManifest | None = None  # the manifest to embed; the model's own if absent
    rename: bool = False  # whether to give the outputs the names that viewers look for
    # whether the SH are stored channel by channel, so that they are reordered
    channel_major: bool = False


@dataclass(frozen=True, slots=True)
class Repair:
    """One repair of a model file, and the id of the rule that requires it."""

    description: str
    rule: str


@dataclass(frozen=True, slots=True)
class RepairResult:
    """The repairs of a model file, with its validation reports before and after them."""

    repairs: tuple[Repair, ...]  # the changes, in order
    before: Report  # the report on the source
    after: Report  # the report on the repaired model


def repair(
    source: Path,
    target: Path | None,
    request: RepairRequest | None = None,
    settings: Settings | None = None,
) -> RepairResult:
    """Write a repaired copy of a model file, with unambiguous repairs only.

    Without ``target``, the copy is repaired and validated, but not written.
    """
    request, settings = request or RepairRequest(), settings or Settings()
    before = validate(source, settings)
    subject = inspect_model(open_model(source), settings.target, settings.limits)
    if target is not None:
        refuse_overwriting(subject.file, target)
    violated_rules = {finding.rule for finding in before.findings}
    repair_steps = _version_steps(subject) if "GG001" in violated_rules else []
    manifest = request.manifest
    if manifest is None and (subject.parsed is not None or not repair_steps):
        manifest = _embedded_manifest(subject)
    if manifest is not None:
        steps, manifest = _repair_steps(subject, manifest, violated_rules, request)
        repair_steps += steps
    if request.manifest is not None:
        repair_steps.append((Repair("embedded the given manifest", "GM001"), lambda _: None))
    if not repair_steps:
        raise GsgenError(
            "the model has no fault that gsgen can repair without guessing",
            where=str(source),
            hint=f"`gsgen validate {source}` lists its faults.",
        )
    model = load_model(source)
    _check_symbols(model, request.sizes)
    external_weights = has_external_weights(model)
    for _, change in repair_steps:
        change(model)
    NameFixPass()(model)
    if manifest is not None:
        model.metadata_props.pop(NEUTRAL_KEY, None)
        if manifest.operator_profile is not None:
            manifest = with_profile(manifest, model)
        model.metadata_props[MANIFEST_KEY] = dumps(manifest, indent=None)
    with _copy_to_draft(target, source) as draft:
        save_model(model, draft, external_weights=external_weights)
        after = validate(draft, settings)
        refuse_new_violations(before, after, "repaired")
    return RepairResult(
        tuple(step for step, _ in repair_steps), before, replace(after, path=str(target or source))
    )


@contextmanager
def _copy_to_draft(target: Path | None, source: Path) -> Iterator[Path]:
    """Yield a temporary path for the repaired model, which is renamed at the end or deleted."""
    if target is not None:
        with atomic_write(target) as draft:
            yield draft
        return
    with temporary_folder() as folder:
        yield folder / source.name


def _check_symbols(model: ir.Model, sizes: Mapping[str, int]) -> None:
    ends = (*model.graph.inputs, *model.graph.outputs)
    dims = (dim for value in ends if value.shape is not None for dim in value.shape)
    known = {dim.value for dim in dims if isinstance(dim, ir.SymbolicDim) and dim.value}
    for name in sizes.keys() - known:
        raise UnknownName.among("dimension", name, known, "--size")


RepairPass = Callable[[ir.Model], passes.PassResult | None]
RepairSteps = list[tuple[Repair, RepairPass]]


def _embedded_manifest(subject: InspectedModel) -> GeneratorManifest:
    if subject.parsed is None:
        raise GsgenError(
            "the model has no manifest, so the meaning of its outputs is unknown",
            where=str(subject.file.path),
            hint="Derive one with `gsgen inspect MODEL --emit-manifest`, check it, and give it "
            "with --manifest FILE.",
        )
    if not isinstance(subject.manifest, GeneratorManifest):
        hint = "See `gsgen validate --level static`."
        raise GsgenError(
            "the model is not a Gaussian Generator", where=str(subject.file.path), hint=hint
        )
    return subject.manifest


def _version_steps(subject: InspectedModel) -> RepairSteps:
    """Return the repairs that lower the declared versions, where the model means the same."""
    proto, target = subject.file.proto, subject.target
    steps: RepairSteps = []
    opset, highest_opset = declared_opset(proto), target.opset[1]
    if opset is not None and opset > highest_opset:
        if operators_changed_since(proto, highest_opset):
            return []
        repair = Repair(f"operator set {opset} is declared as {highest_opset}", "GG001")
        steps.append((repair, partial(_declare_opset, opset=highest_opset)))
    needed = lowest_ir_version(proto, target.ir)
    if proto.ir_version > target.ir and (needed <= target.ir or steps):
        version = min(needed, target.ir)
        repair = Repair(f"IR version {proto.ir_version} is declared as {version}", "GG001")
        steps.append((repair, partial(_declare_ir_version, version=version)))
    return steps


def _declare_opset(model: ir.Model, opset: int) -> None:
    opset_imports = [
        model.opset_imports,
        *(entry.opset_imports for entry in model.functions.values()),
    ]
    for versions in opset_imports:
        versions.update({domain: opset for domain in MAIN_DOMAIN if domain in versions})


def _declare_ir_version(model: ir.Model, version: int) -> None:
    model.ir_version = version


def _repair_steps(
    subject: InspectedModel,
    manifest: GeneratorManifest,
    violated_rules: set[str],
    request: RepairRequest,
) -> tuple[RepairSteps, GeneratorManifest]:
    """Return the repairs of a model in order, and the manifest of the repaired model."""
    repair_steps: RepairSteps = []
    outputs = manifest.outputs
    rows, color, count = outputs.gaussians, outputs.appearance, outputs.count
    for symbol, size in request.sizes.items():
        repair_steps.append(
            (Repair(f"dimension {symbol} is {size}", "GO004"), PinDimensions({symbol: size}))
        )
    if count is not None and "GO011" in violated_rules:
        repair_steps.append(
            (Repair(f"{count.name} is cast to int32 [1]", "GO011"), CastCountOutput(count.name))
        )
    if color is not None and color.space == "rgb" and "GO015" in violated_rules:
        description = f"{color.name} is padded to four channels"
        repair_steps.append((Repair(description, "GO015"), PadColor(color.name)))
    if color is not None and request.channel_major:
        description = f"{color.name} is reordered to coefficient-major"
        repair_steps.append((Repair(description, "GV014"), ReorderHarmonics(color.name)))
        order = partial(_with_coefficients_first, name=color.name)
        manifest = replace(manifest, test_vectors=_changed_records(manifest, order))
    if rows and color and count and violated_rules & {"GV002", "GV018"}:
        silence_padding = SilencePadding((rows.name, color.name), count.name)
        repair_steps.append(
            (Repair("packed Gaussians behind the count are zero", "GV018"), silence_padding)
        )
    if rows and color and count and request.rename:
        color_name = APPEARANCE_SH if color.space == "sh" else APPEARANCE_RGB
        names = {rows.name: GAUSSIANS, color.name: color_name, count.name: COUNT_OUTPUT}
        changed = ", ".join(f"{old} → {new}" for old, new in names.items() if old != new)
        listed = [tensor.name for tensor in subject.graph.outputs][: len(names)]
        words = [f"renamed: {changed}"] if changed else []
        words += [] if listed == list(names) else ["listed first"]
        if words:
            description = f"outputs are {', and '.join(words)}"
            repair_steps.append((Repair(description, "TV101"), RenameOutputs(names)))
            rename = partial(_with_new_name, names=names)
            manifest = replace(manifest, test_vectors=_changed_records(manifest, rename))
            outputs = replace(
                outputs,
                gaussians=replace(rows, name=GAUSSIANS),
                appearance=replace(color, name=color_name),
                count=replace(count, name=COUNT_OUTPUT),
            )
    return repair_steps, replace(manifest, outputs=outputs)


def _changed_records(
    manifest: GeneratorManifest, change: Callable[[VectorRows], VectorRows]
) -> tuple[TestVector, ...]:
    """Return the test vectors with their recorded rows changed as the outputs of the graph are."""
    return tuple(
        replace(vector, outputs=tuple(map(change, vector.outputs)))
        for vector in manifest.test_vectors
    )


def _with_new_name(rows: VectorRows, names: Mapping[str, str]) -> VectorRows:
    return replace(rows, output=names.get(rows.output, rows.output))


def _with_coefficients_first(rows: VectorRows, name: str) -> VectorRows:
    """Return recorded rows R… G… B… as RGB RGB …, if they are those of the named output."""
    if rows.output != name:
        return rows
    values = [(row, len(row) // 3) for row in rows.values]
    return replace(
        rows, values=tuple(tuple(v for k in range(n) for v in row[k::n]) for row, n in values)
    )
