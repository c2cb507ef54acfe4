"""Exports a sequence as segments: clips of some seconds each, and a scene file that plays them.

A player opens the segment of its moment, and the next. The first segment is the first frame as SOG,
so that a picture is there before a clip is. Frames that share too few Gaussians for a clip are SOG
files, too: each has a set of its own, and sets are never blended. Each segment is a task that writes
its files and their record into a draft folder, named after its inputs: a stopped export resumes
after its last segment, and any engine writes the same bytes. Files move to their places when all
are there, so that a scene file never names segments of two exports. The folder of the segments is
theirs: one that holds frames, or segments of another origin, is refused.
"""

__all__ = ["ClipExport"]

import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from filecmp import cmp
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.model_file import open_model
from gsgen.contract.process.atomic_files import MODEL_SUFFIX, atomic_write
from gsgen.contract.process.drafts import temporary_folder
from gsgen.contract.process.interrupts import require_time
from gsgen.contract.spec.manifest import Manifest
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.spec.units import format_bytes
from gsgen.contract.validation.report import Report
from gsgen.formats import Splats, write_sog
from gsgen.formats.shared.splats import NO_ORIGIN
from gsgen.reference_plugins.sequences.clip_loss import measure_loss
from gsgen.reference_plugins.sequences.frame_files import FrameFiles
from gsgen.reference_plugins.static.static import StaticScene
from gsgen.runtime.scene_checks.validate import validate_scene
from gsgen.runtime.sources.key_frames import DEFAULT_FPS
from gsgen.sdk.exporting.pipeline import (
    Exported,
    ExportOptions,
    GraphSource,
    Progress,
    check_contract,
)
from gsgen.sdk.sequences.clip_source import ClipSource
from gsgen.sdk.sequences.matching import FramesUnmatched
from gsgen.tiles.build.engines.opening import open_engine
from gsgen.tiles.build.files import read_json, write_json
from gsgen.tiles.loading.leaves import open_splats

_SCENE_SUFFIX: Final = ".json"
_DRAFTS: Final = ".gsgen-export"  # folder of the finished segments, until all are there
_RECORD: Final = "record.json"
_MIN_FRAMES: Final = 3
_USUAL_SECONDS: Final = 2.0
_SEGMENT_NAME: Final = re.compile(r"\d{4,}(\.onnx|\.sog|-\d{4,}\.sog)")


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipExport(GraphSource):
    """Frames of splat files that are exported as one clip, or as a scene file of segments.

    Attributes:
        files: The frames.
        clip: Options of the clip, of whose frames ``names`` and ``read`` are set here.
        moments: How many moments are drawn and compared; 0 for none.
        seconds: The length of a segment; 2 where absent.
        sound: A recording that plays from the start; a copy of it belongs to the segments.
        captions: WebVTT captions of the recording.
        engine: Runs the exports of segments: serial (the default), processes, dask or dask=ADDRESS.
        workers: Processes; as many as there are processor cores where absent.
    """

    files: FrameFiles
    clip: ClipSource
    moments: int
    seconds: float | None
    sound: Path | None
    captions: Path | None
    engine: str | None
    workers: int | None

    def export(self, path: str | os.PathLike[str], **options: Any) -> Exported:
        """Export the frames; a path that ends in .json is that of a scene file of segments.

        Raises:
            ConfigInvalid: An option is not one of this export, or there are too few frames.
        """
        path = Path(path)
        if path.suffix.lower() != _SCENE_SUFFIX:
            of_segments = {
                "--segment": self.seconds,
                "--sound": self.sound,
                "--captions": self.captions,
                "--engine": self.engine,
                "--workers": self.workers,
            }
            for option, value in of_segments.items():
                if value is not None:
                    message = f"{value} is for a scene file of segments, not {path.name}"
                    hint = f"Write -o {path.with_suffix(_SCENE_SUFFIX)}, or leave the option out."
                    raise ConfigInvalid(message, where=option, hint=hint)
            return self.part(range(len(self.files.paths)), joined=False).export(path, **options)
        return self._export_segments(path, **options)

    def part(self, numbers: Sequence[int], *, joined: bool) -> ClipSource:
        """Return the clip of some frames."""
        files = replace(self.files, paths=tuple(self.files.paths[number] for number in numbers))
        names = [str(path) for path in files.paths]
        measure = partial(measure_loss, read=files.read, names=names, moments=self.moments)
        loop = self.clip.loop and len(numbers) == len(self.files.paths) and not joined
        return replace(
            self.clip,
            names=names,
            read=files.read,
            loop=loop,
            joined=joined,
            measure=measure if self.moments else None,
        )

    def _tasks(self, folder: Path, options: Mapping[str, Any]) -> Iterator["_SegmentTask"]:
        """Yield the tasks of all segments, which together last as long as the frames."""
        frames = len(self.files.paths)
        fps = self.clip.fps or DEFAULT_FPS
        first = open_splats(self.files.paths[0])
        has_still = isinstance(first, Splats) and first.origin == NO_ORIGIN

        def task(number: int, numbers: Sequence[int], *, joined: bool) -> _SegmentTask:
            file = folder / f"{number:04}.{'onnx' if len(numbers) > 1 else 'sog'}"
            return _SegmentTask(
                file=file, numbers=tuple(numbers), joined=joined, export=self, options=options
            )

        if has_still:
            yield task(0, (0,), joined=False)
        # The last segment of a sequence that does not loop has its last two frames, at least.
        length = max(1, round((self.seconds or _USUAL_SECONDS) * fps))
        starts = list(range(int(has_still), max(frames - 1, 1), length))
        ends = [*starts, frames if self.clip.loop else frames - 1]
        for index, (start, end) in enumerate(pairwise(ends)):
            is_last = index == len(starts) - 1
            numbers = [number % frames for number in range(start, end + 1)]
            yield task(index + has_still, numbers, joined=not is_last or self.clip.loop)

    def _export_segments(self, path: Path, **options: Any) -> Exported:
        if len(self.files.paths) < _MIN_FRAMES:
            message = f"has {len(self.files.paths)} frames, expected three or more for segments"
            raise ConfigInvalid(message, where="FRAMES", hint="Write one clip: -o clip.onnx")
        progress = options.pop("progress")
        folder = path.with_suffix("")
        name = options.pop("name") or path.stem
        _require_own_folder(folder, path, self.files.paths)
        sound = self._sound(path, folder)
        (folder / _DRAFTS).mkdir(parents=True, exist_ok=True)
        tasks = list(self._tasks(folder, {**options, "name": name}))
        records: dict[int, dict[str, Any]] = {}
        with open_engine(self.engine or "serial", self.workers) as engine:
            for index, record in engine.run(_export_segment, tasks):
                records[index] = record
                progress(f"segment {len(records)} of {len(tasks)}")
        segments = [records[index] for index in range(len(tasks))]
        fps = self.clip.fps or DEFAULT_FPS
        frames = {file: count for record in segments for file, count in record["files"].items()}
        document = {
            "gsgen_scene": "1.0",
            "models": [
                {
                    "segments": [
                        {"path": f"{folder.name}/{file}", "seconds": count / fps}
                        for file, count in frames.items()
                    ],
                    "capacity": max(record["rows"] for record in segments),
                }
            ],
            "timeline": {"seconds": sum(frames.values()) / fps, "fps": fps, "loop": self.clip.loop},
        }
        up = self.files.read(0).up
        if up != "-y":  # that of scenes without the field
            document["up"] = up
        if sound:
            document["sound"] = {name: f"{folder.name}/{file.name}" for name, file in sound.items()}
        files = [folder / file for file in frames]
        path.unlink(missing_ok=True)  # until all of its files are there
        for record in segments:
            for file in record["files"]:
                os.replace(folder / _DRAFTS / record["folder"] / file, folder / file)
        for file in sound.values():
            if not file.parent.samefile(folder):
                with atomic_write(folder / file.name) as draft:
                    shutil.copyfile(file, draft)
        with atomic_write(path) as draft:
            draft.write_text(json.dumps(document, indent=2) + "\n", "utf-8")
        _remove_others(folder, files)
        manifest, report = self._check(files, name, progress, options)
        progress("checking the scene file")
        scene = validate_scene(path, options["settings"])
        report = replace(
            report,
            findings=(*report.findings, *scene.findings),
            outcomes=(*report.outcomes, *scene.outcomes),
        )
        return _result(path, files, segments, manifest, report)

    def _sound(self, scene: Path, folder: Path) -> dict[str, Path]:
        """Return the files of the scene's sound by their fields."""
        if self.captions is not None and self.sound is None:
            hint = "Give the recording: --sound FILE."
            raise ConfigInvalid("is without --sound", where="--captions", hint=hint)
        named = {"path": self.sound, "captions": self.captions}
        sound = {name: file for name, file in named.items() if file is not None}
        for option, file in zip(("--sound", "--captions"), sound.values(), strict=False):
            if not file.is_file():
                raise ConfigInvalid("is no file", where=f"{option} {file}")
            if _SEGMENT_NAME.fullmatch(file.name):
                raise ConfigInvalid("is named as a segment", where=f"{option} {file}")
            others = [
                *sound.values(),
                *([] if _is_exported(file.name, scene) else [folder / file.name]),
            ]
            for other in others:
                if other.name == file.name and other.is_file() and not cmp(file, other, False):
                    message = f"has the name of {other}, which its copy would replace"
                    hint = "Give one of the two another name."
                    raise ConfigInvalid(message, where=f"{option} {file}", hint=hint)
        return sound

    def _check(
        self, files: Sequence[Path], name: str, progress: Progress, options: Mapping[str, Any]
    ) -> tuple[Manifest, Report]:
        """Validate the first clip, or the first frame as a generator; return manifest and report."""
        checked = {key: options[key] for key in ("opset", "target", "settings")}
        model = next((file for file in files if file.suffix == MODEL_SUFFIX), None)
        if model is None:
            still = StaticScene(content=open_splats(files[0]))
            with temporary_folder() as folder:
                exported = still.export(folder / f"{name}{MODEL_SUFFIX}", name=name, **checked)
            return exported.manifest, exported.report
        text = open_model(model).manifest_text
        assert text is not None
        checking = ExportOptions(path=model, name=name, progress=progress, **checked)
        return loads(text), check_contract(model, checking)


@dataclass(frozen=True, slots=True, kw_only=True)
class _SegmentTask:
    """A segment to export.

    Attributes:
        file: Its place, once all segments are there.
        numbers: Of its frames.
        joined: Whether the last of them is the first one of the next segment.
        export: The whole export.
        options: Of each clip.
    """

    file: Path
    numbers: tuple[int, ...]
    joined: bool
    export: ClipExport
    options: Mapping[str, Any]

    @property
    def is_clip(self) -> bool:
        """Whether the segment has more than the first frame."""
        return len(self.numbers) > 1

    @property
    def frames(self) -> int:
        """How many frames the segment lasts."""
        return len(self.numbers) - self.joined

    def clip(self, file: Path) -> dict[str, Any]:
        """Write the segment as a clip, and return its record."""
        exported = self.export.part(self.numbers, joined=self.joined).export(file, **self.options)
        require_time()  # a clip that was not checked ends the export, which resumes with it
        assert exported.measured is not None
        return {
            "files": {file.name: self.frames},
            "rows": exported.measured["rows"],
            "measured": exported.measured,
            "notes": list(exported.notes),
        }

    def stills(self, frames: Mapping[Path, int]) -> dict[str, Any]:
        """Write frames as SOG files, and return the record of the segment."""
        rows = 0
        for file, number in frames.items():
            content = open_splats(self.export.files.paths[number])
            if not isinstance(content, Splats) or content.origin != NO_ORIGIN:
                raise FramesUnmatched(
                    "shares too few Gaussians with the frames around it for a clip, expected splats "
                    "near 0,0,0, of which a file of its own is written",
                    where=str(self.export.files.paths[number]),
                )
            with atomic_write(file) as draft:
                write_sog(draft, content)
            rows = max(rows, len(content))
        files = {file.name: 1 for file in frames}
        return {"files": files, "rows": rows, "measured": None, "notes": []}

    def key(self) -> str:
        """Return a digest of all that the bytes of the segment follow from."""
        clip = self.export.clip
        digest = hashlib.sha256()
        facts = [version("gsgen"), self.numbers, self.joined, clip.loop, clip.fps, clip.max_bytes]
        facts += [clip.budget, self.export.moments, self.export.files.origin, self.export.files.up]
        options = {key: value for key, value in self.options.items() if key != "settings"}
        facts += [sorted(options.items())]
        digest.update(repr(facts).encode())
        for number in self.numbers:
            with open(self.export.files.paths[number], "rb") as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
        return digest.hexdigest()


def _export_segment(task: _SegmentTask) -> dict[str, Any]:
    """Write the draft of a segment unless its record says that it is there; return the record."""
    stem = task.file.stem
    # A draft of other inputs has another name.
    folder = task.file.parent / _DRAFTS / f"{stem}-{task.key()}"
    draft, record_file = folder / task.file.name, folder / _RECORD
    if record_file.exists():
        record: dict[str, Any] = read_json(record_file, hint="Remove it, and export once more.")
        if all((folder / file).exists() for file in record["files"]):
            return record
    folder.mkdir(exist_ok=True)
    if not task.is_clip:
        record = task.stills({draft: task.numbers[0]})
    else:
        try:
            record = task.clip(draft)
        except FramesUnmatched:
            numbers = task.numbers[: task.frames]
            record = task.stills(
                {folder / f"{stem}-{index:04}.sog": frame for index, frame in enumerate(numbers)}
            )
            record["notes"] = [
                f"frames {numbers[0]} to {numbers[-1]} share too few Gaussians for a clip: each has "
                "a file of its own"
            ]
    record["folder"] = folder.name
    write_json(record_file, record)
    return record


def _require_own_folder(folder: Path, scene: Path, frames: Sequence[Path]) -> None:
    """Raise if segments would replace files that are none of an earlier export to ``scene``."""
    hint = "Name another scene file."
    if not folder.exists():
        return
    if not folder.is_dir():
        message = "is a file, expected a folder for the segments"
        raise ConfigInvalid(message, where=str(folder), hint=hint)
    if any(frame.parent.samefile(folder) for frame in frames):
        message = "holds the frames, expected a folder for the segments alone"
        raise ConfigInvalid(message, where=str(folder), hint=hint)
    for file in sorted(folder.iterdir()):
        if _SEGMENT_NAME.fullmatch(file.name) and not _is_exported(file.name, scene):
            message = f"is no segment of {scene}, expected a folder for its segments alone"
            raise ConfigInvalid(message, where=str(file), hint=hint)


def _is_exported(name: str, scene: Path) -> bool:
    """Return whether a file of a scene's folder is one of an earlier export."""
    if (scene.with_suffix("") / _DRAFTS).exists():  # of an export that was stopped
        return True
    earlier = scene.read_text("utf-8", "replace") if scene.is_file() else ""
    return f"/{json.dumps(name)[1:]}" in earlier


def _remove_others(folder: Path, files: Sequence[Path]) -> None:
    """Remove drafts, and segments of an earlier export."""
    shutil.rmtree(folder / _DRAFTS)
    for file in folder.iterdir():
        if _SEGMENT_NAME.fullmatch(file.name) and file not in files:
            file.unlink()


def _result(
    path: Path,
    files: Sequence[Path],
    records: Sequence[Mapping[str, Any]],
    manifest: Manifest,
    report: Report,
) -> Exported:
    """Return what the records of all segments say together."""
    sizes = [file.stat().st_size for file in files]
    measured = [record["measured"] for record in records if record["measured"]]
    tables: dict[str, int] = {}
    for part in measured:
        for name, size in part["table_bytes"].items():
            tables[name] = tables.get(name, 0) + size
    frames = sum(count for record in records for count in record["files"].values())
    losses = [part["loss"] for part in measured if part.get("loss")]
    lines = [
        f"{len(files)} segments in {files[0].parent}: {format_bytes(sum(sizes))}, the first has "
        f"{format_bytes(sizes[0])}, the largest {format_bytes(max(sizes))}"
    ]
    loss = None
    if losses:
        worst = min(losses, key=lambda part: part["psnr_worst"])
        moments = [moment for part in losses for moment in part["moments"]]
        loss = {
            "psnr_mean": round(sum(moment["psnr"] for moment in moments) / len(moments), 2),
            "psnr_worst": worst["psnr_worst"],
            "ssim_mean": round(sum(moment["ssim"] for moment in moments) / len(moments), 5),
            "worst_frame": worst["worst_frame"],
        }
        lines.append(
            f"drawn at {len(moments)} moments: PSNR {loss['psnr_mean']:.1f} dB; worst "
            f"{loss['psnr_worst']:.1f} dB, {loss['worst_frame']}"
        )
    rows = max(record["rows"] for record in records)
    notes = dict.fromkeys(note for record in records for note in record["notes"])
    return Exported(
        path=path,
        manifest=manifest,
        report=report,
        dtype="float32",
        contents=f"{frames:,} frames of up to {rows:,} Gaussians",
        notes=tuple(notes),
        measured={
            "frames": frames,
            "rows": rows,
            "file_bytes": sum(sizes),
            "segment_bytes": sizes,
            "table_bytes": tables,
            "loss": loss,
        },
        lines=tuple(lines),
    )
