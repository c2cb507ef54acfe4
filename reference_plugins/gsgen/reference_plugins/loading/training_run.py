"""Opens a training run: its folders, the iteration to export, and its options."""

__all__ = ["TrainingRun", "open_cloud", "open_run"]

from dataclasses import dataclass
from pathlib import Path

from gsgen.reference_plugins.loading.cfg_args import CfgArgs, read_cfg_args
from gsgen.reference_plugins.loading.folder import find_iteration, required_file, within_run
from gsgen.reference_plugins.loading.method_detection import refuse_other_method


@dataclass(frozen=True, slots=True)
class TrainingRun:
    """The folder of a training run, and one of its iterations."""

    folder: Path
    iteration: int
    files: Path  # the folder with the iteration's point cloud
    cfg: CfgArgs  # options of the training run

    def __str__(self) -> str:
        return f"{self.folder}: iteration {self.iteration}"


def open_run(
    method: str, path: Path, iteration: int | None = None, *, needs_cfg: bool = False
) -> TrainingRun:
    """Find an iteration of a training run, and read the options; refuse runs of other methods.

    ``path`` is the run, one iteration, or a file in either; without ``iteration``, the last one is
    found. With ``needs_cfg``, a missing ``cfg_args`` is an error.
    """
    folder, iteration = within_run(path, iteration)
    number, files = find_iteration(folder, iteration)
    refuse_other_method(method, folder, files)
    return TrainingRun(folder, number, files, read_cfg_args(folder, required=needs_cfg))


def open_cloud(
    method: str, path: Path, iteration: int | None, content_text: str
) -> tuple[TrainingRun, Path]:
    """Find the point cloud in a training run's folder; a PLY path is the point cloud itself.

    ``content_text`` describes the point cloud, for the error if it is missing.
    """
    if path.is_file() and path.suffix == ".ply" and path.name != "point_cloud.ply":
        return TrainingRun(path.parent, 0, path.parent, read_cfg_args(path.parent)), path
    run = open_run(method, path, iteration)
    return run, required_file(run.files / "point_cloud.ply", content_text)
