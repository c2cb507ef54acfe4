"""Builds a tileset in phases: scan and count splats, sort them, write tiles and tileset.json.

Every task writes a marker file, so that a stopped build resumes after its last finished task.
"""

__all__ = ["BuildReport", "build_tileset"]

import hashlib
import json
import math
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar, final

import numpy as np

from gsgen.contract.errors import ConfigInvalid, InputUnreadable
from gsgen.contract.process.drafts import lock_folder
from gsgen.formats.merging.morton import DEPTH, Cube
from gsgen.formats.shared.splats import DEFAULT_UP, NO_ORIGIN
from gsgen.tiles.build.assemble import is_complete, remove_stale, walk, write_index, write_record
from gsgen.tiles.build.engines.engine import Engine
from gsgen.tiles.build.files import sweep, write_bytes, write_json
from gsgen.tiles.build.frame import moved_transform, turned_transform
from gsgen.tiles.build.neural_tiles import Generator
from gsgen.tiles.build.octree import load_built, load_units
from gsgen.tiles.build.parameters import ALGORITHM_VERSION, BuildParameters
from gsgen.tiles.build.plan import Plan, depth_of, load_plan, make_partitions, save_plan
from gsgen.tiles.build.progress import Progress
from gsgen.tiles.build.scan import ChunkFacts
from gsgen.tiles.build.source import (
    CHUNK_BYTES,
    Chunk,
    SceneFile,
    chunks_of,
    open_scenes,
    row_dtype,
)
from gsgen.tiles.build.streamed_sog import UNIT_SPLATS, write_streamed_index
from gsgen.tiles.build.tasks import (
    CountTask,
    PlanTask,
    ScanTask,
    run_bin,
    run_count,
    run_parent_cell,
    run_partition,
    run_scan,
)
from gsgen.tiles.format.index import BUILD_RECORD
from gsgen.tiles.format.json_values import JsonDict

WORK_FOLDER: Final = ".gsgen-build"
"""Folder in the output that holds spills and markers until the build is done."""

_OWNER_FILE: Final = "process"  # in the work folder: the number of the process that builds

PARTITION_SPLATS: Final = 500_000
"""Splats that one task sorts and builds: enough to keep workers busy, few enough for many."""

_PARTITION_BYTES: Final = 256 << 20
_SPZ_LOG_SCALE: Final = 255 / 16 - 10
_FIRST_DEPTH: Final = 7
_DEPTH_STEP: Final = 5
_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class BuildReport:
    """The result of a tileset build: splats, tiles, files and bytes.

    Attributes:
        output: Folder of the tileset.
        key: Of the build.
        splats: Of the scenes, and of all leaves together.
        skipped: Rows that cannot be drawn, which were left out.
        tiles: Number of tiles; 0 if nothing had to be done.
        files: Files of the tileset.
        bytes: Of all files.
        quality_bytes: Of all contents at each quality, finest first; empty if nothing had to be
            done.
        up_to_date: Whether the tileset was there already.
    """

    output: str
    key: str
    splats: int
    skipped: int
    tiles: int
    files: int
    bytes: int
    quality_bytes: tuple[int, ...] = ()
    up_to_date: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class _BuildRun:
    """The engine, which runs tasks, and the progress display of all phases of a tileset build."""

    engine: Engine
    progress: Progress

    def phase(
        self,
        name: str,
        total: int,
        function: Callable[[_Task], tuple[int, _Result]],
        tasks: Sequence[_Task],
    ) -> list[_Result]:
        """Run all tasks of one phase of a tileset build; return their results in order."""
        self.progress.begin(name, total)
        results: dict[int, _Result] = {}
        for index, (splats, result) in self.engine.run(function, tasks):
            results[index] = result
            self.progress.advance(splats)
        return [results[index] for index in range(len(tasks))]


def build_tileset(
    scenes: Sequence[Path],
    output: Path,
    parameters: BuildParameters,
    *,
    engine: Engine,
    progress: Progress,
    generators: Sequence[Generator] = (),
    fresh: bool = False,
    chunk_bytes: int = CHUNK_BYTES,
    partition: int = PARTITION_SPLATS,
) -> BuildReport:
    """Build one tileset from scene files, in an output folder.

    A stopped build of the same scenes and parameters resumes.

    Args:
        scenes: Files of splats, which are put together.
        output: A folder that is new, empty, or of an earlier build.
        parameters: All options that change bytes of the tileset.
        engine: Runs the tasks.
        progress: Reports the phases.
        generators: Become neural tiles beside the tree of the scenes.
        fresh: Delete the intermediate files of an earlier build, and start from the beginning.
        chunk_bytes: Bytes of a PLY file that one task reads. No byte of the result depends on it.
        partition: Most splats that one task sorts and builds. No byte depends on it either.

    Raises:
        InputUnreadable: A scene cannot be read, or has no splat that can be drawn.
        ConfigInvalid: The folder holds something else, cannot be written to, or another process
            builds in it.
        EngineFailed: Workers died again and again.
    """
    _require_output(output)
    files = open_scenes([path.resolve() for path in scenes], parameters.origin)
    if parameters.is_streamed_sog:
        _require_sog(files[0])
    if parameters.turn_upright:
        transform = turned_transform(parameters.transform, files[0].up)
        parameters = replace(parameters, transform=transform, turn_upright=False)
    origin = files[0].origin
    moved = moved_transform(parameters.transform, origin)
    parameters = replace(parameters, transform=moved, origin=origin if any(origin) else None)
    output = output.resolve()
    chunks = chunks_of(files, chunk_bytes)
    division = (chunk_bytes, partition)
    with _sole_build(output):
        work = _prepare_output(output, files, parameters, division, fresh=fresh)
        run = _BuildRun(engine=engine, progress=progress)
        # 1. Scan: boxes, counts, digests.
        total = sum(chunk.count for chunk in chunks)
        tasks = [ScanTask(chunk=chunk, work=str(work)) for chunk in chunks]
        facts = run.phase("scan", total, run_scan, tasks)
        skipped = _report_skipped_splats(facts, chunks, progress)
        if parameters.codec == "spz" and not parameters.is_streamed_sog:
            _report_large_splats(facts, progress)
        splats = total - skipped
        if splats == 0:
            raise InputUnreadable(
                f"none of the {total:,} splats has finite values, expected at least one",
                where=files[0].path,
            )
        is_implicit = not generators and parameters.is_implicit(splats)
        parameters = replace(parameters, implicit=is_implicit)
        models = [f"generator {generator.sha256}" for generator in generators]
        key = parameters.key([*_content_digests(facts, chunks), *models])
        record = None if fresh else is_complete(output, key)
        if record is not None:
            shutil.rmtree(output / WORK_FOLDER, ignore_errors=True)
            return _up_to_date_report(output, record, skipped)
        # 2. Plan: cells, partitions, top.
        plan_path = work / "plan.json"
        if not plan_path.exists():
            save_plan(
                _plan(run, files, chunks, facts, parameters, partition, output, work), plan_path
            )
        plan = load_plan(str(plan_path))
        if plan.count != splats:
            raise AssertionError(f"the octree cells hold {plan.count} splats, expected {splats}")
        _write_tiles(run, str(plan_path), total)
        # 5. The index, and nothing else is left.
        progress.begin("index", 0)
        return _write_build_report(plan, key, skipped, generators)


@contextmanager
def _sole_build(output: Path) -> Iterator[None]:
    """Hold the lock of an output folder, in which one process builds at a time."""
    folder = output / WORK_FOLDER
    owner_file = folder / _OWNER_FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = lock_folder(folder)
    except BlockingIOError:
        owner = owner_file.read_text("utf-8") if owner_file.is_file() else "that has just begun"
        raise ConfigInvalid(
            f"process {owner} is building a tileset in this folder",
            where=str(output),
            hint="Wait until it has ended, or name another folder.",
        ) from None
    except OSError as error:
        message = f"cannot be written: {error.strerror or error}"
        raise ConfigInvalid(message, where=str(error.filename or folder)) from error
    try:
        write_bytes(owner_file, str(os.getpid()).encode())
        yield
    finally:
        owner_file.unlink(missing_ok=True)
        if descriptor is not None:
            os.close(descriptor)


def _require_sog(file: SceneFile) -> None:
    """Raise for what a streamed SOG cannot say of its splats."""
    for name, actual, expected in (
        ("color_space", file.color_space, "srgb"),
        ("origin", file.origin, NO_ORIGIN),
        ("up", file.up, DEFAULT_UP),
    ):
        if actual != expected:
            raise ConfigInvalid(
                f"{name} is {actual}, which a streamed SOG cannot state; expected {expected}",
                where=file.path,
                hint="Build a tileset: leave --codec sog out.",
            )


def _write_tiles(run: _BuildRun, path: str, rows: int) -> None:
    """Sort the splats by partition, then write the tiles of a saved build plan, leaves first."""
    plan = load_plan(path)
    # 3. Bin, with a barrier: every splat is in one spill.
    items = [PlanTask(plan=path, item=chunk.index) for chunk in plan.chunks]
    spilled_bytes = sum(run.phase("bin", rows, run_bin, items))
    if spilled_bytes != plan.count:
        raise AssertionError(
            f"the partitions' temporary files hold {spilled_bytes} splats, expected {plan.count}"
        )
    # 4. Partitions, the largest first; then the levels above, deepest first.
    order = sorted(plan.partitions, key=lambda partition: (-partition.count, partition.index))
    items = [PlanTask(plan=path, item=partition.index) for partition in order]
    run.phase("tiles", plan.count, run_partition, items)
    if plan.parameters.is_streamed_sog:
        return
    for depth in sorted({depth_of(cell) for cell in plan.top}, reverse=True):
        cells = [cell for cell in plan.top if depth_of(cell) == depth]
        items = [PlanTask(plan=path, item=cell) for cell in cells]
        run.phase("top", 0, run_parent_cell, items)


def _write_build_report(
    plan: Plan, key: str, skipped: int, generators: Sequence[Generator]
) -> BuildReport:
    output = Path(plan.output)
    if plan.parameters.is_streamed_sog:
        units = load_units(plan)
        files = write_streamed_index(plan, units)
        write_record(plan, key, plan.count, files)
        tile_count = sum(len(unit["leaves"]) for unit in units)
        quality_bytes: tuple[int, ...] = ()
    else:
        (root,) = load_built(plan)
        files = write_index(plan, root, key, generators)
        tile_count = sum(1 for _ in walk(root)) + len(generators)
        sizes = ([content.size for content in tile.contents] for tile in walk(root))
        quality_bytes = tuple(map(sum, zip(*sizes, strict=True)))
    remove_stale(output, files)
    shutil.rmtree(output / WORK_FOLDER)
    sweep(output)
    return BuildReport(
        output=str(output),
        key=key,
        splats=plan.count + sum(len(generator.first_frame) for generator in generators),
        skipped=skipped,
        tiles=tile_count,
        files=len(files) + 1,
        bytes=sum(size for size, _ in files.values()),
        quality_bytes=quality_bytes,
    )


def _up_to_date_report(output: Path, record: JsonDict, skipped: int) -> BuildReport:
    sizes = [entry["bytes"] for entry in record["files"].values()]
    return BuildReport(
        output=str(output),
        key=record["key"],
        splats=record["source_splats"],
        skipped=skipped,
        tiles=0,
        files=len(sizes) + 1,
        bytes=sum(sizes),
        up_to_date=True,
    )


def _require_output(output: Path) -> None:
    """Raise if the output folder holds foreign files, since a build deletes stale files."""
    if output.exists() and not output.is_dir():
        raise ConfigInvalid("is a file; expected a folder", where=str(output))
    if not output.is_dir():
        return
    build_files = {BUILD_RECORD, WORK_FOLDER} & {path.name for path in output.iterdir()}
    if not build_files and any(output.iterdir()):
        raise ConfigInvalid(
            "the folder holds files that no build wrote; expected a new or empty folder",
            where=str(output),
            hint=f"Name a folder in it, such as {output / 'tiles'}.",
        )


def _prepare_output(
    output: Path,
    files: Sequence[SceneFile],
    parameters: BuildParameters,
    division: tuple[int, int],
    *,
    fresh: bool,
) -> Path:
    """Return the work folder of a tileset build, and delete the work folders of other builds."""
    content = {
        "version": ALGORITHM_VERSION,
        "parameters": parameters.as_dict(),
        "division": division,
        "files": [[file.path, file.size, file.modified] for file in files],
    }
    text = json.dumps(content, sort_keys=True)
    name = hashlib.sha256(text.encode()).hexdigest()[:16]
    folder = output / WORK_FOLDER
    try:
        for stale_folder in filter(Path.is_dir, folder.iterdir()):
            if fresh or stale_folder.name != name:
                # Workers of a killed build may still write: what they leave goes with the folder.
                shutil.rmtree(stale_folder, ignore_errors=True)
        (folder / name).mkdir(parents=True, exist_ok=True)
        sweep(output)
    except OSError as error:
        message = f"cannot be written: {error.strerror or error}"
        raise ConfigInvalid(message, where=str(error.filename or folder)) from error
    write_json(folder / name / "build.json", content)
    return folder / name


def _report_skipped_splats(
    facts: Sequence[ChunkFacts], chunks: Sequence[Chunk], progress: Progress
) -> int:
    skipped: dict[str, list[ChunkFacts]] = {}
    for chunk, chunk_facts in zip(chunks, facts, strict=True):
        if chunk_facts.skipped:
            skipped.setdefault(chunk.file.path, []).append(chunk_facts)
    for path, parts in skipped.items():
        count = sum(chunk_facts.skipped for chunk_facts in parts)
        first = parts[0].first_skipped
        progress.note(
            f"{path}: {count:,} rows are not finite and are left out; the first is row {first}"
        )
    return sum(chunk_facts.skipped for chunk_facts in facts)


def _report_large_splats(facts: Sequence[ChunkFacts], progress: Progress) -> None:
    largest_scale = max(chunk_facts.largest_scale for chunk_facts in facts)
    if largest_scale > _SPZ_LOG_SCALE:
        progress.note(
            f"the largest splat has a standard deviation of {math.exp(largest_scale):.6g} units, and "
            f"SPZ stores {math.exp(_SPZ_LOG_SCALE):.0f} at most; --codec khr stores all"
        )


def _content_digests(facts: Sequence[ChunkFacts], chunks: Sequence[Chunk]) -> list[str]:
    """Return digests of the scenes' splats that do not depend on file paths."""
    names: list[str] = []
    for chunk, chunk_facts in zip(chunks, facts, strict=True):
        if chunk.first == 0:
            names.append(f"file of {chunk.file.count} splats")
        names += chunk_facts.digests
    return names


def _plan(
    run: _BuildRun,
    files: Sequence[SceneFile],
    chunks: Sequence[Chunk],
    facts: Sequence[ChunkFacts],
    parameters: BuildParameters,
    partition: int,
    output: Path,
    work: Path,
) -> Plan:
    nonempty_facts = [chunk_facts for chunk_facts in facts if chunk_facts.count]
    low = np.min([chunk_facts.low for chunk_facts in nonempty_facts], axis=0)
    cube = Cube.enclosing(low, np.max([chunk_facts.high for chunk_facts in nonempty_facts], axis=0))
    degree = max(file.degree for file in files)
    limit = min(partition, _PARTITION_BYTES // row_dtype(degree).itemsize)
    max_grouped_splats = 0 if parameters.implicit else parameters.leaf
    if parameters.is_streamed_sog:
        max_grouped_splats = UNIT_SPLATS
    limit = max(limit, parameters.leaf, max_grouped_splats)
    cells, counts = _count_cells(run, chunks, cube, limit, work, is_anchored=parameters.is_anchored)
    partitions, top = make_partitions(cells, counts, limit, max_grouped_splats)
    return Plan(
        cube=cube,
        degree=degree,
        antialiased=files[0].antialiased,
        color_space=files[0].color_space,
        count=int(counts.sum()),
        partitions=partitions,
        top=top,
        parameters=parameters,
        chunks=tuple(chunks),
        output=str(output),
        work=str(work),
    )


def _count_cells(
    run: _BuildRun,
    chunks: Sequence[Chunk],
    cube: Cube,
    limit: int,
    work: Path,
    *,
    is_anchored: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Count the splats per octree cell; cells of more than ``limit`` splats are divided further.

    Cells that hold too many are counted again, deeper: a scene with a few splats far away has
    nearly all others in one cell.
    """
    known: dict[int, int] = {}
    depth, parent_cells, parent_depth = _FIRST_DEPTH, None, 0
    while True:
        tasks = [
            CountTask(
                chunk=chunk,
                cube=cube,
                depth=depth,
                parent_cells=parent_cells,
                parent_depth=parent_depth,
                is_anchored=is_anchored,
                work=str(work),
            )
            for chunk in chunks
        ]
        total = sum(chunk.count for chunk in chunks)
        for cells, counts in run.phase("count", total, run_count, tasks):
            for cell, count in zip(cells.tolist(), counts.tolist(), strict=True):
                known[cell] = known.get(cell, 0) + count
        overfull_cells = [
            cell for cell, count in known.items() if count > limit and depth_of(cell) == depth
        ]
        if not overfull_cells or depth == DEPTH:
            break
        for cell in overfull_cells:
            del known[cell]
        parent_depth = depth
        parent_cells = np.array(
            sorted(cell - (1 << 3 * depth) for cell in overfull_cells), np.uint64
        )
        depth = min(DEPTH, depth + _DEPTH_STEP)
    table = sorted(known.items())
    return (
        np.array([cell for cell, _ in table], np.uint64),
        np.array([count for _, count in table], np.int64),
    )
