"""Exports a sequence of frames as one ONNX generator with the input ``time``."""

__all__ = ["ClipSource", "FrameReader"]

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float32

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.probing.probes import Probe
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import Bounds, CountOutput, GeneratorManifest, Input
from gsgen.contract.spec.operator_tables import operator_table
from gsgen.contract.spec.targets import load_target
from gsgen.contract.spec.units import format_bytes
from gsgen.contract.validation.settings import Settings
from gsgen.sdk.errors import GeneratorInvalid, ParityFailed
from gsgen.sdk.exporting.constant_generator import ConstantRows, constant_manifest
from gsgen.sdk.exporting.pipeline import (
    OPSET,
    Dtype,
    Exported,
    ExportOptions,
    GraphSource,
    Progress,
    check_contract,
    no_progress,
)
from gsgen.sdk.model_runs import run_in_groups
from gsgen.sdk.rewriting.model_io import save_model
from gsgen.sdk.sequences.clip import Clip
from gsgen.sdk.sequences.clip_graph import clip_model
from gsgen.sdk.sequences.correspondence import rows_correspond
from gsgen.sdk.sequences.decoding import decode_moment
from gsgen.sdk.sequences.encoding import ErrorBudget, encode_groups
from gsgen.sdk.sequences.frame_store import FrameStore, higher_terms
from gsgen.sdk.sequences.matching import track_frames
from gsgen.sdk.sequences.palettes import make_clip_palette

FrameReader = Callable[[int], ConstantRows]
"""Returns the packed rows of a frame."""

_BOUNDS_MARGIN: Final = 0.01
# Rounding of float32 sums over components, relative to the largest number of a column.
_PARITY_TOLERANCE: Final = 2e-5
# The largest factor of errors that --max-bytes may lead to, and the encodings to find the least.
_MAX_FACTOR_BITS: Final = 5.0
_BISECTIONS: Final = 5
_COMPARED_TIMES: Final = (0.0, 0.37, 0.5, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipSource(GraphSource):
    """Frames of Gaussians; where row i is not the same Gaussian in each, rows are matched.

    Attributes:
        names: The names of the frames, for messages; two or more.
        read: Reads a frame by its number.
        fps: Frames a second at natural speed.
        loop: Whether the end continues at the start.
        joined: Whether the last of the names is the frame that the clip ends in, at time 1: the
            first one of the next segment.
        budget: Errors that the encoded sequence may have.
        max_bytes: Bytes that the tables may have: errors grow until they fit.
        measure: Measures the loss of a written clip, as numbers by name and as lines of text.
    """

    names: Sequence[str]
    read: FrameReader
    fps: float | None = None
    loop: bool = False
    joined: bool = False
    budget: ErrorBudget = field(default_factory=ErrorBudget)
    max_bytes: int | None = None
    measure: Callable[[Path], tuple[Mapping[str, Any], tuple[str, ...]]] | None = None

    def export(
        self,
        path: str | os.PathLike[str],
        *,
        name: str | None = None,
        dtype: Dtype | None = None,
        capacity: int | None = None,
        opset: int = OPSET,
        target: str = "core",
        settings: Settings | None = None,
        progress: Progress = no_progress,
    ) -> Exported:
        """Encode the frames, and write the generator; options are those of an export.

        Raises:
            ConfigInvalid: An option is not one of clips, or there are fewer than two frames.
            GeneratorInvalid: The frames differ in their kind, or their Gaussians do not match.
            ParityFailed: ONNX Runtime computes other values than the tables hold.
            ExportRejected: The model breaks a rule.
        """
        if dtype == "float16":
            message, hint = "clips are written in float32", "Leave the option out."
            raise ConfigInvalid(message, where="--dtype", hint=hint)
        if capacity is not None:
            message, hint = "a clip has as many rows as a frame", "Leave the option out."
            raise ConfigInvalid(message, where="--capacity", hint=hint)
        path = Path(path)
        options = ExportOptions(
            path=path,
            name=name or path.stem,
            opset=opset,
            target=target,
            settings=settings,
            progress=progress,
        )
        clip, manifest, notes = self._encode(options)
        with atomic_write(path) as draft:
            has_bytes = _dequantises(target)
            save_model(clip_model(clip, manifest, opset, has_bytes=has_bytes), draft)
            progress("comparing the model with its tables")
            _check_written_clip(draft, clip, manifest, options.limits)
            report = check_contract(draft, options)
            options.progress("measuring the loss")
            loss, lines = self.measure(draft) if self.measure is not None else ({}, ())
        sizes = clip.bytes_by_attribute()
        by_size = ", ".join(f"{name} {format_bytes(size)}" for name, size in sizes.items())
        return Exported(
            path=path,
            manifest=manifest,
            report=report,
            dtype="float32",
            contents=f"{clip.frames:,} frames of {len(clip):,} Gaussians",
            notes=notes,
            measured={
                "frames": clip.frames,
                "rows": len(clip),
                "file_bytes": path.stat().st_size,
                "table_bytes": sizes,
                "components": [
                    {"rows": len(group), **group.component_counts()} for group in clip.groups
                ],
                **loss,
            },
            lines=(f"tables: {by_size}", *lines),
        )

    def _encode(self, options: ExportOptions) -> tuple[Clip, GeneratorManifest, tuple[str, ...]]:
        """Read all frames, and return them as a clip, with its manifest and notes."""
        if len(self.names) < 2:
            message = f"has {len(self.names)} frame, expected two or more"
            hint = f"`gsgen export static {self.names[0] if self.names else 'FILE'} -o …` writes a scene that does not change."
            raise ConfigInvalid(message, where="FRAMES", hint=hint)
        first = self.read(0)
        notes = list(first.notes)
        with closing(FrameStore(first)) as store:
            if not self._store_corresponding(store, first, options.progress):
                tracked = track_frames(self.read, len(self.names), options.progress)
                first = tracked.births
                notes.append(
                    f"rows of the frames do not correspond: {len(first.rows):,} Gaussians were "
                    f"matched, of up to {tracked.largest:,} in a frame"
                )
                store.restart(first)
                rows = first.rows
                for number in range(len(self.names)):
                    options.progress(f"reading frame {number + 1} of {len(self.names)}")
                    rows, appearance = tracked.frame(number, rows)
                    store.append(rows, appearance)
            if store.largest_change > self.budget.color:
                notes.append(
                    "SH coefficients beyond the constant term change by up to "
                    f"{store.largest_change:.2g}; the first ones of each Gaussian are stored"
                )
            clip = self._fitting_clip(store, first, options.progress)
            corners = np.stack([store.low, store.high])
        return clip, self._manifest(clip, first, corners, options), tuple(notes)

    def _store_corresponding(
        self, store: FrameStore, first: ConstantRows, progress: Progress
    ) -> bool:
        """Store the frames, and return whether their rows correspond; stop if they do not."""
        previous = first
        for number, name in enumerate(self.names):
            progress(f"reading frame {number + 1} of {len(self.names)}")
            frame = first if number == 0 else self.read(number)
            _require_equal_kind(frame, first, name, self.names[0])
            if not rows_correspond(previous, frame):
                return False
            store.append(frame.rows, frame.appearance)
            previous = frame
        return True

    def _fitting_clip(self, store: FrameStore, first: ConstantRows, progress: Progress) -> Clip:
        """Encode the frames; of the budgets whose tables fit ``max_bytes``, take the smallest."""
        progress("encoding")
        palette = make_clip_palette(higher_terms(first.appearance)) if first.space == "sh" else None

        def encode(factor: float) -> Clip:
            groups = encode_groups(store, self.budget.scaled(factor), loop=self.loop)
            rows = np.concatenate([group.rows for group in groups])
            return Clip(
                groups=groups,
                palette=None if palette is None else palette.reordered(rows),
                space=first.space,
                frames=store.frames - self.joined,
                knots=store.frames + self.loop,
            )

        clip = encode(1.0)
        if self.max_bytes is None or clip.nbytes <= self.max_bytes:
            return clip
        # Bisect the logarithm of the factor.
        low, high = 0.0, _MAX_FACTOR_BITS
        fitting = smallest = encode(2.0**high)
        if smallest.nbytes > self.max_bytes:
            message = f"{self.max_bytes:,} bytes are too few: the coarsest tables have {smallest.nbytes:,}"
            hint = "Give more bytes, or leave out frames or Gaussians."
            raise ConfigInvalid(message, where="--max-bytes", hint=hint)
        for step in range(_BISECTIONS):
            progress(f"encoding, size {step + 1} of {_BISECTIONS}")
            middle = (low + high) / 2
            clip = encode(2.0**middle)
            if clip.nbytes <= self.max_bytes:
                fitting, high = clip, middle
            else:
                low = middle
        return fitting

    def _manifest(
        self,
        clip: Clip,
        first: ConstantRows,
        corners: Float32[np.ndarray, "2 3"],
        options: ExportOptions,
    ) -> GeneratorManifest:
        """Return the manifest of a still scene of the rows, with the time and the bounds of all."""
        appearance = first.appearance[:, : clip.channels]
        packed = replace(first, rows=first.rows.astype(np.float32), appearance=appearance)
        manifest = constant_manifest(packed, options.name, family="4d")
        fades = any(len(group.opacity.coefficients) > 1 for group in clip.groups)
        time = Input(
            name="time",
            role="time",
            shape=(1,),
            range=(0.0, 1.0),
            default=0.0,
            loop=self.loop or None,
            frames=clip.frames,
            fps=self.fps,
        )
        count = CountOutput("num_points", "upper-bound" if fades else "exact")
        return replace(
            manifest,
            inputs=(time,),
            outputs=replace(manifest.outputs, count=count),
            bounds=Bounds.from_points(corners, _BOUNDS_MARGIN),
        )


def _dequantises(target: str) -> bool:
    """Return whether the runtimes of a target dequantise bytes as ONNX defines it."""
    tables = [operator_table(name) for name in load_target(target).operators]
    outcomes = [table.outcome("DequantizeLinear", "", "float32", OPSET) for table in tables]
    return "wrong" not in outcomes


def _require_equal_kind(
    frame: ConstantRows, first: ConstantRows, name: str, first_name: str
) -> None:
    """Raise if a frame differs from the first one in what its numbers are."""
    facts = [
        {
            "space": entry.space,
            "channels": str(entry.appearance.shape[1]),
            "color space": entry.color_space,
            "antialias": entry.antialias,
            "origin": str(entry.origin),
        }
        for entry in (frame, first)
    ]
    for key, actual in facts[0].items():
        if actual != facts[1][key]:
            message = f"{key}: {actual}, expected {facts[1][key]} as in {first_name}"
            hint = "Frames of a sequence have colours of one kind."
            raise GeneratorInvalid(message, where=name, hint=hint)


def _check_written_clip(
    path: Path, clip: Clip, manifest: GeneratorManifest, limits: Limits
) -> None:
    """Run a model at some moments, and raise unless it computes what its tables hold."""
    outputs = manifest.outputs
    assert outputs.gaussians is not None
    assert outputs.appearance is not None
    names = [outputs.gaussians.name, outputs.appearance.name]
    time_name = manifest.inputs[0].name
    probes = [
        Probe(label=f"time {time}", inputs={time_name: np.array([time], np.float32)})
        for time in _COMPARED_TIMES
    ]
    frame_bytes = len(clip) * (layout.ROW_LENGTH + clip.channels) * 4

    def failure(message: str, hint: str) -> ParityFailed:
        return ParityFailed(
            f"ONNX Runtime cannot run the model: {message}", where=path.name, hint=hint
        )

    limits = limits.for_model(path.stat().st_size + len(probes) * frame_bytes)
    runs = run_in_groups(path, names, probes, limits, frame_bytes=frame_bytes, failure=failure)
    for time, outputs_at_time in zip(_COMPARED_TIMES, runs, strict=True):
        for name, expected in zip(names, decode_moment(clip, float(np.float32(time))), strict=True):
            actual = outputs_at_time[name]
            allowed = _PARITY_TOLERANCE * np.abs(expected).max(axis=0)
            error = np.abs(actual - expected)
            if actual.shape != expected.shape or not (error <= allowed).all():
                message = f"output differs by {error.max():.3g} at time {time}"
                raise ParityFailed(message, where=f"{path.name}, {name}")
