"""Runs a torch generator at test inputs, and describes it: the first step of its export."""

__all__ = ["BOUNDS_PROBES", "PreparedExport", "default_dtype", "manifest_of", "prepare_export"]

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import chain
from typing import Literal

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.fields.roles import ROLES
from gsgen.contract.spec.manifest import (
    AppearanceOutput,
    Bounds,
    CellsOutput,
    CountOutput,
    GaussiansOutput,
    GeneratorManifest,
    GeneratorOutputs,
    Producer,
    Tolerances,
)
from gsgen.sdk.authoring.generator import GaussianGenerator
from gsgen.sdk.authoring.output_names import (
    APPEARANCE_RGB,
    APPEARANCE_SH,
    CELLS_OUTPUT,
    COUNT_OUTPUT,
    GAUSSIANS,
)
from gsgen.sdk.authoring.packed_module import check_whole_cells
from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.exporting.eager_reference import (
    EagerRuns,
    Reference,
    measure_bounds,
    run_eager,
    run_watched,
)
from gsgen.sdk.exporting.frame_size import check_fits, describe_size
from gsgen.sdk.exporting.pipeline import Dtype, ExportOptions, probes_of
from gsgen.sdk.exporting.sh_degrees import HALF_RGB
from gsgen.sdk.exporting.tracing.hazards import HazardWatch

# Probes of the measured bounds besides the all-zero one, and the most that are compared.
BOUNDS_PROBES = 8
# Distances of the cameras of the SDK's own probes, as a share of those of the contract's probes.
_DISTANCE_FACTORS = {"close": 0.2, "far": 8.0}
_DEFAULT_TOLERANCES = Tolerances()


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedExport:
    """A torch generator, its manifest, and the results of its runs in eager torch."""

    generator: GaussianGenerator
    manifest: GeneratorManifest  # what the first run and the declarations say
    references: EagerRuns  # results at the contract's probes, and at probes far from them
    recordable: range  # the probes of ``references`` whose rows may be recorded
    example: Probe  # the inputs to trace with
    watch: HazardWatch  # the hazards of the first run


def default_dtype(generator: GaussianGenerator, target: str) -> Dtype:
    """Return the default output dtype: float32, unless the target viewer reads RGB as float16."""
    if target not in HALF_RGB:
        return "float32"
    probe = probes_of(manifest_of(generator, "", "float32"), count=BOUNDS_PROBES)[0]
    return "float32" if run_eager(generator, probe).gaussians.rgb is None else "float16"


def prepare_export(
    generator: GaussianGenerator,
    options: ExportOptions,
    *,
    dtype: Dtype,
    stored_dtype: Dtype,
    capacity: int | None,
    compared: int,
    samples: Sequence[Mapping[str, np.ndarray]] = (),
) -> PreparedExport:
    """Run a torch generator in eager mode, and describe it by its declarations and its outputs.

    Args:
        generator: The module.
        options: Name and target.
        dtype: The dtype of the outputs when the module is traced.
        stored_dtype: The dtype of the outputs in the end.
        capacity: Rows of the outputs; as many as there are Gaussians if absent.
        compared: How many of the probes are compared, besides the all-zero one.
        samples: Further inputs to compare at.
    """
    sample_probes = _probes_of_samples(generator, samples)
    # Step 1: one run; the bounds are not known yet, so its probes lie around the default bounds.
    first_probes = probes_of(manifest_of(generator, options.name, dtype), count=BOUNDS_PROBES)
    start_time = time.perf_counter()
    start, watch = run_watched(generator, first_probes[0])
    seconds = time.perf_counter() - start_time
    # Step 2: the outputs, and their size.
    manifest = _with_outputs(generator, options.name, dtype, start, capacity)
    check_fits(generator, manifest, options.target, stored_dtype)
    runs = 3 * BOUNDS_PROBES + 2 * compared
    if size := describe_size(manifest, stored_dtype, seconds=seconds, runs=runs):
        options.progress(size)
    # Step 3: the bounds.
    first_runs = EagerRuns(generator, first_probes, [start])
    manifest = replace(manifest, bounds=measure_bounds(first_runs))
    references, example, recordable = first_runs, first_probes[0], len(first_runs)
    if generator.inputs:
        # Cameras orbit the bounds, so they are placed a second time, around the measured bounds.
        bounds_runs = first_runs.with_probes(probes_of(manifest, count=BOUNDS_PROBES))
        all_runs = first_runs if bounds_runs.has_inputs_of(first_runs) else bounds_runs
        manifest = replace(manifest, bounds=measure_bounds(chain(first_runs, all_runs)))
        # Bounds need every probe that the validator has; a quick comparison takes some of them.
        indices = np.linspace(1, len(all_runs) - 1, compared).round().astype(int)
        # Networks divide by the contrast of a picture: at zero, rounding decides their results.
        has_pictures = any(entry.role == "image" for entry in generator.inputs)
        compared_indices = indices if has_pictures else (0, *indices)
        compared_probes = [all_runs.probes[index] for index in compared_indices]
        recordable = len(compared_probes)
        references = all_runs.with_probes(
            [*compared_probes, *_far_camera_probes(manifest), *sample_probes]
        )
        example = all_runs.probes[1]
    return PreparedExport(
        generator=generator,
        manifest=manifest,
        references=references,
        recordable=range(recordable),
        example=example,
        watch=watch,
    )


def _probes_of_samples(
    generator: GaussianGenerator, samples: Sequence[Mapping[str, np.ndarray]]
) -> list[Probe]:
    """Return the author's own inputs as probes; raise if they are not those that are declared."""
    probes = []
    for number, sample in enumerate(samples):
        names = [entry.name for entry in generator.inputs]
        if sorted(sample) != sorted(names):
            message = f"has the inputs {sorted(sample)}, expected {sorted(names)}"
            raise ConfigInvalid(message, where=f"samples[{number}]")
        inputs = {}
        for entry in generator.inputs:
            value = np.asarray(sample[entry.name], ROLES[entry.role].dtype[0])
            if entry.shape is not None and value.shape != tuple(entry.shape):
                message = f"has the shape {list(value.shape)}, expected {list(entry.shape)}"
                raise ConfigInvalid(message, where=f"samples[{number}][{entry.name!r}]")
            inputs[entry.name] = value
        probes.append(Probe(label=f"sample {number}", inputs=inputs))
    return probes


def _with_outputs(
    generator: GaussianGenerator, name: str, dtype: Dtype, start: Reference, capacity: int | None
) -> GeneratorManifest:
    """Return a generator's manifest with the number of Gaussians and cells of its first run."""
    _check_cells(generator, start)
    count = len(start.gaussians)
    rows = count if capacity is None else capacity
    if rows < count:
        message = f"capacity {rows} is less than the {count} Gaussians"
        raise GeneratorInvalid(message, where="capacity", hint=f"Give {count} or more.")
    manifest = manifest_of(generator, name, dtype, start.gaussians.degree, rows)
    if start.cells is None:
        return manifest
    per_cell = count // len(start.cells)
    check_whole_cells(rows, per_cell)
    cells = CellsOutput(CELLS_OUTPUT, per_cell, dtype)
    return replace(manifest, outputs=replace(manifest.outputs, cells=cells))


def _check_cells(generator: GaussianGenerator, reference: Reference) -> None:
    if (reference.cells is None) == (generator.weighted_sum is None):
        return
    if reference.cells is None:
        message = "weighted_sum is set, but forward returns no cells"
        hint = "Return Gaussians(…, cells=Cells(…)), or leave weighted_sum out."
    else:
        message = "forward returns cells, but weighted_sum is not set"
        hint = "Set weighted_sum = WeightedSum(background=…)."
    raise GeneratorInvalid(message, where=type(generator).__name__, hint=hint)


def manifest_of(
    generator: GaussianGenerator,
    name: str,
    dtype: Dtype,
    degree: int | None = None,
    capacity: int = 1,
    bounds: Bounds | None = None,
) -> GeneratorManifest:
    """Return the manifest of a torch generator's declarations; colours are RGB without a degree."""
    space: Literal["sh", "rgb"] = "rgb" if degree is None else "sh"
    color_name = APPEARANCE_RGB if degree is None else APPEARANCE_SH
    color_range = generator.color_range if degree is None else None
    appearance = AppearanceOutput(
        color_name, space, degree, generator.color_space, range=color_range
    )
    return GeneratorManifest(
        name=name,
        family=generator.family,
        producer=generator.producer or Producer(f"gsgen {version('gsgen')}"),
        inputs=tuple(generator.inputs),
        outputs=GeneratorOutputs(
            GaussiansOutput(GAUSSIANS, capacity, dtype),
            appearance,
            CountOutput(COUNT_OUTPUT, generator.count_semantics),
        ),
        space=generator.space,
        bounds=bounds,
        depends_on=dict(generator.depends_on),
        antialias=generator.antialias,
        blend="alpha" if generator.weighted_sum is None else "wsr",
        weighted_sum=generator.weighted_sum,
        tolerances=_DEFAULT_TOLERANCES,
    )


def _far_camera_probes(manifest: GeneratorManifest) -> Iterator[Probe]:
    """Yield test inputs with cameras inside the scene and far outside of it.

    All other inputs are sampled with another seed.
    """
    assert manifest.bounds is not None
    for seed, (label, scale) in enumerate(_DISTANCE_FACTORS.items(), start=1):
        low, high = np.array([manifest.bounds.min, manifest.bounds.max])
        center, half_range = (low + high) / 2, (high - low) / 2
        scaled = Bounds(
            tuple((center - scale * half_range).tolist()),
            tuple((center + scale * half_range).tolist()),
        )
        scaled_manifest = replace(manifest, bounds=scaled)
        for probe in probes_of(scaled_manifest, seed=seed, count=2)[1:]:
            yield replace(probe, label=f"{label}, {probe.label}")
